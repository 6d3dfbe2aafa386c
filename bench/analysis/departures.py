"""Departures: what could be true instead of the model, each a column on the rows of a fit; one engine for all systems.

A fit hands over what it leaves (``Residuals``) and the departures that its labels make; the engine says which the data
show, and how far each would move every estimate.

A score is d' P e / |P d|, P the projection on what the fit leaves over; its threshold is shared by all columns that
the data can show (union bound), and what the best leaves over is searched again.
Source: docs/decisions/0052-departures.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from bench.analysis.doubt import CERTAIN, DEPARTS, FALSE_DOUBT, LEAST_MOVE, Evidence
from bench.analysis.estimates import Estimate
from bench.analysis.wording import say
from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.tests import f_tail

_SEEN = 1e-6  # of a column: what the projection leaves of one that no data can show is rounding
_ALIKE = 9.0  # of twice a log-likelihood: less says nothing on which of two is true
_NEARLY = 0.02  # of it: shapes are never exactly those of the world
_AT_ONCE = 1000  # columns: what is computed of them beside takes no more memory than a few of these
_MOST = 20  # departures, and shapes that are an item's own
_PARTS = (0.0, *np.logspace(-6.0, 0.0, 13).tolist())  # of the largest variance of the scatter
_LEAST = 1e-3  # of its size: what is smaller in all readings, such as a warm-up long ago, is none
_SAME = 1e-4  # columns that differ by less are one


@dataclass(frozen=True)
class Departure:
    """Something that could be true instead of the model, in a size of 1 ``unit``.

    ``family``: names its sentence.   ``effect``: on the readings, (r, g), in their unit; several columns are one
    departure of which only the direction is unknown, such as a phase.   ``about``: label values that it is confined to.
    ``whole`` (r,): the same in all visits, of what is in some of them: the data do not say which visits are right.
    ``is_own``: the item may be so, as a further order of its curve, which the uncertainty of coefficients carries.
    """

    family: str
    unit: str
    effect: Floats
    about: Mapping[str, Any] = field(default_factory=dict)
    is_own: bool = False
    whole: Floats | None = None


@dataclass(frozen=True)
class Residuals:
    """Residuals of a fit, its rows, and how its estimates follow from them.

    ``readings`` (r,). ``white`` (n,): residuals in units of their noise; ``design`` (n, p): derivatives of the model in
    the same units; errors of standards and other priors are rows of their own. ``whiten``: columns (r, c) of readings
    to (n, c). ``scatter`` (n, s): what repeats scatter by beyond their noise, each column at the largest that is right;
    by how much they do is not known. ``noise_dof``: degrees of freedom of the estimate of the noise. ``operator``
    (k, r): what an estimate gains per unit of each reading. ``expanded``, ``noise`` (k,): its expanded uncertainty, and
    the part of it that the noise makes. ``on_curve`` (k,): coefficients of curves, which carry what these leave over.
    """

    readings: Floats
    white: Floats
    design: Floats
    scatter: Floats
    whiten: Callable[[Floats], Floats]
    operator: Floats
    expanded: Floats
    noise: Floats
    on_curve: Flags
    noise_dof: float = math.inf


@dataclass(frozen=True)
class Finding:
    """A departure that the data show: its ``size`` in its unit and what it takes off twice the log-likelihood.

    ``equals``: departures that explain the rows as well, the best first. ``move`` (k,): by how much of its expanded
    uncertainty it moves each estimate; ``moves`` (k,): the most by which one does that explains them nearly as well.
    """

    departure: Departure
    size: float
    gain: float
    equals: Sequence[Departure]
    move: Floats
    moves: Floats


@dataclass(frozen=True)
class Search:
    """Outcome of a search: departures, and a chi-square that none explains.

    ``unexplained`` (k,): by what part each uncertainty would grow if the noise were as large as what is left over; 1
    where one departure is not enough. ``is_noise``: the chi-square may be chance.
    """

    findings: Sequence[Finding]
    chi2: float
    dof: int
    is_noise: bool
    unexplained: Floats

    @property
    def doubted(self) -> Flags:
        """Which estimates (k,) are not sound; what is an item's own is none where nothing else departs."""
        departs = not all(finding.departure.is_own for finding in self.findings)
        moved = [finding.moves > LEAST_MOVE for finding in self.findings if departs]
        return np.asarray(np.any([*moved, self.unexplained > LEAST_MOVE], axis=0))


