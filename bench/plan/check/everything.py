"""The static check: walks the flat plan without touching an instrument and proves that it is safe to run.

What is proved, from the declarations of the drivers alone: every action exists and its arguments are inside the limits
of driver and station; no two routes are closed at once; no relay moves under current; the output goes on only with a
route closed and within the full scale of that channel; every record says of itself what the bench does; bus calls fit
in the settle time they share; every instrument that can hold energy has a declared way to its safe state; the standards
are valid until the end and cover the ranges that are used; the station can be opened.

Static check of records: what they say of themselves, and what stands between two without a gap.

What a record says must be what the bench was told before it: the analysis sorts records by these conditions alone, and
a wrong one becomes a wrong number without any other sign.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib import import_module
from typing import Any

from bench.model.clock import NS, VIRTUAL_START_UTC_NS, WallClock
from bench.model.errors import InputError
from bench.model.installed import offer_of
from bench.model.ports import Effect
from bench.model.quantities import Values
from bench.model.stopping import STAGE
from bench.plan.check.actions import ActionCheck, bus_s
from bench.plan.check.analysis import check_asked
from bench.plan.check.state import BenchState, Pose
from bench.plan.check.stations import SIMULATION, check_station, check_used_ranges
from bench.plan.decision import Followed, walk
from bench.plan.expand import DURATION
from bench.plan.expected import roles_of
from bench.plan.findings import Findings
from bench.plan.language.standards import Standard
from bench.plan.plan import Plan, PlannedUnit, Step
from bench.plan.station import Station, declared_action
from bench.plan.step_kinds import (
    MEASUREMENT,
    WIRING,
    PlannedCall,
    PlannedCommand,
    PlannedRecord,
    PlannedSettle,
    PlannedSoak,
    PlannedVerify,
)  # fmt: skip
from bench.plan.values import UNIT


def check_record(plan: Plan, step: Step, state: BenchState, findings: Findings) -> None:
    """Note conditions of a record that the bench does not meet (B-PLAN-076), each with both values."""
    declared = {key: value for key, value in step.conditions.items() if value is not None}
    wrong = list(_temperature(declared, state))
    if not state.untrusted:
        if _is_closed(plan, declared, state):
            wrong += [*_route(plan, declared, state), *_stimulus(declared, state)]
        else:
            wrong += _open(declared, state)
    if wrong:
        message = "the record says what the bench does not do: " + "; ".join(wrong)
        findings.add("B-PLAN-076", step.where, message, "correct the conditions, or the calls before the record")


def _is_closed(plan: Plan, declared: Values, state: BenchState) -> bool:
    """Return whether a record has a closed route. Left out, ``route`` means closed, as it does to the analysis."""
    if "route" in declared:
        return bool(declared["route"] != "open")
    analysed = plan.campaign.get("analysis") != "none" and "channel" in declared
    return bool(state.closed or analysed or declared.get("polarity") or declared.get("current_A"))


def _temperature(declared: Values, state: BenchState) -> Iterator[str]:
    if "temperature_degC" in declared and state.target_degC is not None:
        yield from _differs("temperature", declared["temperature_degC"], state.target_degC, "degC", "the chamber is at")


def _route(plan: Plan, declared: Values, state: BenchState) -> Iterator[str]:
    if not state.closed:
        if state.switches:
            yield "its route is closed, but no route is (write 'route: open' if that is meant)"
        return
    route = next(iter(state.closed.values()))
    for key in ("channel", "polarity"):
        if key in declared and key in route:
            yield from _differs(key, declared[key], route[key], "", "the route has")
    unit = plan.unit_of(declared.get(UNIT))
    if unit is not None and "channel" in declared:
        yield from _differs("card", unit.card, route.get("card"), "", "the route has")


def _stimulus(declared: Values, state: BenchState) -> Iterator[str]:
    if not state.sources or not {"current_A", "range_A", "route"} & declared.keys():
        return
    on = sorted(state.output_on)
    if not on:
        yield f"its route is closed, but the output of {' and '.join(sorted(state.sources))} is off"
        return
    for role in on:
        if role in state.unknown:
            yield f"after raw text nobody knows the current of {role}"
            continue
        if role in state.level_A and state.level_A[role] is None:
            continue  # its mistake is noted already
        if "current_A" in declared:
            yield from _differs("current", declared["current_A"], state.level_A.get(role), "A", f"{role} was set to")
        if "range_A" in declared:
            yield from _differs("range", declared["range_A"], state.range_A.get(role), "A", f"{role} is on")


def _open(declared: Values, state: BenchState) -> Iterator[str]:
    for role, route in sorted(state.closed.items()):
        yield f"its route is open, but {role} has channel {route.get('channel', 'unknown')} closed"
    for role in sorted(state.output_on) if "route" in declared else ():
        yield f"its route is open, but the output of {role} is on"
    for key, unit in (("polarity", ""), ("current_A", "A"), ("range_A", "A")):
        if declared.get(key):
            yield from _differs(key.removesuffix("_A"), declared[key], 0, unit, "an open input has")


def _differs(name: str, declared: Any, actual: Any, unit: str, verb: str) -> Iterator[str]:
    numbers = all(isinstance(value, (int, float)) for value in (declared, actual))
    if math.isclose(declared, actual, rel_tol=1e-9) if numbers else declared == actual:
        return
    said, shown = (f"{value:g} {unit}".strip() if isinstance(value, float) else value for value in (declared, actual))
    yield f"{name} {said}, but {verb} {'an unknown one' if actual is None else shown}"


@dataclass
class _Chain(Followed):
    """The record that another one could follow and the calls since then, or why none could (``gap``).

    ``doubtful`` are the numbers of steps whose duration could not be read. Findings: B-PLAN-060, -061, -067, -068.
    """

    station: Station
    findings: Findings
    doubtful: Collection[int]
    before: PlannedRecord | None = None
    gap: str = "no record stands before it"
    calls: tuple[Step, ...] = ()

    def key(self) -> Hashable:
        return self.before and self.before.number, self.gap, tuple(call.number for call in self.calls)

    def breaks(self, why: str) -> None:
        self.before, self.gap, self.calls = None, why, ()

    def meet(self) -> None:
        self.breaks("the branches of a decision end between it and the record before")

    def take(self, step: Step) -> None:
        if self.before is not None and self.before.phase != step.phase:
            self.breaks(f"the record before it belongs to '{self.before.phase}'")
        if step.on_the_bus:
            self.calls = () if self.before is None else (*self.calls, step)
        elif isinstance(step, PlannedRecord):
            if step.follows:
                _follows(step, self.before, self.gap, self.findings)
                _calls(step, self.calls, self.station, self.findings, step.number in self.doubtful)
            self.before, self.calls = step, ()
        elif not step.sets:  # the records go on while a person does that
            self.breaks(f"a {step.kind} step stands between it and the record before")


def _follows(step: PlannedRecord, before: PlannedRecord | None, gap: str, findings: Findings) -> None:
    if before is None:
        advice = "put it right behind a record, or take 'follows' out"
        findings.add("B-PLAN-067", step.where, f"the record follows nothing: {gap}", advice)
        return
    for record, role in ((before, "is followed by another one"), (step, "follows another one")):
        if record.retry and STAGE not in record.conditions:  # a point in stages is taken again as a whole
            message = f"a record that {role} without a gap cannot be taken again (retry {record.retry})"
            findings.add(
                "B-PLAN-068", record.where, message, "leave 'retry' out; lost frames are counted in the record"
            )


def _calls(step: Step, calls: Sequence[Step], station: Station, findings: Findings, doubtful: bool) -> None:
    """Calls fall into the window behind them: they may not touch what it measures, and must be over when it is."""
    wrong = next((call for call in calls if not _harmless(call, station)), None)
    if wrong is not None:
        named = ".".join(filter(None, (wrong.role, wrong.name)))
        message = f"{named} stands between two records without a gap; only actions of chamber or table and readings may"
        findings.add("B-PLAN-061", step.where, message, "add a settle step and take 'follows' out, or move the call")
    total_s = sum(bus_s(call, station) for call in calls)
    if total_s > step.duration_s and not doubtful:
        message = f"the calls before the record take up to {total_s:g} s; it lasts {step.duration_s:g} s"
        findings.add("B-PLAN-060", step.where, message, "take a longer record, or call less")


def _harmless(call: Step, station: Station) -> bool:
    declared = declared_action(station, call.role, call.name)
    if not isinstance(call, PlannedCall | PlannedVerify):
        return False
    if declared is None:
        return True  # a call of nothing is a mistake of its own
    reading = declared.effect is Effect.NONE and (bool(declared.returns) or isinstance(call, PlannedVerify))
    return reading or declared.effect in (Effect.THERMAL, Effect.MOTION_ON, Effect.MOTION_OFF)


SERIAL = re.compile(r"[A-Za-z0-9](?:(?!\.\.)[A-Za-z0-9._/-]){0,39}")  # a folder is named after it
NO_SERIAL = "is not a serial number: letters, digits, '.', '_', '/' and '-', at most 40"
IDENTIFY = "identify"  # the command whose answer says who the unit is


def check_plan(plan: Plan, station: Station | None = None, start_utc_ns: int | None = None) -> list[InputError]:
    """Return all mistakes of a plan on a station, in order of their place in the sequence; empty if it may run.

    Args:
        station: None means the one the plan was compiled for.
        start_utc_ns: planned start, for the due dates of the standards; None means now, and the virtual start for a
            station that this process simulates.
    """
    station = plan.station if station is None else station
    if start_utc_ns is None:
        start_utc_ns = VIRTUAL_START_UTC_NS if station.in_process else WallClock().utc_ns()
    findings = Findings()
    state = check_steps(plan, station, findings)
    check_station(station, findings)
    check_used_ranges(station, state.used_A, findings)
    _due_dates(plan, station, start_utc_ns, findings)
    check_units(plan, station, findings)
    for remark in plan.remarks:
        findings.extend(remark)
    if not findings:  # a condition may be missing because of one of those
        check_asked(plan, findings)
    return findings.sorted()


def check_steps(
    plan: Plan, station: Station, findings: Findings, doubtful: Collection[int] = frozenset()
) -> BenchState:
    """Note the mistakes of the steps alone, on every way through them; returns a state with all that they use.

    ``doubtful`` are the numbers of steps whose duration could not be read.
    """
    state = _Recorded(plan, station, findings)
    chain, bus = _Chain(station, findings, doubtful), _Bus(plan, findings, doubtful)
    walk(plan.steps, findings, state, Pose(station, findings), bus, chain)
    check_sets(plan, station, findings)
    return state


class _Recorded(BenchState):
    """The state of the bench, compared with what each record says of it."""

    def __init__(self, plan: Plan, station: Station, findings: Findings) -> None:
        self._plan, self._actions_of = plan, ActionCheck(plan, station, findings)
        super().__init__(plan, station, findings, self._actions_of.check)

    def take(self, step: Step) -> None:
        super().take(step)
        if isinstance(step, PlannedRecord):
            check_record(self._plan, step, self, self._findings)
            self._check_readings(step)

    def _check_readings(self, record: PlannedRecord) -> None:
        """Check that a record's calls are readings, and one round is over before the next is due (B-PLAN-060)."""
        for index, call in enumerate(record.calls):
            self.apply(call, self._actions_of.check_reading(record, index, call))
        takes_s = sum(bus_s(call, self._station) for call in record.calls)
        if takes_s > record.every_s:
            taken, due = f"one round of the record's readings takes up to {takes_s:g} s", f"each {record.every_s:g} s"
            self._findings.add("B-PLAN-060", record.where, f"{taken}; one is due {due}", "read less often, or less")


