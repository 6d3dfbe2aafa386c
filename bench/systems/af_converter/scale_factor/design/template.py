"""What a given scale-factor campaign does at a temperature and between two of them: what any other is made of.

The orders in which temperatures may be visited: from one of them out, back to it in the middle, and back at the end.

The reference channels are read there three times, so that a drift shows over the whole campaign and its two parts.
Source: docs/method-uncertainty.md; Daniel and Wilcoxon, Technometrics 8 (1966), on orders robust against drift.

Writes a campaign as a sequence: the given text with other tables, record length, temperatures and repeats.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, permutations
from typing import Any

import numpy as np

from bench.design import SequenceText
from bench.model.errors import InputError
from bench.model.units import parse_quantity
from bench.plan import MEASUREMENT, LAB_AIR_degC, Plan, PlannedRecord, PlannedSoak

COEFFICIENTS = 3  # of the polynomial over temperature
MIDDLE, CLOSING = 1, 2  # numbers of the repeats
_FORM = "temperatures, soaked one after the other, each with the same points of every channel"
_REFERENCE = re.compile(r"\{(\w+)\}")
_REPEAT = re.compile(r"\brepeat: *\d+")
ARRIVE = "arrive"  # procedure: the soak, and what is done before the channels


@dataclass(frozen=True, order=True)
class Stop:
    """A temperature that is soaked at; ``repeat``: 0 for the visit of all channels, else which repeat it is."""

    temperature_degC: float
    repeat: int = 0


Tour = tuple[Stop, ...]


def tours(temperatures_degC: Sequence[float]) -> Iterator[Tour]:
    """Yield every tour of some of the temperatures with the lowest and the highest, one more than coefficients."""
    lowest, *inner, highest = sorted(temperatures_degC)
    for left_out in range(len(inner) - (COEFFICIENTS - 1) + 1):
        for kept in combinations(inner, len(inner) - left_out):
            yield from _round((lowest, *kept, highest))


def _round(temperatures_degC: tuple[float, ...]) -> Iterator[Tour]:
    for home in temperatures_degC:
        others = [degC for degC in temperatures_degC if degC != home]
        for order in permutations(others):
            for middle in range(1, len(order)):
                out, on = ([Stop(degC) for degC in part] for part in (order[:middle], order[middle:]))
                yield (Stop(home), *out, Stop(home, MIDDLE), *on, Stop(home, CLOSING))


def missing_repeats(tour: Tour) -> list[str]:
    """Return which of opening, middle and closing visit of one temperature a tour lacks."""
    first, last = tour[0], tour[-1]
    closed = last.repeat > 0 and last.temperature_degC == first.temperature_degC and first.repeat == 0
    middle = any(stop.repeat and stop.temperature_degC == first.temperature_degC for stop in tour[1:-1])
    return [name for name, there in (("opening and closing", closed), ("middle", middle)) if not there]


def is_monotone(tour: Tour) -> bool:
    """Return whether the first visits go through the temperatures in one direction."""
    steps = np.diff([stop.temperature_degC for stop in tour if stop.repeat == 0])
    return bool(np.all(steps > 0) or np.all(steps < 0))


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


def write_levels(text: SequenceText, template: Template, levels_A: Sequence[tuple[float, ...]]) -> None:
    """Leave out of the tables the levels that are not taken."""
    for name, values in text.tree.get("tables", {}).items():
        known_A = [parse_quantity(value, "A") for value in values]
        for given_A, kept_A in zip(template.levels_A, levels_A, strict=True):
            if set(known_A) - {0.0} == set(given_A) and set(kept_A) != set(given_A):
                kept = [value for value, level_A in zip(values, known_A, strict=True) if level_A in {0.0, *kept_A}]
                left = [value for value in values if value not in kept]
                text.set_value(("tables", name), f"[{', '.join(kept)}]", f"without {', '.join(left)}")


def write_length(text: SequenceText, length_s: float, given_s: float) -> None:
    """Give the records another length. Raises: InputError B-DES-005 if that is not one parameter."""
    lengths = {str(length) for length in _seconds(text.tree.get("procedures", {}))}
    references = {match[1] for length in lengths if (match := _REFERENCE.fullmatch(length))}
    names = references & text.tree.get("parameters", {}).keys()
    if len(names) != 1:
        raise _not_writable(text, ("procedures",))
    if length_s != given_s:
        text.set_value(("parameters", names.pop()), f"{length_s:g} s", f"{given_s:g} s before")


def _seconds(value: Any) -> Iterator[Any]:
    """Yield the lengths of all measuring records in a part of a sequence."""
    if isinstance(value, dict):
        record = value.get("record")
        if isinstance(record, dict) and "purpose" not in record:
            yield record.get("seconds")
        for part in value.values():
            yield from _seconds(part)
    elif isinstance(value, list):
        for part in value:
            yield from _seconds(part)


def write_stops(
    text: SequenceText,
    stops: Tour,
    channels: Sequence[tuple[int, ...]],
    slots_s: Sequence[float],
    why: str,
) -> None:
    """Write the temperatures in their order, each with its slot, and why these are as long as they are.

    Raises: InputError B-DES-005 for another form.
    """
    loop = ("steps", 0, "do")
    body = _entry(text, loop, list)
    last = (*loop, len(body) - 1)
    again = _again(text)
    if "soak" not in body[0] or _entry(text, last, dict).get("in") != "channels":
        raise _not_writable(text, loop)
    slot = str(body[0]["soak"].get("slot"))
    text.set_value((*loop, 0, "soak", "slot"), '"{slot}"', "")
    arrival = "\n".join(line for number in range(len(body) - 1) for line in text.block((*loop, number)))
    lines = textwrap.indent(textwrap.dedent(arrival), " " * 6)
    points = _dedented(text, (*last, "do"))
    text.replace_below(("steps",), list(_stop_lines(stops, channels, slots_s, points, again)))
    heading = [f"  {ARRIVE}:", "    arguments: {slot: required}", "    do:", *lines.splitlines(), ""]
    text.insert_below(("procedures",), [f"  # The soak to a temperature, with slots{why}.", *heading])
    _drop_slot(text, slot)


def _again(text: SequenceText) -> list[str]:
    """Return what is done with a channel that is repeated."""
    loop = ("steps", 1, "do")
    body = _entry(text, loop, list)
    last = (*loop, len(body) - 1)
    if len(body) != 1 or "for" not in _entry(text, last, dict):
        raise _not_writable(text, ("steps",))
    return _dedented(text, (*last, "do"))


def _dedented(text: SequenceText, path: tuple[str | int, ...]) -> list[str]:
    lines = text.block(path)[1:]
    if not lines:  # all in one line
        raise _not_writable(text, path)
    return textwrap.dedent("\n".join(lines)).splitlines()


def _entry(text: SequenceText, path: tuple[str | int, ...], kind: type) -> Any:
    """Return a value of the sequence. Raises: InputError B-DES-005 if there is none of this kind."""
    value: Any = text.tree
    try:
        for part in path:
            value = value[part]
    except (KeyError, IndexError, TypeError) as error:
        raise _not_writable(text, ("steps",)) from error
    if not isinstance(value, kind) or not value:
        raise _not_writable(text, ("steps",))
    return value


def _stop_lines(
    stops: Tour, channels: Sequence[tuple[int, ...]], slots_s: Sequence[float], points: list[str], again: list[str]
) -> Iterator[str]:
    for number, (stop, chosen, slot_s) in enumerate(zip(stops, channels, slots_s, strict=True)):
        what = f"repeat {stop.repeat}: what has drifted since the opening" if stop.repeat else ""
        what = "the opening, which the repeats are held against" if number == 0 else what
        yield f"  - for: temperature{f'  # {what}' if what else ''}"
        yield f"    in: [{stop.temperature_degC:g} degC]"
        yield "    do:"
        if slot_s:
            yield f"      - {ARRIVE}: {{slot: {slot_s:g} s}}"
        yield "      - for: channel"
        of_some = ", ".join(map(str, chosen))
        yield f"        in: {f'{{channels: [{of_some}]}}' if chosen else 'channels'}"
        yield "        do:"
        for line in again if stop.repeat else points:
            yield " " * 10 + (_REPEAT.sub(f"repeat: {stop.repeat}", line) if stop.repeat else line)


def _drop_slot(text: SequenceText, slot: str) -> None:
    """Leave out the parameter of the slot if nothing else reads it."""
    match = _REFERENCE.fullmatch(slot)
    if match and match[1] in text.tree.get("parameters", {}) and text.count(slot) == 1:
        text.remove(("parameters", match[1]))


def _not_writable(text: SequenceText, path: tuple[str | int, ...]) -> InputError:
    message = f"the sequence cannot be written in the place of this one, which is not of the form: {_FORM}"
    return InputError("B-DES-005", message, where=text.where(path), next_step="begin with the shipped scale_factor_38h")