def search(rows: Residuals, departures: Sequence[Departure], share: float = 1.0) -> Search:
    """Search the residuals of a fit for departures.

    Args:    departures: all that could be true.   share: of the chance of a false doubt that this fit may use.
    Returns: Search.
    Raises:  nothing.
    Source:  Cook and Weisberg, Residuals and Influence in Regression (1982), 2.2 (added columns); union bound over
             columns that differ; profile likelihood of the scatter, its null by Student's t.
    """
    left = _Left(rows, departures)
    chance = FALSE_DOUBT * share / 2.0 / max(left.distinct(), 1)
    findings: list[Finding] = []
    departing = np.zeros(rows.readings.size, bool)
    further = np.zeros(rows.expanded.size)
    while len(findings) < _MOST:
        gains, sizes = left.fitted()
        best = int(np.argmax(gains / left.bounds(chance)))
        if gains[best] < left.bounds(chance)[best]:
            break
        near = np.flatnonzero(left.visible & (gains[best] - gains < max(_ALIKE, _NEARLY * gains[best])))
        alike = near[np.argsort(-gains[near])].tolist()
        judged = [at for at in alike if not (_touched(departures[at]) & ~departing).any()] or alike
        findings.append(_finding(rows, departures, best, judged, gains, sizes))
        if (_touched(departures[judged[0]]) & departing).any():
            further = np.maximum(further, np.abs(rows.operator) @ _touched(departures[judged[0]]) > 0.0)
        departing |= _touched(departures[best]) & (not departures[best].is_own)
        left.take_out(best)
    chi2, dof = left.chi2()
    is_noise = not dof or f_tail(chi2 / dof, dof, rows.noise_dof) > FALSE_DOUBT * share / 2.0
    excess = 0.0 if is_noise else chi2 / dof - 1.0
    grown = np.sqrt(1.0 + excess * (rows.noise / rows.expanded) ** 2) - 1.0
    return Search(findings, chi2, dof, is_noise, np.where(rows.on_curve, 0.0, np.maximum(grown, further)))


def _touched(departure: Departure) -> Flags:
    return np.asarray(departure.effect.any(axis=1))


def _finding(
    rows: Residuals, departures: Sequence[Departure], best: int, judged: Sequence[int], gains: Floats, sizes: Floats
) -> Finding:
    """Return a departure with what it moves, and what those move that are ``judged`` with it."""
    effects = {at: departures[at].effect @ sizes[at, : departures[at].effect.shape[1]] for at in {best, *judged}}
    other_sides = [effects[at] - sizes[at, 0] * whole for at in judged if (whole := departures[at].whole) is not None]
    found = departures[best]
    return Finding(
        departure=found,
        size=float(np.linalg.norm(sizes[best])) if found.effect.shape[1] > 1 else float(sizes[best, 0]),
        gain=float(gains[best]),
        equals=[departures[at] for at in judged if gains[best] - gains[at] < _ALIKE],
        move=_moves(rows, effects[best]),
        moves=np.max([_moves(rows, effect) for effect in (*(effects[at] for at in judged), *other_sides)], axis=0),
    )


def _moves(rows: Residuals, effect: Floats) -> Floats:
    """Return by how much of its expanded uncertainty an effect on the readings, (r,), moves each estimate, (k,).

    To second order: what is in proportion to a reading changes it by the square of its part, too.
    """
    large = np.abs(rows.readings) > np.abs(effect)
    square = np.divide(effect**2, rows.readings, out=np.zeros_like(effect), where=large)
    return np.asarray((np.abs(rows.operator @ effect) + np.abs(rows.operator @ square)) / rows.expanded)