@dataclass
class _Bus(Followed):
    """The first of the calls that no settle time has followed yet: a record must not wait for the bus.

    Findings: B-PLAN-060 (a settle time shorter than the calls before it), B-PLAN-061 (a record without one).
    """

    plan: Plan
    findings: Findings
    doubtful: Collection[int]
    first: Step | None = None

    def take(self, step: Step) -> None:
        first = self.first
        if step.on_the_bus:
            self.first = step if first is None else first
        elif isinstance(step, PlannedSettle):
            if step.bus_s > step.duration_s and step.number not in self.doubtful:
                message = f"the calls before it take up to {step.bus_s:g} s; it lasts {step.duration_s:g} s"
                origin = self.plan.origins[step.number].get(DURATION, "")
                self.findings.add("B-PLAN-060", step.where, message, "settle longer, or call less", origin)
            self.first = None
        elif isinstance(step, PlannedRecord) and first is not None:
            if not isinstance(first, PlannedVerify) and not step.follows:
                message = f"{first.role}.{first.name} is followed by a record without a settle time"
                self.findings.add("B-PLAN-061", step.where, message, "add a settle step before the record")
            self.first = None
        elif isinstance(step, PlannedSoak):
            self.first = None

    def key(self) -> Hashable:
        return self.first and (self.first.kind, self.first.role, self.first.name)


