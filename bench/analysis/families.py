"""Families of departures: those that labels of the readings make, and how a departure is said.

Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from bench.analysis.departures import OF_SHAPES, OF_TIME, Departure, Search, Unseen
from bench.analysis.doubt import CERTAIN, DEPARTS, LEAST_MOVE, TOGETHER, Evidence
from bench.analysis.figures import Table, worded_table
from bench.analysis.wording import say
from bench.maths.arrays import Flags, Floats, Integers

_LEAST = 1e-3  # of its size: what is smaller in all readings, such as a warm-up long ago, is none

Words = Callable[[str, Any], str]  # a label, carrier or scale and its value, as a person says it


def general_advice(departure: Departure) -> str:
    """Return what to look for, by the shape of a departure."""
    return say(f"departs.advice.{_kind(departure)}")


@dataclass(frozen=True)
class Searched:
    """A search and how a person names the labels of its rows.

    ``advice``: what to look for.
    """

    found: Search
    words: Words
    advice: Callable[[Departure], str] = general_advice

    @property
    def evidence(self) -> list[Evidence]:
        """Say what the search has against the estimates, one entry for each thing."""
        found, stated, evidence = self.found, self.found.stated, []
        for finding in found.findings:
            moved = (finding.moves > LEAST_MOVE) & found.doubted
            if moved.any():
                named, *others = (described(one, self.words) for one in (finding.departure, *finding.equals))
                alike = [name for name in dict.fromkeys(others) if name != named]
                said = say(
                    "departs",
                    what=named,
                    size=f"{finding.size:+.3g} {finding.departure.unit}",
                    move=(move := float(finding.moves.max())),
                    others=say("departs.others", others=say.listed(alike[:_NAMED], "departs.either")) if alike else "",
                    advice=self.advice(finding.departure),
                )
                entries = [entry for entry, hit in zip(stated, moved, strict=True) if hit]
                evidence.append(Evidence(DEPARTS, said, finding.size, CERTAIN, move, entries=entries))
        several = [entry for entry, rests in zip(stated, found.together, strict=True) if rests]
        if several:
            evidence.append(Evidence(TOGETHER, say("departs.together"), None, CERTAIN, entries=several))
        left = [entry for entry, grown in zip(stated, found.unexplained, strict=True) if grown > LEAST_MOVE]
        if not found.is_noise:
            said, ratio = say("unexplained", chi2=found.chi2, dof=found.dof), found.chi2 / max(found.dof, 1)
            move = float(found.unexplained.max(initial=0.0))
            evidence.append(Evidence("unexplained", said, ratio, CERTAIN, move, entries=left or stated))
        return evidence


def evidence_of(searches: Iterable[Searched]) -> list[Evidence]:
    """Return what all searches say against their estimates."""
    return [seen for searched in searches for seen in searched.evidence]


def unseen_tables(searches: Iterable[Searched]) -> list[Table]:
    """Return a table of what moves an estimate by its uncertainty and would not have been found, with what size: of
    each kind the one that moves first in any of the searches. Empty without searches.
    """

    def size(value: float, unit: str) -> str:
        return f"{value:.2g} {unit}" if math.isfinite(value) else say("unseen.never")

    first: dict[str, tuple[Unseen, Searched]] = {}
    for searched in searches:
        for one in searched.found.unseen:
            family = one.departure.family
            first[family] = min(first.get(family, (one, searched)), (one, searched), key=lambda pair: pair[0].size)
    rows = []
    for one, searched in first.values():
        name, unit = described(one.departure, searched.words), one.departure.unit
        rows.append([name, searched.found.stated[one.first].quantity, size(one.size, unit), size(one.seen, unit)])
    return [worded_table(say, "unseen", ["what", "first", "size", "seen"], rows, prose=True)] if rows else []


def described(departure: Departure, words: Words) -> str:
    """Return a departure in words: what it is of, where, and its shape."""
    kind, about = _kind(departure), dict(departure.about)
    shape = {name: about.pop(name) for name in OF_SHAPES if name in about}
    level = about.pop(departure.of or "value", None)
    shape |= {name: _duration(shape[name]) for name in ("after", "hours") if name in shape}
    if kind == "own":
        how = words(departure.shape, level)
    elif kind == "constant":
        how = ""
    else:
        at = words(departure.of, level) if departure.of else ""
        how = say(f"departs.{kind}", **shape, at=at, scale=at, power=departure.power)
    of = words(departure.carrier, None) if departure.carrier else ""
    parts = [of, *(words(name, value) for name, value in about.items()), how]
    return say.listed([part for part in parts if part], "departs.parts")


def _duration(hours: float) -> str:
    size, unit = next(((size, unit) for size, unit in _UNITS if hours * size >= 1.0), _UNITS[-1])
    return f"{hours * size:.3g} {unit}"


def _kind(departure: Departure) -> str:
    return departure.shape if departure.shape in _GENERAL else "own"


# --- departures that labels make --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Labels:
    """Labels of the readings of a fit, (r,) each: ``kinds`` have values, ``scales`` are numbers with powers to try.

    ``hours``: time; ``visit``: which readings follow each other.   ``carriers``: by name unit and what the readings
    (r,) gain if something is off by 1 everywhere.   ``scopes``: kinds whose values may confine a departure of any
    shape; ``corners``: those that may confine what one value of a further kind does.   ``exchanged``: items of one kind
    that could be taken for each other, their kind, their sides and the carrier.   ``own``: by carrier and scale
    up to which size a power of it may be an item's own.   ``steps_within``: whether something may step inside a visit.
    """

    kinds: Mapping[str, Any]
    hours: Floats
    visit: Integers
    carriers: Mapping[str, tuple[str, Floats]]
    scales: Mapping[str, tuple[Floats, Sequence[int]]] = field(default_factory=dict)
    scopes: Sequence[tuple[str, ...]] = ((),)
    corners: Sequence[tuple[str, ...]] = ()
    exchanged: tuple[str, str, str, str] | None = None
    own: Mapping[tuple[str, str], float] = field(default_factory=dict)
    steps_within: bool = True

    @property
    def begins_h(self) -> dict[int, float]:
        """When each visit begins, hours after the first."""
        since_h = self.hours - self.hours.min()
        return {visit: float(since_h[self.visit == visit].min()) for visit in np.unique(self.visit).tolist()}


_UNITS = ((1.0, "h"), (60.0, "min"), (3600.0, "s"))
_GENERAL = (*OF_TIME, "at", "power", "size", "constant", "exchanged", "tail", "onset")
_NAMED = 2  # of the other explanations
_DAY_h, _LONGEST = 24.0, 8.0  # of the time that the readings take: a longer cycle is a drift
_SETTLES = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the time that the readings take
_CYCLES = (2.0, 1.5, 1.2, 1.0, 0.8, 0.65, 0.5, 0.4, 0.32, 0.25, 0.2, 0.16)


def departures_of(labels: Labels) -> list[Departure]:
    """Return the general departures: each value of a label, steps, drifts, cycles, powers and memory, in all scopes."""
    found = [
        Departure(carrier, "step_in_a_visit", unit, (one * behind)[:, None], about)
        for about, behind in (_within(labels) if labels.steps_within else ())
        for carrier, (unit, one) in labels.carriers.items()
    ]
    if labels.exchanged:
        found += _exchanged(labels, *labels.exchanged)
    values, others = list(_values(labels)), list(_shapes(labels))
    in_visits = {"step", "visit", *(name for name in labels.kinds if _is_of_visit(labels, name))}
    tried = [*((scope, values + others) for scope in labels.scopes), *((scope, values) for scope in labels.corners)]
    seen: set[bytes] = set()
    for scope, shapes in tried:
        for where, inside in _places(labels.kinds, scope):
            for carrier, (unit, one) in labels.carriers.items():
                everywhere = one * inside
                for shape in shapes:
                    effect = everywhere[:, None] * shape.column.reshape(one.size, -1)
                    key = effect.tobytes()
                    if shape.of not in where and key not in seen and np.abs(effect).max() > _LEAST * np.abs(one).max():
                        seen.add(key)
                        own = labels.own.get((carrier, shape.of), 0.0) if shape.power > 0 else 0.0
                        whole = everywhere if {shape.name, shape.of} & in_visits else None
                        about = {**where, **shape.about}
                        found.append(
                            Departure(carrier, shape.name, unit, effect, about, shape.of, shape.power, own, whole)
                        )
    return found


def _is_of_visit(labels: Labels, name: str) -> bool:
    column = np.asarray(labels.kinds[name])
    return all(np.unique(column[labels.visit == visit]).size == 1 for visit in labels.begins_h)


def _places(kinds: Mapping[str, Any], scope: tuple[str, ...]) -> Iterable[tuple[dict[str, Any], Flags]]:
    columns = [np.asarray(kinds[name]) for name in scope]
    everywhere = np.ones(len(next(iter(kinds.values()))), bool)
    for values in dict.fromkeys(zip(*(column.tolist() for column in columns), strict=True)) if scope else [()]:
        inside = [everywhere, *(column == value for column, value in zip(columns, values, strict=True))]
        yield dict(zip(scope, values, strict=True)), np.all(inside, axis=0)


def _exchanged(labels: Labels, item: str, kind: str, side: str, carrier: str) -> Iterable[Departure]:
    """Yield what two items of a kind gain and lose that are exchanged from a visit on, a column for each side."""
    items, kinds, sides = (np.asarray(labels.kinds[name]) for name in (item, kind, side))
    (unit, one), since_h = labels.carriers[carrier], labels.hours - labels.hours.min()
    for a, b in combinations(dict.fromkeys(items.tolist()), 2):
        begins_h = {at for visit, at in labels.begins_h.items() if items[labels.visit == visit][0] in (a, b)}
        for at in sorted(begins_h)[1:] if kinds[items == a][0] == kinds[items == b][0] else ():
            moved = (1.0 * (items == a) - (items == b)) * (since_h >= at) * one
            columns = np.column_stack([moved * (sides == value) for value in np.unique(sides)])
            yield Departure("", "exchanged", unit, columns, {"pair": f"{a}, {b}", "hours": at})


def _within(labels: Labels) -> Iterable[tuple[dict[str, Any], Flags]]:
    """Yield what lies behind each reading of a visit but its first; readings at one time are one record."""
    number = np.arange(labels.visit.size)
    for visit in labels.begins_h:
        inside = number[labels.visit == visit]
        for record, at in enumerate(inside[np.diff(labels.hours[inside], prepend=np.inf) > 0.0].tolist(), start=2):
            yield {"visit": visit, "record": record}, (labels.visit == visit) & (number >= at)


class _Shape(NamedTuple):
    """A column over the readings, (r,) or (r, 2), by name; ``of`` a label or scale."""

    name: str
    column: Floats
    about: Mapping[str, Any] = MappingProxyType({})
    of: str = ""
    power: int = 0


def _values(labels: Labels) -> Iterable[_Shape]:
    for name, column in labels.kinds.items():
        for value in dict.fromkeys(np.asarray(column).tolist()):
            yield _Shape("at", 1.0 * (np.asarray(column) == value), {name: value}, name)


def _shapes(labels: Labels) -> Iterable[_Shape]:
    """Yield shapes of time and of scales."""
    since_h, begins_h = labels.hours - labels.hours.min(), labels.begins_h
    for visit in begins_h:
        yield _Shape("visit", 1.0 * (labels.visit == visit), {"visit": visit})
    for before, at in pairwise(sorted(begins_h.values())):
        yield _Shape("step", 1.0 * (since_h >= at), {"after": before, "hours": at})
    span_h = max(float(np.ptp(since_h)), 1e-9)
    yield _Shape("drift", since_h / span_h)
    for part in _SETTLES:
        yield _Shape("warm_up", np.exp(-since_h / (part * span_h)), {"hours": part * span_h})
    day_h = (_DAY_h,) if _DAY_h < _LONGEST * span_h else ()
    for period_h in (*day_h, *(part * span_h for part in _CYCLES)):
        angle = 2.0 * np.pi * since_h / period_h
        yield _Shape("cycle", np.column_stack([np.sin(angle), np.cos(angle)]), {"hours": period_h})
    for name, (scale, powers) in labels.scales.items():
        for power in powers:
            yield _Shape("power", scale**power, of=name, power=power)
        yield _Shape("size", np.abs(scale), of=name)