class _Left:
    """Residuals (n,), columns of all departures (n, c) and scatter, as the fit leaves them.

    ``first``, ``second`` (d,): the columns of a departure; -1 where it has no second one.
    """

    def __init__(self, rows: Residuals, departures: Sequence[Departure]) -> None:
        self.count = np.array([departure.effect.shape[1] for departure in departures])
        self.first = np.cumsum(self.count) - self.count
        self.second = np.where(self.count > 1, self.first + 1, -1)
        self.columns = np.empty((rows.white.size, int(self.count.sum())))
        for start in range(0, len(departures), _AT_ONCE):
            some = departures[start : start + _AT_ONCE]
            white = rows.whiten(np.column_stack([departure.effect for departure in some]))
            self.columns[:, self.first[start] : self.first[start] + white.shape[1]] = white
        self.whole = np.sqrt(np.einsum("nc,nc->c", self.columns, self.columns))
        self.error, self.scatter, self.dof = rows.white, rows.scatter, rows.white.size
        self.noise_dof = rows.noise_dof
        self._project(rows.design, _SEEN)

    def _project(self, design: Floats, least: float) -> None:
        """Take columns (n, p) out of everything; what then is shorter than ``least`` of itself is not to be seen."""
        q = _orthonormal(design)
        self.dof -= q.shape[1]
        self.error = self.error - q @ (q.T @ self.error)
        for start in range(0, self.columns.shape[1], _AT_ONCE):
            some = self.columns[:, start : start + _AT_ONCE]
            some -= q @ (q.T @ some)
        self.scatter = self.scatter - q @ (q.T @ self.scatter)
        self.square = np.einsum("nc,nc->c", self.columns, self.columns)
        hidden = self.square <= (least * self.whole) ** 2
        self.columns[:, hidden], self.square[hidden] = 0.0, 0.0
        self.visible = (self.square[self.first] > 0.0) & ((self.second < 0) | (self.square[self.second] > 0.0))
        axes, sigma, _ = np.linalg.svd(self.scatter, full_matrices=False)
        kept = sigma > _SEEN * sigma.max(initial=0.0)
        self.axes, self.variance = axes[:, kept], sigma[kept] ** 2
        self.of_scatter = self.axes.T @ self.columns  # (s, c)

    def of(self, at: int) -> list[int]:
        """Return the columns of a departure."""
        return list(range(self.first[at], self.first[at] + self.count[at]))

    def take_out(self, at: int) -> None:
        """Leave a departure free."""
        self._project(self.columns[:, self.of(at)], _SAME)

    def fitted(self) -> tuple[Floats, Floats]:
        """Return what each departure takes off twice the log-likelihood, (d,), and its sizes, (d, 2).

        The size of the scatter is that which fits best, without the departure and with it.
        """
        on_axes, along = self.axes.T @ self.error, self.columns.T @ self.error
        pair = self.second >= 0
        cross = np.zeros(self.count.size)
        cross[pair] = np.einsum("nd,nd->d", self.columns[:, self.first[pair]], self.columns[:, self.second[pair]])
        alone, best, sizes = -np.inf, np.full(self.count.size, -np.inf), np.zeros((self.count.size, 2))
        for part in _PARTS:
            known = 1.0 + part * self.variance
            less = 1.0 - 1.0 / known
            base = -float(np.log(known).sum() - less @ on_axes**2)
            square = self.square - less @ self.of_scatter**2
            dot = along - (less * on_axes) @ self.of_scatter
            mixed = cross - less @ (self.of_scatter[:, self.first] * self.of_scatter[:, self.second])
            gain, size = _two_by_two(square, dot, np.where(pair, mixed, 0.0), self.first, self.second)
            alone, better = max(alone, base), base + gain > best
            best, sizes = np.where(better, base + gain, best), np.where(better[:, None], size, sizes)
        return np.where(self.visible, best - alone, 0.0), sizes

    def bounds(self, chance: float) -> Floats:
        """Return what chance takes off twice the log-likelihood with a probability, at most, (d,).

        For known noise that is a chi-square; what the scatter could hold as well is judged by scatter that its other
        directions tell, as Student's t is.
        """
        from scipy import special

        known = special.chdtri(self.count, chance)
        if math.isfinite(self.noise_dof):
            known = special.fdtri(self.count, self.noise_dof, 1.0 - chance) * self.count
        free = np.maximum(len(self.variance) - self.count, 1)
        ratio = special.fdtri(self.count, free, 1.0 - chance) * self.count / free
        held = (np.sum(self.of_scatter**2, axis=0) > _SEEN * self.square)[self.first]
        return np.asarray(np.where(held, np.maximum(known, len(self.variance) * np.log1p(ratio)), known))

    def distinct(self) -> int:
        """Return how many directions differ, a sign aside."""
        found: set[bytes] = set()
        for at in np.flatnonzero(self.square > 0.0):
            column = self.columns[:, at]
            levels = np.round(column / (column[np.argmax(np.abs(column))] * 10.0 * _SAME)).astype(np.int16)
            found.add(levels.tobytes())
        return len(found)

    def chi2(self) -> tuple[float, int]:
        """Return the chi-square of what is left over, by the scatter that fits best, and its degrees of freedom."""
        on_axes = (self.axes.T @ self.error) ** 2
        known = [1.0 + part * self.variance for part in _PARTS]
        best = min(known, key=lambda one: float(np.sum(np.log(one) + on_axes / one)))
        return float(self.error @ self.error - (1.0 - 1.0 / best) @ on_axes), self.dof


