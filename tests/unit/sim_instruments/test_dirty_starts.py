"""Instruments as their last user left them: after the driver's preparation the stimulus or the reading is right.

Judged by the physics of the simulated bench and not by what reads back; a driver may also say what is wrong.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pyvisa.resources import MessageBasedResource
from scripted import Log
from sim_bench import ADDRESSES, DRIVERS, Bench, open_bench

from bench.model.errors import InstrumentError

SEED = 1900
FREQUENCY_Hz, AMPLITUDE_V, VOLTAGE_V, CURRENT_A = 1e7, 2.5, 15.0, 0.1


def soiled(bench: Bench, role: str, seed: int) -> Any:
    """Return the driver of an instrument that somebody used before."""
    bench.world.instruments[role].left_by_another(np.random.default_rng([SEED, seed]))
    resource = bench.manager.open_resource(ADDRESSES[role], resource_pyclass=MessageBasedResource)
    driver = importlib.import_module(f"instruments.{DRIVERS[role]}").DRIVER
    made = driver(resource, role=role, clock=bench.clock, transcript=Log(), options={})
    made.identify()
    return made


def generator(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "function_generator", seed)
    driver.square(FREQUENCY_Hz, AMPLITUDE_V)
    driver.output_on()
    seen = bench.world.instruments["function_generator"]
    assert seen.function == "SQU"
    assert seen.true_frequency_Hz == pytest.approx(FREQUENCY_Hz, rel=5e-6)
    assert seen.open_amplitude_V == pytest.approx(AMPLITUDE_V, rel=1e-3)
    assert seen.offset_V == 0.0
    assert (seen.polarity, seen.duty_percent) == ("NORM", 50.0)


def counter(bench: Bench, seed: int) -> None:
    source = bench.world.instruments["function_generator"]
    bench.send("function_generator", "FUNC SQU", "FREQ 10 MHz", "OUTP ON")
    driver = soiled(bench, "counter", seed)
    assert driver.measure_frequency(0.1) == pytest.approx(source.true_frequency_Hz, rel=1e-8)


def supply(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "supply", seed)
    driver.configure(VOLTAGE_V, 1.5, 18.0)
    seen = bench.world.instruments["supply"]
    if seen.tripped:
        with pytest.raises(InstrumentError, match="latched") as caught:
            driver.output_on()
        assert caught.value.code == "B-INST-018"
        assert not seen.on
        seen.tripped = ""  # a person has looked and cleared it
    driver.output_on()
    assert seen.supplied_V == VOLTAGE_V


def meter(bench: Bench, seed: int) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", f"OUT {CURRENT_A:E} A, 0 HZ", "OPER")
    bench.clock.sleep(30.0)
    driver = soiled(bench, "dmm", seed)
    driver.configure_current(CURRENT_A)
    assert driver.measure_current() == pytest.approx(bench.world.wiring.loop_current_A, rel=1e-4)
    assert abs(driver.measure_current()) == pytest.approx(CURRENT_A, rel=2e-4)


ROLES: dict[str, Callable[[Bench, int], None]] = {
    "function_generator": generator, "counter": counter, "supply": supply, "dmm": meter,
}  # fmt: skip


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("starts", [20, pytest.param(1000, marks=pytest.mark.sweep)])
def test_what_the_last_user_left_changes_no_stimulus_and_no_reading(role: str, starts: int) -> None:
    print(f"seed {SEED}: {role}, {starts} starts")
    for seed in range(starts):
        with open_bench() as bench:
            ROLES[role](bench, seed)