def _due_dates(plan: Plan, station: Station, start_utc_ns: int, findings: Findings) -> None:
    used = roles_of(plan.steps) & station.instruments.keys()
    length_s = plan.prepare_s + plan.duration_s + plan.finally_s
    end = datetime.fromtimestamp(start_utc_ns / NS, UTC) + timedelta(seconds=length_s)
    start = datetime.fromtimestamp(start_utc_ns / NS, UTC).date()
    register = {role: station.instruments[role].standard for role in sorted(used)} | station.file.standards
    days = [standard.calibrated for standard in register.values() if standard is not None]
    clock_is_wrong = len(days) > 1 and start < min(days)
    if clock_is_wrong:
        message = f"the clock says {end:%Y-%m-%d}; all {len(days)} standards were calibrated later, from {min(days)} on"
        findings.add("B-PLAN-063", station.document.where(), message, "set the clock of this machine")
    for role, standard in register.items():
        passive = role in station.file.standards
        where = station.document.where(("standards", role) if passive else ("instruments", role, "standard"))
        if standard is None:
            findings.add("B-PLAN-062", where, f"{role} is used but has no entry in the standards register")
        elif not clock_is_wrong and (standard.calibrated > start or end.date() > standard.due):
            message = f"{role}: calibrated {standard.calibrated}, due {standard.due}; the run ends {end:%Y-%m-%d}"
            findings.add("B-PLAN-063", where, message, "use a standard that is valid until the end")
        else:
            _ages(role, standard, where, end, findings)


