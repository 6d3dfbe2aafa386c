"""Static check of single calls: does the role, the action and each argument exist, and is it inside its limits?

And how long a call takes on the bus.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from bench.model.drivers import driver_class
from bench.model.errors import InputError
from bench.model.ports import Action, Effect, Parameter
from bench.model.units import likely, read_quantity
from bench.plan.decision import Followed, walk
from bench.plan.expected import argument_dimensions, is_reading
from bench.plan.findings import Findings, suggestion
from bench.plan.plan import Plan, Step
from bench.plan.station import InstrumentEntry, Station, declared_action, declared_at, driver_actions, no_instrument
from bench.plan.step_kinds import (
    PlannedCall,
    PlannedCommand,
    PlannedRecord,
    PlannedSend,
    PlannedSettle,
    PlannedSoak,
    PlannedVerify,
)

SOAK_ACTIONS = ("set_temperature", "run")
_ALIKE = 1e-9  # of two numbers that went through different roundings
PURE_NUMBER = "1"  # written without a unit, or with %, ppm


@dataclass(frozen=True)
class Judged:
    """A call's declared action (None: it names none) and the arguments whose sort is right."""

    action: Action | None
    usable: Mapping[str, Any]


NOT_JUDGED = Judged(None, {})


class ActionCheck:
    """Checks calls against the declarations of the drivers; the same call is looked at once."""

    def __init__(self, plan: Plan, station: Station, findings: Findings) -> None:
        self._plan = plan
        self._station = station
        self._findings = findings
        self._seen: dict[Any, Judged] = {}

    def check_reading(self, record: Step, index: int, call: PlannedCall) -> Judged:
        """Return declared action of one of a record's readings; one that is no reading is noted (B-PLAN-096)."""
        dimensions = argument_dimensions(self._plan.dimensions[record.number], index)
        judged = self._fresh(call, dimensions)
        if judged.action is not None and not is_reading(judged.action):
            message = f"{call.role}.{call.name} is no reading: it gives no value, or it changes the bench"
            self._add("B-PLAN-096", record, message, "read an action that returns a value, and call this one before")
        return judged

    def check(self, step: Step) -> Judged:
        """Return declared action of a call or verify step; if it names none a mistake was noted."""
        if not isinstance(step, PlannedCall | PlannedVerify | PlannedSend | PlannedSoak):
            return NOT_JUDGED
        key = step.where, step.role, step.name, repr(step.told())
        if key not in self._seen:
            self._seen[key] = self._fresh(step, self._plan.dimensions[step.number])
        return self._seen[key]

    def _fresh(self, step: Step, dimensions: Mapping[str, str]) -> Judged:
        entry = self._station.instruments.get(step.role)
        if entry is None:
            self._add("B-PLAN-040", step, no_instrument(self._station, step.role))
            return NOT_JUDGED
        try:
            actions = driver_actions(entry.driver)
        except InputError as error:
            where = self._station.document.where(("instruments", step.role, "driver"))
            self._findings.add(error.code, where, error.message)
            return NOT_JUDGED
        if isinstance(step, PlannedSoak):
            self._soak(step, entry)
            return NOT_JUDGED
        if isinstance(step, PlannedSend):
            if not hasattr(driver_class(entry.driver), "raw"):
                self._add("B-PLAN-053", step, f"the driver of {step.role} takes no raw commands", "write a call")
            return NOT_JUDGED
        action = actions.get(step.name)
        if action is None:
            self._no_action(step, entry, actions)
            return NOT_JUDGED
        usable = self._arguments(step, action, entry, dimensions)
        if isinstance(step, PlannedVerify) and (action.effect is not Effect.NONE or action.returns):
            self._add("B-PLAN-054", step, f"{step.role}.{step.name} does not answer true or false")
        return Judged(action, usable)

    def _no_action(self, step: Step, entry: InstrumentEntry, actions: Mapping[str, Action]) -> None:
        """Note a wrong action where it is called; where the driver has none of those called, it is the driver."""
        asked = _called(self._plan, step.role)
        if asked.isdisjoint(actions) and len(asked) > 1:
            where = self._station.document.where(("instruments", step.role, "driver"))
            message = (
                f"{step.role} ({entry.driver}) has none of the actions that are called: {', '.join(sorted(asked))}"
            )
            self._findings.add("B-PLAN-050", where, message, "name the driver of the instrument that has them")
            return
        message = f"{step.role} ({entry.driver}) has no action {step.name!r}{suggestion(step.name, actions)}"
        self._add("B-PLAN-050", step, message)

    def _soak(self, step: PlannedSoak, entry: InstrumentEntry) -> None:
        actions = driver_actions(entry.driver)
        missing = [name for name in SOAK_ACTIONS if name not in actions]
        if missing:
            self._add("B-PLAN-050", step, f"{step.role} ({entry.driver}) has no action {missing[0]!r}: it cannot soak")
            return
        asked = step.told()
        for parameter in actions["set_temperature"].parameters:
            if not math.isnan(asked.get(parameter.name, math.nan)):
                self._limits(step, parameter, asked[parameter.name], entry)

    def _arguments(
        self, step: Step, action: Action, entry: InstrumentEntry, dimensions: Mapping[str, str]
    ) -> dict[str, Any]:
        usable: dict[str, Any] = {}
        parameters = {parameter.name: parameter for parameter in action.parameters}
        given = step.told()
        for name, value in given.items():
            parameter = parameters.get(name)
            if parameter is None:
                message = f"{step.role}.{step.name} has no argument {name!r}{suggestion(name, parameters)}"
                self._add("B-PLAN-051", step, message)
            elif value is not None and self._sort_is_right(step, parameter, value, dimensions.get(name, "")):
                self._limits(step, parameter, value, entry)
                usable[name] = value
        for name, parameter in parameters.items():
            if parameter.required and name not in given:
                self._add("B-PLAN-051", step, f"{step.role}.{step.name} needs the argument {name!r}")
        return usable

    def _sort_is_right(self, step: Step, parameter: Parameter, value: Any, dimension: str) -> bool:
        if parameter.dimension == PURE_NUMBER:
            right = dimension == PURE_NUMBER or (not dimension and type(value) in (int, float))
            due = "a number is due"
        elif parameter.dimension:
            right = dimension == parameter.dimension
            due = f"a quantity in {parameter.dimension} is due{likely(value, parameter.dimension)}"
        elif parameter.choices:
            right = not dimension and not isinstance(value, (bool, list)) and value in parameter.choices
            due = f"one of {', '.join(map(str, parameter.choices))} is due"
        else:
            right = not dimension and not isinstance(value, list)
            due = "a plain value is due"
        if not right:
            shown = f"{value} {dimension}".strip()
            message = f"{step.role}.{step.name}: {parameter.name} is {shown}; {due}"
            origin = self._plan.origins[step.number].get(parameter.name, "")
            where = self._plan.declared[step.number].get(parameter.name, step.where)
            self._findings.add("B-PLAN-052", where, message, origin=origin)
        return right

    def _limits(self, step: Step, parameter: Parameter, value: Any, entry: InstrumentEntry) -> None:
        if not parameter.dimension:
            return
        low = -math.inf if parameter.low is None else parameter.low
        high = math.inf if parameter.high is None else parameter.high
        source = f"driver {entry.driver}"
        if parameter.name in entry.limits:
            station_low, station_high = (read_quantity(text) for text in entry.limits[parameter.name])
            if station_low is not None and station_high is not None and station_low[1] == parameter.dimension:
                if (station_low[0], station_high[0]) != (low, high):
                    limit = declared_at(self._station, "instruments", step.role, "limits", parameter.name)
                    source = f"station {self._station.name} ({limit})"
                low, high = max(low, station_low[0]), min(high, station_high[0])
        if not low <= value <= high:
            unit = "" if parameter.dimension == PURE_NUMBER else f" {parameter.dimension}"
            message = f"{step.role}: {parameter.name} {value:g}{unit} is outside {low:g} to {high:g}{unit} of {source}"
            self._outside(step, parameter, message)
        elif parameter.values and not any(math.isclose(value, setting, rel_tol=_ALIKE) for setting in parameter.values):
            nearest = min(parameter.values, key=lambda setting: abs(math.log(setting / value)))
            message = f"{step.role}: {parameter.name} {value:g} {parameter.dimension} is none of its settings"
            self._outside(step, parameter, f"{message}; the nearest is {nearest:g} {parameter.dimension}")

    def _outside(self, step: Step, parameter: Parameter, message: str) -> None:
        origin = self._plan.origins[step.number].get(parameter.name, "")
        self._findings.add("B-PLAN-055", step.where, message, origin=origin)

    def _add(self, code: str, step: Step, message: str, next_step: str = "") -> None:
        self._findings.add(code, step.where, message, next_step)


def _called(plan: Plan, role: str) -> set[str]:
    """Return the names of all actions that are called of a role."""
    calls = [call for step in plan.steps for call in (step.calls or (step,))]
    return {call.name for call in calls if isinstance(call, PlannedCall | PlannedVerify) and call.role == role}


DEFAULT_BUS_S = 0.1


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
