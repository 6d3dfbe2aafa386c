"""The simulated lock-in amplifier, its filter and the level: signal processing in closed form, and over the bus."""

import math
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from fog_signal import NorthBench, Turning, amplifier, trace
from scipy.special import gammainc

from bench.model.errors import InstrumentError
from sim_instruments.krohn_hite_3988 import BandPass, Channel
from sim_instruments.synchronous_detection import INPUT_OVERLOAD, OUTPUT_OVERLOAD, STEPS, UNLOCKED, LockIn

PHASES_DEG = (0.0, 20.0, 90.0, 137.0, 180.0, 251.0, 270.0, 359.0)


def sine(amplitude_V: float, phase_deg: float, harmonic: int = 1):
    return lambda turns: amplitude_V * np.sin(2 * np.pi * harmonic * turns + math.radians(phase_deg))


def settled(world: Turning, index: str = "a", seconds: float = 20.0, **settings: object) -> tuple[float, float]:
    made = amplifier(world, index, time_constant_s=0.3, poles=4, synchronous=True, **settings)
    made.run_to(round(1000 * seconds))
    return made.outputs_V


@pytest.mark.parametrize("phase_deg", PHASES_DEG)
@pytest.mark.parametrize(("index", "ahead_deg"), [("a", 0.0), ("b", 90.0)])
@pytest.mark.parametrize("square", [False, True])
def test_settled_output_of_both_indexes_at_four_phases(
    phase_deg: float, index: str, ahead_deg: float, square: bool
) -> None:
    """X = Ke / sqrt 2 cos(phi - PHAS - index), Y its sine: of the paper's (13) and (14)."""
    for set_deg in (0.0, -90.0, -180.0, -270.0):
        x_V, y_V = settled(Turning(sine(0.8, phase_deg)), index, phase_deg=set_deg, square=square)
        angle = math.radians(phase_deg - ahead_deg - set_deg)
        assert x_V == pytest.approx(0.8 / math.sqrt(2) * math.cos(angle), abs=1.5 / STEPS)
        assert y_V == pytest.approx(0.8 / math.sqrt(2) * math.sin(angle), abs=1.5 / STEPS)


@pytest.mark.parametrize(("square", "part"), [(False, 0.0), (True, 1 / 3)])
def test_a_third_harmonic_reaches_a_square_reference_only(square: bool, part: float) -> None:
    """1 % third harmonic in quadrature turns the square reference's result by 0.191 deg, the sine's not at all."""
    both = lambda turns: sine(1.0, 90.0)(turns) + sine(0.01, 0.0, 3)(turns)  # noqa: E731
    x_V, y_V = settled(Turning(both), square=square)
    assert x_V == pytest.approx(0.01 * part / math.sqrt(2), abs=1.5 / STEPS)
    assert math.degrees(math.atan2(x_V, y_V)) == pytest.approx(0.191 if square else 0.0, abs=0.003)


@pytest.mark.parametrize(("poles", "waits", "published"), [(1, 5, 0.99), (2, 7, 0.99), (3, 9, 0.99), (4, 10, 0.9897)])
def test_settling_is_that_of_equal_poles(poles: int, waits: int, published: float) -> None:
    """The manual's waiting times to 99 %; a cascade of k equal poles follows the incomplete gamma function."""
    begins = 2.0
    signal = lambda turns: np.where(turns >= begins * 100.0, np.sqrt(2.0), 0.0) * np.sin(2 * np.pi * turns)  # noqa: E731
    made = amplifier(Turning(signal, rate_Hz=100.0), time_constant_s=0.5, poles=poles, synchronous=True)
    x_V = trace(made, 2000 + 500 * waits + 1)[0]
    for waited in (1, 3, waits):
        assert x_V[2000 + 500 * waited] == pytest.approx(gammainc(poles, waited), abs=0.006)
    assert x_V[-1] > published - 0.0005