def _two_by_two(square: Floats, dot: Floats, mixed: Floats, first: Integers, second: Integers) -> tuple[Floats, Floats]:
    """Return chi-square (d,) and sizes (d, 2) of departures of one column or two, by their normal equations."""
    aa, ae, pair = square[first], dot[first], second >= 0
    bb, be = np.where(pair, square[second], 1.0), np.where(pair, dot[second], 0.0)
    determinant = aa * bb - mixed**2
    safe = np.where(determinant > 0.0, determinant, np.inf)
    size = np.stack([(bb * ae - mixed * be) / safe, (aa * be - mixed * ae) / safe], axis=1)
    return size[:, 0] * ae + size[:, 1] * be, size


def _orthonormal(design: Floats) -> Floats:
    length = np.linalg.norm(design, axis=0)
    left, singular, _ = np.linalg.svd(design / np.where(length > 0.0, length, 1.0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-10 * singular.max(initial=0.0)])


# --- what is said of them ---------------------------------------------------------------------------------------------

Words = Callable[[str, Any], str]  # a label, carrier or scale and its value, as a person says it


def evidence_of(found: Search, stated: Sequence[Estimate], words: Words) -> list[Evidence]:
    """Return what a search says against the estimates that follow from its rows, one entry for each thing."""
    evidence: list[Evidence] = []
    doubted = found.doubted
    for finding in found.findings:
        moved = (finding.moves > LEAST_MOVE) & doubted
        if moved.any():
            name = described(finding.departure, words)
            alike = [other for other in dict.fromkeys(described(one, words) for one in finding.equals) if other != name]
            said = say(
                "departs",
                what=name[:1].upper() + name[1:],
                size=f"{finding.size:+.3g} {finding.departure.unit}",
                move=float(finding.move.max()),
                others=say("departs.others", others="; ".join(alike[:_NAMED])) if alike else "",
                advice=say(f"departs.advice.{_kind(finding.departure)}"),
            )
            entries = [entry for entry, hit in zip(stated, moved, strict=True) if hit]
            evidence.append(Evidence(DEPARTS, said, finding.size, CERTAIN, float(finding.moves.max()), entries=entries))
    left = [entry for entry, grown in zip(stated, found.unexplained, strict=True) if grown > LEAST_MOVE]
    if left or not found.is_noise:
        said, ratio = say("unexplained", chi2=found.chi2, dof=found.dof), found.chi2 / max(found.dof, 1)
        move = float(found.unexplained.max(initial=0.0))
        evidence.append(Evidence("unexplained", said, ratio, CERTAIN, move, entries=left or stated))
    return evidence


def described(departure: Departure, words: Words) -> str:
    """Return a departure in words: what it is of, where, and its shape."""
    carrier, _, family = departure.family.rpartition(": ")
    kind, about = _kind(departure), dict(departure.about)
    shape = {name: about.pop(name) for name in ("after", "hours", "record", "pair") if name in about}
    level = about.pop(family) if kind == "at" else None
    scale, _, power = family.partition(" ^") if kind == "power" else (family.removesuffix(" absolute"), "", "")
    how = say(f"departs.{kind}", **shape, at=words(family, level) if kind in ("at", "own") else "",
              scale=words(scale, None) if kind in ("power", "size") else "", power=power)  # fmt: skip
    where = ", ".join(words(name, value) for name, value in about.items())
    of = words(carrier, None) if carrier else ""
    return ", ".join(part for part in (of, where, how) if part)


def _kind(departure: Departure) -> str:
    """Return the kind of a departure: a general one, a level, a power, a size of what its family names, or its own."""
    name = departure.family.rpartition(": ")[2]
    if name in _FAMILIES:
        return name.replace(" ", "_").replace("-", "_")
    if "^" in name or name.endswith(" absolute"):
        return "power" if "^" in name else "size"
    return "at" if name in departure.about else "own"


