"""The summary of a plan for whoever runs it: how long, until when, how much disk, and what is dangerous about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import PurePath

from bench.model.clock import NS, VIRTUAL_START_UTC_NS
from bench.model.ports import Effect
from bench.model.units import format_quantity
from bench.plan.check.actions import NOT_JUDGED, Judged
from bench.plan.check.state import BenchState
from bench.plan.deciding import stop_lines
from bench.plan.decision import walk
from bench.plan.expected import round_count
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step
from bench.plan.station import declared_action
from bench.plan.step_kinds import PlannedCall, PlannedRecord, PlannedSend, PlannedSoak

STEP_BYTES = 400  # events, commands and replies of a step, with their envelopes
SECOND_BYTES = 150  # chunk and message indexes of a second
TEMPERATURES = ("chamber_air", "chamber_slope", "second_air", "unit_temperature", "unit_slope")
READING_BYTES = 1_500  # a reading of a record: its event, commands and replies, with their envelopes

Calls = Mapping[Effect, list[PlannedCall]]


@dataclass(frozen=True)
class Summary:
    """Key figures of a plan.

    ``duration_s`` is the campaign alone; ``finish_utc_ns`` and ``disk_bytes`` count what comes before and after it
    too (``prepare_s``, ``finally_s``). ``disk_bytes`` is an upper estimate without compression. ``hazards`` are
    sentences for the operator, ``unwatched`` too: what no interlock watches; ``slips``: what is hardly meant;
    ``stops``: which points may end early.
    """

    steps: int
    records: int
    prepare_s: float
    duration_s: float
    finally_s: float
    finish_utc_ns: int
    disk_bytes: int
    hazards: tuple[str, ...]
    unwatched: tuple[str, ...]
    slips: tuple[str, ...]
    stops: tuple[str, ...]


def summarise(plan: Plan, start_utc_ns: int = VIRTUAL_START_UTC_NS) -> Summary:
    """Return key figures of a plan that starts at ``start_utc_ns``."""
    total_s = plan.prepare_s + plan.duration_s + plan.finally_s
    records = [step for step in plan.steps if isinstance(step, PlannedRecord) and step.readings]
    readings = sum(len(record.readings) * round_count(record) for record in records)
    bytes_s = plan.link_bytes_s + SECOND_BYTES
    return Summary(
        steps=len(plan.steps),
        records=plan.record_count,
        prepare_s=plan.prepare_s,
        duration_s=plan.duration_s,
        finally_s=plan.finally_s,
        finish_utc_ns=start_utc_ns + round(total_s * NS),
        disk_bytes=round(total_s * bytes_s + STEP_BYTES * len(plan.steps) + READING_BYTES * readings),
        hazards=tuple(_hazards(plan)),
        unwatched=unwatched(plan),
        slips=tuple(_slips(plan)),
        stops=tuple(stop_lines(plan)),
    )


def unwatched(plan: Plan) -> tuple[str, ...]:
    """Return what no interlock of a plan watches, in sentences; a deviation of it is told, and nothing acts on it."""
    if not plan.interlocks:
        return ("no interlock is declared: whatever deviates is only told, nothing holds or ends the run",)
    heats = any(step.set_point is not None for step in plan.steps)
    if heats and not any(rule.signal in TEMPERATURES for rule in plan.interlocks):
        return (
            "no interlock watches the chamber or the unit's temperature: a runaway is only told until the guard acts",
        )
    return ()


def _slips(plan: Plan) -> Iterator[str]:
    """Return what can be run and is hardly meant: a name unlike that of its file, one place of two in an order."""
    for name, path in plan.files.items():
        if PurePath(name).name != PurePath(path).name:
            yield f"{path} calls itself {PurePath(name).stem}, and so do its results; give both one name"
    for order, count in Counter(entry.safe_order for entry in plan.station.instruments.values()).items():
        if count > 1:
            yield f"safe_order {order} is that of {count} instruments, made safe in the order of their names"


def _hazards(plan: Plan) -> Iterator[str]:
    declared = cache(partial(declared_action, plan.station))
    calls: dict[Effect, list[PlannedCall]] = {effect: [] for effect in Effect}

    def judge(step: Step) -> Judged:
        return Judged(declared(step.role, step.name), step.arguments) if isinstance(step, PlannedCall) else NOT_JUDGED

    state = BenchState(plan, plan.station, Findings(), judge)  # what is on before every instrument is made safe
    for step in plan.steps:
        if isinstance(step, PlannedCall) and (action := declared(step.role, step.name)) is not None:
            calls[action.effect].append(step)
    (ends,) = walk(plan.steps, Findings(), state)
    for told in (_stimulus, _thermal, _power, _motion, _raw, _afterwards):
        yield from told(plan, calls)
    for role in sorted({role for end in ends if isinstance(end, BenchState) for role in end.energised}):
        yield f"{role}: on until it is made safe at the end"


def _highest(calls: list[PlannedCall], argument: str) -> dict[str, float]:
    highest: dict[str, float] = {}
    for call in calls:
        value = call.quantity(argument)
        if value is not None:
            highest[call.role] = max(abs(value), highest.get(call.role, 0.0))
    return highest


def _stimulus(plan: Plan, calls: Calls) -> list[str]:
    set_steps, on = calls[Effect.STIMULUS_SET], calls[Effect.STIMULUS_ON]
    return [
        f"{role}: up to {format_quantity(level, 'A')}, switched on {sum(s.role == role for s in on)} times"
        for role, level in _highest(set_steps, "current").items()
    ]


def _thermal(plan: Plan, calls: Calls) -> list[str]:
    by_role: dict[str, list[float]] = {}
    soaks = [step for step in plan.steps if isinstance(step, PlannedSoak)]
    asked: list[tuple[str, float | None]] = [(soak.role, soak.temperature_degC) for soak in soaks]
    asked += [(call.role, call.quantity("temperature")) for call in calls[Effect.THERMAL]]
    for role, value in asked:
        if value is not None:
            by_role.setdefault(role, []).append(value)
    return [f"{role}: {min(values):g} degC to {max(values):g} degC" for role, values in by_role.items()]


def _power(plan: Plan, calls: Calls) -> list[str]:
    volts = _highest(calls[Effect.POWER], "voltage")
    return [f"{role}: up to {format_quantity(level, 'V')}" for role, level in volts.items()]


def _motion(plan: Plan, calls: Calls) -> list[str]:
    closed = [call.role for call in calls[Effect.MOTION_ON] if call.axis is None]
    rates = _highest(calls[Effect.MOTION_ON], "rate")
    return [
        f"{role}: moves at up to {rates.get(role, 0.0):g} deg/s, interlock closed {closed.count(role)} times; "
        "nobody may stand at it"
        for role in sorted(set(closed))
    ]


def _raw(plan: Plan, calls: Calls) -> list[str]:
    roles = sorted({step.role for step in plan.steps if isinstance(step, PlannedSend)})
    return [f"{role}: takes raw commands, which the check cannot look into" for role in roles]


def _afterwards(plan: Plan, calls: Calls) -> list[str]:
    return [
        f"{step.role}: after the campaign {step.temperature_degC:g} degC for {step.duration_s:g} s; "
        "only then may it be opened"
        for step in plan.phase("finally")
        if isinstance(step, PlannedSoak)
    ]
