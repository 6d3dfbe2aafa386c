"""The real drivers on the simulated station, served over HiSLIP in real time."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import pytest
from pyvisa.resources import MessageBasedResource
from sim_served import Served, serve

from bench.model.clock import WallClock
from bench.model.shipped import find_shipped
from bench.plan import load_station


class Drivers:
    """One driver per role of a station, on a session of its own."""

    def __init__(self, served: Served, wiring: dict[str, Any], clock: WallClock) -> None:
        self.sent: list[str] = []
        self.by_role = {}
        for role, entry in wiring["instruments"].items():
            resource = served.visa.open_resource(
                served.servers.resources()[role], resource_pyclass=MessageBasedResource
            )
            driver = importlib.import_module(f"instruments.{entry['driver']}").DRIVER
            self.by_role[role] = driver(
                resource, role=role, clock=clock, transcript=self._note, options=entry["options"]
            )

    def __getitem__(self, role: str) -> Any:
        return self.by_role[role]

    def _note(self, role: str, direction: str, text: str, t_ns: int) -> None:
        self.sent.append(f"{role} {direction} {text}")


@pytest.fixture
def bench() -> Iterator[tuple[Served, Drivers]]:
    clock = WallClock(rate=10.0)  # readings and settling of seconds; the bus is as fast as it is
    wiring = load_station(find_shipped("stations", "af_bench_sim")).wiring()
    with serve(clock, wiring) as served:
        yield served, Drivers(served, wiring, clock)


def test_every_driver_of_the_station_identifies_and_makes_safe(bench: tuple[Served, Drivers]) -> None:
    _, drivers = bench
    assert len(drivers.by_role) == 10
    for driver in drivers.by_role.values():
        driver.identify()
        driver.make_safe()
        assert driver.drain_errors() == []
    assert not [line for line in drivers.sent if "<device clear" in line]


def test_every_driver_measures(bench: tuple[Served, Drivers]) -> None:
    served, drivers = bench
    drivers["calibrator"].standby()
    drivers["switch"].route(3, -1)
    assert drivers["switch"].closed() == ("1!2!3",)
    drivers["calibrator"].output(0.01)
    drivers["calibrator"].operate()
    assert drivers["calibrator"].operating() is True
    assert served.world.unit.inputs[3] == pytest.approx(-0.01, rel=1e-4)
    assert drivers["dmm"].configure_current(0.01) == 0.01
    assert drivers["dmm"].measure_current() == pytest.approx(0.01, rel=1e-3)
    drivers["function_generator"].square(1e7, 1.0)
    drivers["function_generator"].output_on()
    assert drivers["counter"].measure_frequency(1.0) == pytest.approx(1e7, rel=1e-5)
    drivers["supply"].configure(15.0, 1.5, 18.0)
    drivers["supply"].output_on()
    assert drivers["supply"].measure_voltage() == pytest.approx(15.0, abs=0.1)
    drivers["aux_supply"].configure(1, 5.0, 0.5)
    drivers["aux_supply"].output_on()
    assert drivers["aux_supply"].measure_voltage(1) == pytest.approx(5.0, abs=0.1)
    assert len(drivers["logger"].scan()) == 3
    assert abs(drivers["rail_dmm"].measure_voltage()) < 20.0
    assert drivers["chamber"].measure_air() == pytest.approx(23.0, abs=5.0)
    for driver in drivers.by_role.values():
        driver.make_safe()
    assert served.world.unit.inputs[3] is None
    assert drivers["calibrator"].operating() is False
