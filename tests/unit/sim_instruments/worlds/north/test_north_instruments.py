"""Lock-in amplifier, filter and level as simulated instruments: over the bus, on a bench with a signal of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from lock_in_rig import Turning
from north_bench import NorthBench

from bench.model.errors import InstrumentError
from sim_instruments.krohn_hite_3988 import BandPass, Channel

PHI_DEG = 33.0


@pytest.fixture
def make() -> Iterator[Callable[..., NorthBench]]:
    opened: list[NorthBench] = []

    def open_bench(table: Turning, **options: Any) -> NorthBench:
        opened.append(NorthBench(table, **options))
        return opened[-1]

    yield open_bench
    for one in opened:
        one.close()


def sine(turns: np.ndarray) -> np.ndarray:
    return np.sin(2 * np.pi * turns + math.radians(PHI_DEG))


@pytest.mark.parametrize("phase", [0.0, -90.0, -180.0, -270.0])
def test_driver_and_simulator_give_the_paper_s_equations(make: Callable[..., NorthBench], phase: float) -> None:
    bench = make(Turning(sine), divider=10)
    bench.driver["filter"].configure(1.0)
    for role in ("direct", "filtered"):
        bench.driver[role].configure(0.3, 24, 1.0, "on")
        bench.driver[role].set_phase(phase)
    bench.clock.sleep(20.0)
    for role, ahead in (("direct", 0.0), ("filtered", 90.0)):
        found = bench.driver[role].measure()
        angle = math.radians(PHI_DEG - ahead - phase)
        assert found["x_V"] == pytest.approx(math.cos(angle) / math.sqrt(2), abs=4e-4)
        assert found["y_V"] == pytest.approx(math.sin(angle) / math.sqrt(2), abs=4e-4)
        assert found["frequency_Hz"] == 1.0
        assert bench.driver[role].locked() is True
    assert found["overload"] is False


def test_a_signal_with_noise_overloads_the_input_without_a_divider(make: Callable[..., NorthBench]) -> None:
    for divider, expected in ((1, True), (10, False)):
        bench = make(Turning(sine, noise_V=0.7), divider=divider)
        bench.driver["direct"].configure(0.3, 24, 1.0, "on")
        bench.clock.sleep(10.0)
        bench.driver["direct"].measure()
        bench.clock.sleep(5.0)
        found = bench.driver["direct"].measure()
        assert (found["overload"], found["unlocked"]) == (expected, False)


def test_a_table_that_stops_unlocks(make: Callable[..., NorthBench]) -> None:
    bench = make(Turning(sine, stops_s=20.0))
    lock_in = bench.driver["direct"]
    assert lock_in.locked() is False  # internal reference after power on
    lock_in.configure(0.1, 24, 1.0, "on")
    bench.clock.sleep(5.0)
    assert lock_in.locked() is True
    bench.clock.sleep(20.0)
    assert lock_in.locked() is False
    assert lock_in.measure()["unlocked"] is True


def test_the_same_bench_gives_the_same_readings_however_it_is_asked(make: Callable[..., NorthBench]) -> None:
    readings = []
    for pauses in ([30.0], [1.0] * 30):
        bench = make(Turning(sine, noise_V=0.1))
        bench.driver["direct"].configure(0.3, 24, 1.0, "on")
        begin_ns = bench.clock.now_ns()
        for pause in pauses:
            bench.clock.sleep(pause)
            bench.world.instruments["direct"].processor.run_to(bench.clock.now_ns() // 1_000_000)
        assert bench.clock.now_ns() == begin_ns + 30_000_000_000
        readings.append(bench.driver["direct"].measure())
    assert readings[0] == readings[1]


@pytest.mark.parametrize("fault", ["garbled", "late"])
def test_a_reply_that_goes_wrong_leaves_the_set_up_right(make: Callable[..., NorthBench], fault: str) -> None:
    """Whichever reply of a set-up is damaged or comes late: the settings are as wanted at the end."""
    bench = make(Turning(sine))
    lock_in, faults = bench.driver["direct"], bench.world.faults.instrument("direct")
    lock_in.identify()
    for number in range(1, 62, 3):
        asked = 0

        def strike(_: str, direction: str, text: str, __: int, number: int = number) -> None:
            nonlocal asked
            if direction != "tx" or text.startswith("<"):
                return
            asked += 1
            if asked == number and fault == "garbled":
                faults.garbled_replies = 1
            elif asked == number:
                faults.late_s, faults.late_replies = 1.3, 1

        bench.on_line = strike
        lock_in.configure(*((0.3, 24, 0.5, "on") if number % 2 else (1.0, 12, 0.2, "off")))
        lock_in.set_phase(-90.0 * (number % 4))
        assert asked >= number
        bench.on_line = lambda *_: None
        told = [lock_in.raw(f"{name}?") for name in ("OFLT", "OFSL", "SENS", "SYNC", "ICPL", "FMOD", "PHAS")]
        expected = ["9", "3", "25", "1"] if number % 2 else ["10", "1", "24", "0"]
        assert told[:6] == [*expected, "1", "0"], number
        assert float(told[6]) % 360.0 == -90.0 * (number % 4) % 360.0


def test_what_the_amplifier_does_not_know_is_in_its_registers(make: Callable[..., NorthBench]) -> None:
    lock_in = make(Turning(sine)).driver["direct"]
    for command, problem in (("PHAS 730", "execution"), ("SENS 27", "execution"), ("BLAH 1", "command")):
        with pytest.raises(InstrumentError, match=f"{problem} error") as caught:
            lock_in.set(command)
        assert caught.value.code == "B-INST-005"
    assert lock_in.raw("PHAS?") == "0.00"
    lock_in.set("PHAS 541")
    assert lock_in.raw("PHAS?") == "-179.00"
    assert lock_in.raw("SNAP? 3,4").split(",") == [lock_in.raw("OUTP? 3"), lock_in.raw("OUTP? 4")]


def test_the_level_tells_what_its_world_says(make: Callable[..., NorthBench]) -> None:
    bench = make(Turning(sine))
    assert bench.driver["level"].measure() == {"x_mrad": 0.0, "y_mrad": 0.0, "temperature_degC": 23.0}
    bench.world.level_mrad = lambda t_ns: (1.2344, -0.0406)
    assert bench.driver["level"].measure() == {"x_mrad": 1.234, "y_mrad": -0.041, "temperature_degC": 23.0}


def butterworth(frequency_Hz: float, cutoff_Hz: float, high: bool) -> float:
    """Amplitude response of 8 poles."""
    ratio = cutoff_Hz / frequency_Hz if high else frequency_Hz / cutoff_Hz
    return 1.0 / math.sqrt(1.0 + ratio**16)


@pytest.mark.parametrize("frequency_Hz", [0.3, 0.5, 1.0, 2.0, 2.7])
def test_the_band_is_the_product_of_two_butterworth_filters(frequency_Hz: float) -> None:
    band = BandPass([(0, (Channel("HP", 0.5), Channel("LP", 2.0)))])
    times_s = (np.arange(60_000) + 0.5) / 1000.0
    found = band.filtered(0, np.cos(2 * np.pi * frequency_Hz * times_s))[-20_000:]
    expected = butterworth(frequency_Hz, 0.5, True) * butterworth(frequency_Hz, 2.0, False)
    phasor = 2.0 * np.mean(found * np.exp(-2j * np.pi * frequency_Hz * times_s[-20_000:]))
    assert abs(phasor) == pytest.approx(expected, rel=1e-3, abs=1e-5)
    if frequency_Hz == 1.0:
        assert math.degrees(np.angle(phasor)) == pytest.approx(0.0, abs=0.002)


def test_the_band_takes_a_third_harmonic_away_and_turns_what_is_not_in_its_middle() -> None:
    """What it is worth before a lock-in (docs/fog-north.md): by the poles of both filters, in the plane of s."""
    band = BandPass([(0, (Channel("HP", 0.5), Channel("LP", 2.0)))])
    assert butterworth(3.0, 0.5, True) * butterworth(3.0, 2.0, False) < 0.04
    times_s = (np.arange(60_000) + 0.5) / 1000.0
    found = band.filtered(0, np.cos(2 * np.pi * 1.001 * times_s))[-20_000:]
    turn = 2 * np.pi * 1.001 * times_s[-20_000:]  # no whole number of turns: a mean over them would be 0.03 deg off
    cosine, sine = np.linalg.lstsq(np.column_stack((np.cos(turn), np.sin(turn))), found, rcond=None)[0]
    turned_deg = math.degrees(math.atan2(-sine, cosine))
    poles = np.exp(1j * np.pi * (0.5 + (2 * np.arange(8) + 1) / 16))
    low, high = (np.sum(np.angle(1j * ratio - poles)) for ratio in (1.001 / 2.0, 0.5 / 1.001))
    assert turned_deg == pytest.approx(math.degrees(math.remainder(high - low, math.tau)), abs=0.01)
    assert turned_deg == pytest.approx(-0.32, abs=0.02)


def test_a_change_of_the_filter_holds_from_its_sample_on() -> None:
    """The signal goes through at first, then nothing of a constant does, then it is ten times as large."""
    history = [
        (0, (Channel(), Channel())),
        (1_000, (Channel("HP", 10.0), Channel())),
        (3_000, (Channel(input_gain_dB=20), Channel())),
    ]
    band = BandPass(history)
    parts = [band.filtered(first, np.ones(700)) for first in range(0, 4_200, 700)]
    found = np.concatenate(parts)
    assert (found[:1_000] == 1.0).all()
    assert abs(found[2_500:3_000]).max() < 1e-3
    assert found[3_000:] == pytest.approx(10.0)
