"""Our drivers before instruments written from their manuals without a look at them, as a last user left them.

The judge is the physics of the rack alone: what is at the terminals or comes back is right, or the driver refused with
an error that names the setting that is wrong; and the safe state is safe.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from rack_base import Rack
from rack_meters import Agilent34401A, Agilent34970A, Agilent53230A, Hp3458A, Sr830
from rack_sources import Agilent33250A, AgilentE3631A, Fluke5720A, Hp6632B, Keithley7002

from bench.model.clock import VirtualClock
from bench.model.drivers import driver_class
from bench.model.errors import InstrumentError


def calibrator(driver: Any, rack: Any, draw: random.Random) -> None:
    for _ in range(3):
        current_A = draw.choice((1.0, 2.15, 1.23456)) * 10.0 ** draw.randint(-4, -1)
        driver.output(current=current_A)
        rack.state.post = draw.choice(("NORMAL", "AUX"))  # by hand, behind what was set up
        driver.operate()
        assert rack.state.post == "NORMAL", "posts"
        step_A = next(step_A for step_A in rack.steps_A if current_A <= step_A) / 2.2e6
        assert rack.current_A == pytest.approx(current_A, abs=step_A), "current at the posts"
        assert rack.clock.now_ns() >= rack.settled_ns, "before it is settled"
        assert driver.operating() is True
    range_A = rack.state["range_A"]
    driver.output(current=range_A / 3.0, range="locked")
    assert rack.state["range_A"] == range_A, "the locked range"


def meter(driver: Any, rack: Any, draw: random.Random) -> None:
    range_A = draw.choice((1e-4, 2e-4, 1e-3, 0.05, 1.0))
    driver.configure_current(range=range_A)
    for _ in range(2):
        rack.truth_A = range_A * draw.uniform(-1.0, 1.0)
        rack.clock.sleep(20.0)
        assert driver.measure_current() == pytest.approx(rack.truth_A, abs=2e-6 * range_A), "current"


def logger(driver: Any, rack: Any, draw: random.Random) -> None:
    for _ in range(2):
        assert driver.scan() == pytest.approx([21.5, -40.25], abs=1e-3), "thermocouples"
        assert driver.measure_resistance(channel=103, range=1000.0, cycles=10) == pytest.approx(787.0), "resistance"


def voltmeter(driver: Any, rack: Any, draw: random.Random) -> None:
    for _ in range(2):
        assert driver.measure_voltage() == pytest.approx(3.21), "voltage"
        assert driver.measure_resistance(range=1000.0, cycles=10) == pytest.approx(787.0), "resistance"


def switch(driver: Any, rack: Any, draw: random.Random) -> None:
    for _ in range(4):
        channel, polarity = draw.randint(1, 10), draw.choice((1, -1))
        driver.route(channel=channel, polarity=polarity)
        rack.clock.sleep(5.0)
        assert rack.now() == {f"1!{1 if polarity > 0 else 2}!{channel}"}, "closed"
    driver.open_all()
    rack.clock.sleep(5.0)
    assert rack.now() == set(), "closed"


def generator(driver: Any, rack: Any, draw: random.Random) -> None:
    for _ in range(2):
        frequency, amplitude = draw.choice((0.5, 1e3, 345678.9, 30e6)), draw.choice((0.05, 1.0, 5.0, 20.0))
        driver.square(frequency=frequency, amplitude=amplitude)
        rack.state |= {"offset": draw.choice((0.0, 0.5)), "burst": draw.random() < 0.5}  # by hand
        driver.output_on()
        square = {"output": True, "shape": "SQU", "Hz": frequency, "duty": 50.0, "polarity": "NORM"}
        assert rack.shows() == square | {"Vpp": amplitude, "offset": 0.0, "modes": []}, "waveform"


def counter(driver: Any, rack: Any, draw: random.Random) -> None:
    for gate in (0.1, 1.0):
        assert driver.reference_locked() is rack.is_external, "reference"
        assert driver.measure_frequency(gate=gate) == pytest.approx(rack.truth_Hz, rel=1e-9), "frequency"


def supply(driver: Any, rack: Any, draw: random.Random) -> None:
    rack.peak_V = 0.0
    driver.configure(voltage=12.0, current_limit=1.0, over_voltage=14.0)
    driver.output_on()
    assert (rack.out_V(), rack.peak_V) == (12.0, 12.0), "voltage"
    assert [rack.state[key] for key in ("A", "over_V", "over_current")] == [1.0, 14.0, True], "limits"
    assert driver.measure_voltage() == pytest.approx(12.0), "read-back"
    assert driver.measure_current() == pytest.approx(0.6), "read-back"


def supplies(driver: Any, rack: Any, draw: random.Random) -> None:
    wanted = {"P6V": 5.0, "P25V": 15.0, "N25V": -12.0}
    for rail in draw.sample((1, 2, 3), 3):
        driver.configure(rail=rail, voltage=[*wanted.values()][rail - 1], current_limit=0.5)
    driver.output_on()
    assert {rail: rack.out_V(rail) for rail in rack.rails} == wanted, "rails"
    assert [driver.measure_voltage(rail=rail) for rail in (1, 2, 3)] == pytest.approx([*wanted.values()]), "read-back"


def lock_in(driver: Any, rack: Any, draw: random.Random) -> None:
    sensitivity = draw.choice((0.05, 0.5, 1.0))
    driver.configure(time_constant=0.03, slope=24, sensitivity=sensitivity, synchronous="off")
    rack.state.harmonic = draw.choice((1, 2))  # by hand
    driver.set_phase(phase=-75.0)
    rack.clock.sleep(2.0)
    seen, is_lost = driver.measure(), rack.state["unlocked"]
    assert (seen["unlocked"], seen["overload"], driver.locked()) == (is_lost, sensitivity < 0.1, not is_lost), "flags"
    values = [seen["x_V"], seen["y_V"], seen["frequency_Hz"]]
    assert is_lost or sensitivity < 0.1 or values == pytest.approx([0.02**0.5, 0.02**0.5, 10e3], rel=1e-4), "X and Y"


Campaign = Callable[[Any, Any, random.Random], None]
RACK: dict[str, tuple[type[Rack], Campaign]] = {
    "fluke_5720a": (Fluke5720A, calibrator),
    "hp_3458a": (Hp3458A, meter),
    "agilent_34970a": (Agilent34970A, logger),
    "agilent_34401a": (Agilent34401A, voltmeter),
    "keithley_7002": (Keithley7002, switch),
    "agilent_33250a": (Agilent33250A, generator),
    "agilent_53230a": (Agilent53230A, counter),
    "hp_6632b": (Hp6632B, supply),
    "agilent_e3631a": (AgilentE3631A, supplies),
    "srs_sr830": (Sr830, lock_in),
}


def judge(name: str, seed: int) -> str:
    """What is wrong with one start, in words; "" if nothing is."""
    build, campaign = RACK[name]
    rack, make = build(VirtualClock(), seed), driver_class(name)
    silent = {"transcript": lambda *line: None, "options": {}, "reopen": lambda: rack}
    driver: Any = make(rack, role="instrument", clock=rack.clock, **silent)
    try:
        try:
            driver.identify()
        finally:  # as a run begins
            driver.make_safe()
            assert not rack.is_energised, "safe state"
        campaign(driver, rack, random.Random(seed))
        driver.make_safe()
        assert not rack.is_energised, "safe state"
    except InstrumentError as error:
        fault = "" if rack.is_named(str(error)) else f"blames something else: {error}"
        with suppress(InstrumentError):  # as a run ends
            driver.make_safe()
        fault = f"left on after {error}" if rack.is_energised else fault
    except AssertionError as error:
        fault = f"wrong without a word: {str(error).splitlines()[0]}"
    else:
        fault = ""
    return fault and f"{name}, start {seed}: {fault}\n  left: {rack.left}\n  " + "\n  ".join(rack.sent[-25:])


@pytest.mark.parametrize("count", [30, pytest.param(1000, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("name", RACK)
def test_a_dirty_start_ends_right_or_is_told(name: str, count: int) -> None:
    faults = [fault for seed in range(count) if (fault := judge(name, seed))]
    assert not faults, f"{len(faults)} of {count} starts\n" + "\n".join(faults[:3])
