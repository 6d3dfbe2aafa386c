"""Declarations of the drivers a station names: actions, current ranges, and the time a call takes on the bus."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import PurePath

from bench.model.drivers import driver_class
from bench.model.errors import InputError
from bench.model.ports import Action, Drivers, actions_of
from bench.plan.decision import Followed, walk
from bench.plan.findings import Findings, suggestion
from bench.plan.plan import Step
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedCall, PlannedCommand, PlannedRecord, PlannedSettle, PlannedSoak, PlannedVerify

DEFAULT_BUS_S = 0.1


def declared_at(station: Station, *path: str) -> str:
    """Return name of a station's file and line of an entry, as ``af_bench_sim.yaml:24``."""
    where = station.document.where(path)
    return f"{PurePath(station.document.name).name}:{where.split(':')[-2]}"


def no_instrument(station: Station, role: str) -> str:
    """Return the sentence about a role that is called and not declared."""
    known = suggestion(role, station.instruments)
    return f"station {station.name} has no instrument {role!r} ({declared_at(station, 'instruments')}){known}"


def driver_actions(name: str) -> Mapping[str, Action]:
    """Return declared actions of a driver, by name."""
    return actions_of(driver_class(name))


def driver_ladder_A(name: str) -> tuple[float, ...]:
    """Return current ranges of a source as its driver declares them (``ranges_A``), ampere, lowest first; else ().

    Raises: InputError B-PLAN-010, B-PLAN-011.
    """
    return tuple(sorted(getattr(driver_class(name), "ranges_A", ())))


def range_after(ladder_A: Sequence[float], level_A: float, locked: bool, before_A: float | None) -> float | None:
    """Return range of a source after a level was set: the lowest that holds it, or the range before if that is locked.

    None if no range holds the level, or if the locked range is not known.
    """
    if locked:
        return before_A if before_A is not None and abs(level_A) <= before_A else None
    return next((limit_A for limit_A in sorted(ladder_A) if abs(level_A) <= limit_A), None)


def declared_action(station: Station, role: str, name: str) -> Action | None:
    """Return declaration of ``role.name``, or None if the station or the driver has no such thing."""
    entry = station.instruments.get(role)
    try:
        return None if entry is None else _declared(entry.driver, name)
    except InputError:
        return None


def station_drivers(station: Station) -> Drivers:
    """Return the declared actions of each role; none of a driver that cannot be had."""
    drivers: dict[str, Mapping[str, Action]] = {}
    for role, entry in station.instruments.items():
        with suppress(InputError):
            drivers[role] = driver_actions(entry.driver)
    return drivers


@lru_cache(maxsize=1024)
def _declared(driver: str, name: str) -> Action | None:
    return driver_actions(driver).get(name)


def bus_s(step: Step, station: Station) -> float:
    """Return longest time that a call normally takes on the bus, second; the station may say its bus is faster."""
    if isinstance(step, PlannedCommand) and step.takes_s is not None:
        return step.takes_s
    action = declared_action(station, step.role, step.name)
    if action is None and isinstance(step, PlannedCall | PlannedVerify):
        return 0.0  # a call of nothing is a mistake of its own
    return station.file.bus_time_factor * (DEFAULT_BUS_S if action is None else action.takes_s(step.told()))


def with_bus_time(steps: Iterable[Step], station: Station) -> tuple[Step, ...]:
    """Return the same steps; ``bus_s`` of each settle step is the bus time of the calls that share it, second.

    Behind a decision it is the longest of all ways that lead to the step.
    """
    steps = tuple(steps)
    longest_s: dict[int, float] = {}
    walk(steps, Findings(), _Shared(station, longest_s))
    return tuple(
        replace(step, bus_s=longest_s.get(step.number, 0.0)) if isinstance(step, PlannedSettle) else step
        for step in steps
    )


@dataclass
class _Shared(Followed):
    """Bus time of the calls since the last step that waits, second; of several ways the longest.

    ``longest_s``: what was shared with each step that waits, by its number.
    """

    station: Station
    longest_s: dict[int, float]
    bus_s: float = 0.0

    def take(self, step: Step) -> None:
        if step.on_the_bus:
            self.bus_s += bus_s(step, self.station)
        elif isinstance(step, PlannedSettle | PlannedSoak | PlannedRecord):
            self.longest_s[step.number] = max(round(self.bus_s, 9), self.longest_s.get(step.number, 0.0))
            self.bus_s = 0.0

    def key(self) -> int:
        return 0

    def join(self, other: _Shared) -> None:
        self.bus_s = max(self.bus_s, other.bus_s)