@pytest.mark.parametrize(("poles", "bandwidth"), [(1, 1 / 4), (2, 1 / 8), (3, 3 / 32), (4, 5 / 64)])
@pytest.mark.parametrize("square", [False, True])
def test_noise_bandwidth_is_the_published_one(poles: int, bandwidth: float, square: bool) -> None:
    """White noise of density 2 s2/fs gives a variance of that times the ENBW; a square reference pi2/8 of it."""
    world = Turning(sine(0.0, 0.0), rate_Hz=10.0, noise_V=0.1)
    made = amplifier(world, time_constant_s=0.03, poles=poles, input_limit_V=9.0, square=square)
    trace(made, 1000)
    values = trace(made, 301_000)
    expected = 0.1**2 * 2e-3 * bandwidth / 0.03 * (np.pi**2 / 8 if square else 1.0)
    independent = 2 * 300.0 * bandwidth / 0.03 * 2  # of X and Y together
    assert np.mean(values**2) == pytest.approx(expected, rel=0.015 + 3.0 * math.sqrt(2.0 / independent))


def test_without_the_synchronous_filter_twice_the_frequency_is_left() -> None:
    """One pole of 1 s at 1 Hz leaves the 2 Hz product at 1 / sqrt(1 + (4 pi)2) of X."""
    worlds = [amplifier(Turning(sine(1.0, 0.0)), time_constant_s=1.0, poles=1, synchronous=on) for on in (False, True)]
    rough, smooth = (np.ptp(trace(made, 30_000)[0][-1000:]) / 2 for made in worlds)
    assert rough == pytest.approx(1 / math.sqrt(2) / math.hypot(1.0, 4 * math.pi), rel=0.01)
    assert smooth < 1e-6


def test_the_phase_changes_the_outputs_through_the_filters_only() -> None:
    made = amplifier(Turning(sine(1.0, 0.0)), time_constant_s=1.0, poles=1, synchronous=True)
    made.run_to(30_000)
    before = made.outputs_V[0]
    made.change(phase_deg=180.0)
    assert made.outputs_V[0] == before
    x_V = trace(made, 45_000)[0]
    assert abs(x_V[0] - before) < 0.002
    # the mean over one period goes over with the products that are in it, and the pole follows
    ripple = 2.0 * (1.0 - math.exp(-1)) / (1.0 + 16.0 * math.pi**2)
    assert x_V[999] == pytest.approx(before * (1.0 - 2.0 * math.exp(-1) - ripple), abs=1e-3)
    assert x_V[-1] == pytest.approx(-before, abs=1e-4)


def test_the_loop_locks_in_two_periods_that_agree_and_not_without_pulses() -> None:
    made = amplifier(Turning(sine(1.0, 0.0)))
    made.run_to(2_000)
    assert made.status & UNLOCKED
    made.status = 0
    made.run_to(2_999)
    assert not made.status & UNLOCKED
    assert made.frequency_Hz == 1.0
    made = amplifier(Turning(sine(1.0, 0.0), stops_s=10.5))
    made.run_to(11_000)
    made.status = 0
    made.run_to(11_500)
    assert not made.status
    made.run_to(11_501)  # the pulse of 11 s has been due for half a period
    assert made.status & UNLOCKED
    made = LockIn(lambda first, last: np.ones(last - first), lambda *_: np.zeros(0, np.int64))
    made.run_to(1_000)
    assert made.outputs_V == (0.0, 0.0)
    assert made.frequency_Hz == 0.0
    assert made.status == UNLOCKED


def test_a_change_of_rate_unlocks_until_two_periods_agree_again() -> None:
    class Faster(Turning):
        def pulses(self, index, t0_ns, t1_ns):
            times = np.concatenate((np.arange(0, 11), 10 + np.arange(1, 40) / 1.05)) * 1e9
            return times[(times >= t0_ns) & (times < t1_ns)].astype(np.int64)

    made = amplifier(Faster(sine(1.0, 0.0)))
    made.run_to(3_000)
    made.status = 0
    made.run_to(10_900)
    assert made.status == 0
    made.run_to(11_000)
    assert made.status & UNLOCKED
    made.run_to(12_000)
    made.status = 0
    made.run_to(14_000)
    assert made.status == 0
    assert made.frequency_Hz == pytest.approx(1.05)


