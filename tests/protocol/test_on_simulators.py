"""Drivers against the simulators of the same models, which were written from the manuals and not from the drivers."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any
from unittest.mock import MagicMock

import pytest
import pyvisa
from known_drivers import IDENTIFY
from pyvisa.resources import MessageBasedResource
from scripted import Log, refused

from bench.model.clock import NS, VirtualClock
from sim_instruments.worlds.simulation import open_world

SEED = 20
ADDRESS = {name: f"GPIB0::{number}::INSTR" for number, name in enumerate(sorted(IDENTIFY), 1)}


class Bench:
    """One simulated bench with all drivers, by driver name."""

    def __init__(self, dialect: str = "3800") -> None:
        self.clock = VirtualClock()
        entries = {name: {"driver": name, "resource": at, "options": {}} for name, at in ADDRESS.items()}
        entries["thermotron_3800"]["options"] = {"dialect": dialect}
        station = {"instruments": entries, "links": {}}
        self.world = open_world(
            "af_converter", clock=self.clock, seed=SEED, station=station, unit_factory=lambda *_: MagicMock()
        )
        self.visa = pyvisa.ResourceManager(self.world.visa_library)
        self.log = Log()

    def close(self) -> None:
        self.visa.close()
        self.world.close()

    def driver(self, name: str, **options: Any) -> Any:
        resource = self.visa.open_resource(ADDRESS[name], resource_pyclass=MessageBasedResource)
        driver_class = importlib.import_module(f"instruments.{name}").DRIVER
        return driver_class(resource, role=name, clock=self.clock, transcript=self.log, options=options)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


@pytest.mark.parametrize("name", sorted(IDENTIFY))
def test_identity_and_safe_state_from_power_on(bench: Bench, name: str) -> None:
    driver = bench.driver(name)
    assert driver.identify().model in driver.identity_pattern
    driver.make_safe()
    driver.make_safe()
    assert driver.drain_errors() == []


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("current", [0.0, 3e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.2])
def test_a_point(bench: Bench, polarity: int, current: float) -> None:
    calibrator, switch = bench.driver("fluke_5720a"), bench.driver("keithley_7002")
    calibrator.standby()
    switch.route(3, polarity)
    calibrator.output(current)
    began_ns = bench.clock.now_ns()
    calibrator.operate()
    assert bench.clock.now_ns() - began_ns < 15 * NS
    assert calibrator.operating() is True
    channel, current_A, _ = next(call.args for call in reversed(bench.world.unit.set_input.call_args_list))
    assert channel == 3
    assert current_A == pytest.approx(polarity * current, rel=1e-4, abs=2e-5)
    calibrator.standby()
    assert calibrator.operating() is False


def test_operating_into_an_open_circuit_ends_in_standby(bench: Bench) -> None:
    calibrator = bench.driver("fluke_5720a")
    calibrator.output(0.01)
    with refused("B-INST-013", "Compliance"):
        calibrator.operate()
    assert calibrator.operating() is False


@pytest.mark.parametrize(("key", "value"), [("offset_A", 5e-4), ("scale", 1.01)])
@pytest.mark.parametrize("pressed", ["before the run", "before it is switched on", "during the dwell"])
def test_no_current_is_taken_for_its_set_point_with_a_key_of_the_calibrator_pressed(
    bench: Bench, key: str, value: float, pressed: str
) -> None:
    calibrator, switch = bench.driver("fluke_5720a"), bench.driver("keithley_7002")
    simulated = bench.world.instruments["fluke_5720a"]
    actions = {
        "before the run": lambda: calibrator.output(1e-3),
        "before it is switched on": calibrator.operate,
        "during the dwell": calibrator.operating,
    }
    switch.route(1, 1)
    for moment, act in actions.items():
        if moment == pressed:
            setattr(simulated, key, value)
            with refused("B-INST-019", "active"):
                act()
            break
        act()
    assert simulated.operating is (pressed == "during the dwell")
    calibrator.make_safe()
    assert not simulated.operating