# --- departures that labels make --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Labels:
    """Labels of the readings of a fit, (r,) each: ``kinds`` have values, ``scales`` are numbers with powers to try.

    ``hours``: time; ``visit``: which readings follow each other.   ``carriers``: by name unit and what the readings
    (r,) gain if something is off by 1 everywhere.   ``scopes``: kinds whose values may confine a departure of any
    shape; ``corners``: those that may confine what one value of a further kind does.   ``exchanged``: items of one kind
    that could be taken for each other, their kind, their sides and the carrier.   ``own``: carriers and families
    of departures that may be an item's own.
    """

    kinds: Mapping[str, Any]
    hours: Floats
    visit: Integers
    carriers: Mapping[str, tuple[str, Floats]]
    scales: Mapping[str, tuple[Floats, Sequence[int]]] = field(default_factory=dict)
    scopes: Sequence[tuple[str, ...]] = ((),)
    corners: Sequence[tuple[str, ...]] = ()
    exchanged: tuple[str, str, str, str] | None = None
    own: Collection[tuple[str, str]] = ()

    @property
    def begins_h(self) -> dict[int, float]:
        """When each visit begins, hours after the first."""
        since_h = self.hours - self.hours.min()
        return {visit: float(since_h[self.visit == visit].min()) for visit in np.unique(self.visit).tolist()}


_FAMILIES = ("step", "step in a visit", "visit", "drift", "warm-up", "cycle", "exchanged")
_NAMED = 2  # of the other explanations
_DAY_h, _LONGEST = 24.0, 8.0  # of the time that the readings take: a longer cycle is a drift
_SETTLES = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the time that the readings take
_CYCLES = (2.0, 1.5, 1.2, 1.0, 0.8, 0.65, 0.5, 0.4, 0.32, 0.25, 0.2, 0.16)


def departures_of(labels: Labels) -> list[Departure]:
    """Return the general departures: each value of a label, steps, drifts, cycles, powers and memory, in all scopes."""
    found = [
        Departure(f"{carrier}: step in a visit", unit, (one * behind)[:, None], about)
        for about, behind in _within(labels)
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
                for family, about, shape in shapes:
                    effect = everywhere[:, None] * shape.reshape(one.size, -1)
                    key = effect.tobytes()
                    if family not in where and key not in seen and np.abs(effect).max() > _LEAST * np.abs(one).max():
                        seen.add(key)
                        own = (carrier, family) in labels.own
                        whole = everywhere if family in in_visits else None
                        found.append(Departure(f"{carrier}: {family}", unit, effect, {**where, **about}, own, whole))
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
            yield Departure("exchanged", unit, columns, {"pair": f"{a}, {b}", "hours": at})


def _within(labels: Labels) -> Iterable[tuple[dict[str, Any], Flags]]:
    """Yield what lies behind each reading of a visit but its first."""
    number = np.arange(labels.visit.size)
    for visit, begins_h in labels.begins_h.items():
        later = labels.hours - labels.hours.min() > begins_h
        for record, at in enumerate(number[(labels.visit == visit) & later].tolist(), start=2):
            yield {"visit": visit, "record": record}, (labels.visit == visit) & (number >= at)


def _values(labels: Labels) -> Iterable[tuple[str, dict[str, Any], Floats]]:
    for name, column in labels.kinds.items():
        for value in dict.fromkeys(np.asarray(column).tolist()):
            yield name, {name: value}, 1.0 * (np.asarray(column) == value)


def _shapes(labels: Labels) -> Iterable[tuple[str, dict[str, Any], Floats]]:
    """Yield shapes of time and of scales."""
    since_h, begins_h = labels.hours - labels.hours.min(), labels.begins_h
    for before, at in pairwise(sorted(begins_h.values())):
        yield "step", {"after": before, "hours": at}, 1.0 * (since_h >= at)
    for visit in begins_h:
        yield "visit", {"visit": visit}, 1.0 * (labels.visit == visit)
    span_h = max(float(np.ptp(since_h)), 1e-9)
    yield "drift", {}, since_h / span_h
    for part in _SETTLES:
        yield "warm-up", {"hours": part * span_h}, np.exp(-since_h / (part * span_h))
    for period_h in (*([_DAY_h] if _DAY_h < _LONGEST * span_h else []), *(part * span_h for part in _CYCLES)):
        angle = 2.0 * np.pi * since_h / period_h
        yield "cycle", {"hours": period_h}, np.column_stack([np.sin(angle), np.cos(angle)])
    for name, (scale, powers) in labels.scales.items():
        for power in powers:
            yield f"{name} ^{power}", {}, scale**power
        yield f"{name} absolute", {}, np.abs(scale)