def _ages(role: str, standard: Standard, where: str, end: datetime, findings: Findings) -> None:
    """Note a specification that does not hold until the end of the run (B-PLAN-130)."""
    begun = datetime.combine(standard.calibrated, datetime.min.time(), UTC)
    ages_s = [line.age for line in standard.uncertainty if line.age is not None]
    if ages_s and end > begun + timedelta(seconds=min(ages_s)):
        message = (
            f"{role}: a specification holds {min(ages_s) / 86_400.0:g} days after the calibration of "
            f"{standard.calibrated}; the run ends {end:%Y-%m-%d}"
        )
        findings.add("B-PLAN-130", where, message, "register the specification that holds until the end, or calibrate")


def check_sets(plan: Plan, station: Station, findings: Findings) -> None:
    """Note units without a serial number (B-PLAN-025) and what nobody can do at a simulated bench (B-PLAN-094)."""
    for step in plan.steps:
        for name, value in step.sets.items():
            if value is None:
                continue  # its mistake is noted already
            if name == UNIT and not SERIAL.fullmatch(str(value)):
                findings.add("B-PLAN-025", step.where, f"unit {short(value)} {NO_SERIAL}")
            elif station.file.world is not None:
                _possible(station.file.world.name, name, value, step.where, findings)


def _possible(world: str, name: str, value: Any, where: str, findings: Findings) -> None:
    if offer_of("worlds", world) is None:
        return  # the check of the station says so
    simulation = import_module(SIMULATION)
    try:
        simulation.check_operation(world, name, value)
    except InputError as error:
        findings.add("B-PLAN-094", where, f"'sets': {error.message}", error.next_step)


def short(value: Any) -> str:
    """Return a value in quotes, cut where it is too long to be read."""
    text = repr(str(value))
    return text if len(text) <= 60 else f"{text[:56]}...'"


def check_units(plan: Plan, station: Station, findings: Findings) -> None:
    """Note a unit whose serial number or wiring nothing proves before it is measured (B-PLAN-142)."""
    where = station.document.where(("slots",)) if plan.units else ""
    for unit in plan.units:
        own = [step for step in plan.steps if step.conditions.get(UNIT) == unit.serial]
        for missing in _missing(unit, own):
            message = f"unit {unit.serial} in slot {unit.slot}: {missing}"
            findings.add("B-PLAN-142", where, message, "add it to 'prepare', inside 'for: unit', 'in: units'")


def _missing(unit: PlannedUnit, steps: Sequence[Step]) -> Iterator[str]:
    """Yield what is not proved of a unit, in words."""
    records = [step for step in steps if isinstance(step, PlannedRecord)]
    measured = [record for record in records if record.purpose == MEASUREMENT]
    if not measured:
        yield "nothing of it is measured"
        return
    before = [step for step in steps if step.number < measured[0].number]
    if not any(isinstance(step, PlannedCommand) and step.name == IDENTIFY for step in before):
        yield f"it is not asked for its serial number ({IDENTIFY!r}) before it is measured"
    wired = {_input(record) for record in before if isinstance(record, PlannedRecord) and record.purpose == WIRING}
    driven = {_input(record) for record in measured if record.conditions.get("polarity")}
    if unproved := sorted(driven - wired, key=str):
        channel, polarity = unproved[0]
        yield f"no wiring record proves channel {channel}, polarity {polarity}, before it is measured"


def _input(record: PlannedRecord) -> tuple[object, object]:
    return record.conditions.get("channel"), record.conditions.get("polarity")