def test_overloads_are_told_and_clip() -> None:
    def locked(amplitude_V: float, **settings: float) -> LockIn:
        made = amplifier(Turning(sine(amplitude_V, 0.0)), time_constant_s=0.1, poles=4, synchronous=True, **settings)
        made.run_to(5_000)
        made.status = 0
        made.run_to(8_000)
        return made

    assert locked(1.4).status == 0
    loud = locked(1.5)
    assert loud.status == INPUT_OVERLOAD
    assert 1.0 < loud.outputs_V[0] < 1.5 / math.sqrt(2) - 0.005
    narrow = locked(1.4, sensitivity_V=0.5)
    assert narrow.status == OUTPUT_OVERLOAD
    assert narrow.outputs_V[0] == pytest.approx(0.545)


@pytest.mark.parametrize("synchronous", [False, True])
def test_the_pieces_do_not_matter(synchronous: bool) -> None:
    """However often it is asked in between, the outputs are the same to rounding."""
    print(seed := 11)
    rng = np.random.default_rng(seed)
    whole, parts = (
        amplifier(Turning(sine(0.8, 33.0), rate_Hz=0.97, noise_V=0.05), time_constant_s=0.3, synchronous=synchronous)
        for _ in range(2)
    )
    expected = trace(whole, 20_000)
    ends = [*np.sort(rng.choice(np.arange(1, 20_000), 150, replace=False)).tolist(), 20_000]
    found = np.concatenate([trace(parts, end) for end in ends], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert (whole.status, whole.frequency_Hz) == (parts.status, parts.frequency_Hz)


def test_hours_are_gone_through_once() -> None:
    world = Turning(sine(1.0, 0.0))
    made = amplifier(world, time_constant_s=1.0)
    made.run_to(1_000_000)
    made.run_to(1_000_000)
    assert world.asked[0][0] == 0
    assert all(first == last for (_, last), (first, _) in zip(world.asked, world.asked[1:], strict=False))
    assert world.asked[-1][1] == 1_000_000


PHI_DEG = 33.0
SINE = sine(1.0, PHI_DEG)


@pytest.fixture
def bench() -> Iterator[NorthBench]:
    with closing(NorthBench(Turning(SINE))) as opened:
        yield opened


@pytest.mark.parametrize("fault", ["garbled", "late"])
def test_a_reply_that_goes_wrong_leaves_the_set_up_right(bench: NorthBench, fault: str) -> None:
    """Whichever reply of a set-up is damaged or comes late: the settings are as wanted at the end."""
    lock_in, faults = bench.driver["direct"], bench.world.faults.instrument("direct")
    lock_in.identify()
    for number in range(1, 48, 3):
        asked = 0
        lock_in.raw("*RST")

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


def test_what_the_amplifier_does_not_know_is_in_its_registers(bench: NorthBench) -> None:
    lock_in = bench.driver["direct"]
    for command, problem in (("PHAS 730", "execution"), ("SENS 27", "execution"), ("BLAH 1", "command")):
        with pytest.raises(InstrumentError, match=f"B-INST-005: .*{problem} error"):
            lock_in.set(command)
    assert lock_in.raw("PHAS?") == "0.00"
    lock_in.set("PHAS 541")
    assert lock_in.raw("PHAS?") == "-179.00"
    assert lock_in.raw("SNAP? 3,4").split(",") == [lock_in.raw("OUTP? 3"), lock_in.raw("OUTP? 4")]


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
    """Compare its worth before a lock-in (docs/method-north.md) with the poles of both filters, in the plane of s."""
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
