"""Bus time of the calls that share a settle time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache

from bench.model.errors import InputError
from bench.model.ports import Action
from bench.plan.drivers import driver_actions
from bench.plan.plan import Step
from bench.plan.station import Station

DEFAULT_BUS_S = 0.1
TAKES = "takes"  # argument of a unit step: time from command to answer as planned, second
ON_THE_BUS = ("call", "verify", "send", "unit")


def declared_action(station: Station, role: str, name: str) -> Action | None:
    """Declaration of ``role.name``, or None if the station or the driver has no such thing."""
    entry = station.instruments.get(role)
    try:
        return None if entry is None else _declared(entry.driver, name)
    except InputError:
        return None


@lru_cache(maxsize=1024)
def _declared(driver: str, name: str) -> Action | None:
    return driver_actions(driver).get(name)


def bus_s(step: Step, station: Station) -> float:
    """Longest time that one call normally takes on the bus, second; the station may say that its bus is faster."""
    if TAKES in step.arguments:
        return float(step.arguments[TAKES])
    action = declared_action(station, step.role, step.name)
    if action is None and step.kind in ("call", "verify"):
        return 0.0  # a call of nothing is a mistake of its own
    return station.file.bus_time_factor * (DEFAULT_BUS_S if action is None else action.bus_s)


def with_bus_time(steps: Iterable[Step], station: Station) -> tuple[Step, ...]:
    """The same steps; each settle step's argument ``bus_s`` is the bus time of the calls that share it, second."""
    done: list[Step] = []
    total_s = 0.0
    for step in steps:
        if step.kind in ON_THE_BUS:
            total_s += bus_s(step, station)
        elif step.kind in ("settle", "soak", "record"):
            if step.kind == "settle":
                step = replace(step, arguments={"bus_s": round(total_s, 9)})
            total_s = 0.0
        done.append(step)
    return tuple(done)
