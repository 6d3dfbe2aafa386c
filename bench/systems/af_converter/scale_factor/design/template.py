"""What a given scale-factor campaign does at a temperature and between two of them: what any other is made of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from bench.model.errors import InputError
from bench.plan import MEASUREMENT, LAB_AIR_degC, Plan, PlannedRecord, PlannedSoak
from bench.systems.af_converter.scale_factor.design.tours import Stop

_FORM = "temperatures, soaked one after the other, each with the same points of every channel"


@dataclass(frozen=True)
class Point:
    """A record of a visit: what it is taken under, and the time from the one before it."""

    conditions: Mapping[str, Any]
    lead_s: float

    @property
    def level_A(self) -> float:
        """Current, 0 for an open input and a zero."""
        return abs(float(self.conditions.get("current_A") or 0.0))


@dataclass(frozen=True)
class Template:
    """The visits of the channels, and what comes between.

    ``points``: of a visit, by channel, in the order of the channels.   ``levels_A``: of the channels of a group, which
    are alike, by their first channel.   ``again``: channels of the repeats before the last, and of the last.
    ``start_degC``: where the chamber was left.
    """

    points: Mapping[int, tuple[Point, ...]]
    groups: Sequence[tuple[int, ...]]
    levels_A: Sequence[tuple[float, ...]]
    stops: tuple[Stop, ...]
    slots_s: tuple[float, ...]
    again: tuple[tuple[int, ...], tuple[int, ...]]
    dwell_s: float
    soak: PlannedSoak
    start_degC: float
    begin_s: float

    def group_of(self, channel: int) -> int:
        """Return the number of the group of a channel."""
        return next(number for number, group in enumerate(self.groups) if channel in group)

    def steps_degC(self, stops: Sequence[Stop]) -> list[float]:
        """Return by how much the temperature changes to each stop."""
        before = [self.start_degC, *(stop.temperature_degC for stop in stops)]
        return [abs(after - earlier) for earlier, after in pairwise(before)]


def template_of(plan: Plan) -> Template:
    """Read the parts of a campaign from its plan. Raises: InputError B-DES-005 for one of another form."""
    steps = [step for step in plan.phase("campaign") if isinstance(step, PlannedSoak | PlannedRecord)]
    records = [step for step in steps if isinstance(step, PlannedRecord) and step.purpose == MEASUREMENT]
    soaks = [step for step in steps if isinstance(step, PlannedSoak)]
    lengths = {step.seconds for step in records}
    if not soaks or steps[0] is not soaks[0] or len(lengths) != 1:
        raise _other_form(plan, "records of one length behind a soak")
    first_degC = soaks[0].temperature_degC
    first = [step for step in records if step.conditions["temperature_degC"] == first_degC and not _repeat(step)]
    points: dict[int, list[Point]] = {}
    end_s = soaks[0].duration_s
    for step in first:
        points.setdefault(step.conditions["channel"], []).append(Point(step.conditions, step.at_s - end_s))
        end_s = step.at_s + step.seconds
    groups = _groups(plan, points)
    stops, slots_s = _stops(steps)
    again = [_channels(records, stop) for stop in stops if stop.repeat] or [groups[0][:1]]
    left = [step.temperature_degC for step in plan.phase("finally") if isinstance(step, PlannedSoak)]
    template = Template(
        points={channel: tuple(visit) for channel, visit in points.items()},
        groups=groups,
        levels_A=[tuple(sorted({point.level_A for point in points[group[0]]} - {0.0})) for group in groups],
        stops=stops,
        slots_s=slots_s,
        again=(again[0], again[-1]),
        dwell_s=records[0].seconds,
        soak=soaks[0],
        start_degC=left[-1] if left else LAB_AIR_degC,
        begin_s=plan.prepare_s,
    )
    _check(plan, template, records)
    return template


def _channels(records: Sequence[PlannedRecord], stop: Stop) -> tuple[int, ...]:
    """Return the channels of a stop, in their order."""
    there = (step.conditions for step in records if _stop(step) == stop)
    return tuple(dict.fromkeys(conditions["channel"] for conditions in there))


def _stop(step: PlannedRecord) -> Stop:
    return Stop(float(step.conditions["temperature_degC"]), _repeat(step))


def _repeat(step: PlannedRecord) -> int:
    return int(step.conditions.get("repeat", 0))


def _groups(plan: Plan, points: Mapping[int, object]) -> list[tuple[int, ...]]:
    """Return the channels that have the same constants and levels, in the order of their first ones."""
    alike: dict[str, list[int]] = {}
    for constants in plan.campaign["channels"]:
        if constants["number"] in points:
            told = repr({key: value for key, value in constants.items() if key != "number"})
            alike.setdefault(told, []).append(constants["number"])
    return [tuple(group) for group in alike.values()]


def _stops(steps: Sequence[PlannedSoak | PlannedRecord]) -> tuple[tuple[Stop, ...], tuple[float, ...]]:
    stops: list[Stop] = []
    slots_s: list[float] = []
    slot_s = 0.0
    for step in steps:
        if isinstance(step, PlannedSoak):
            slot_s += step.duration_s
            continue
        stop = _stop(step)
        if not stops or stops[-1] != stop:
            stops.append(stop)
            slots_s.append(slot_s)
            slot_s = 0.0
    return tuple(stops), tuple(slots_s)


def _check(plan: Plan, template: Template, records: Sequence[PlannedRecord]) -> None:
    """Refuse a campaign that the template does not give again, to the second."""
    visits = {
        channel: math.fsum(point.lead_s + template.dwell_s for point in visit)
        for channel, visit in template.points.items()
    }
    stays = [_channels(records, stop) for stop in template.stops]
    length_s = math.fsum([*template.slots_s, *(visits.get(channel, math.nan) for stay in stays for channel in stay)])
    if not math.isclose(length_s, plan.duration_s, rel_tol=1e-9) or len(records) != plan.record_count:
        raise _other_form(plan, f"{length_s:.10g} s by its parts, {plan.duration_s:.10g} s by plan")


def _other_form(plan: Plan, why: str) -> InputError:
    message = f"a shorter plan is made of {_FORM}, which {plan.name} is not ({why})"
    return InputError("B-DES-005", message, where=plan.name, next_step="begin with the shipped scale_factor_38h")
