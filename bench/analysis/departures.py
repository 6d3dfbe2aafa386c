"""Departures: what could be true instead of the model, each a column on the rows of a fit; one engine for all systems.

A fit hands over what it leaves (``Residuals``) and the departures that its labels make; the engine says which the data
show, and how far each would move every estimate.

A score is d' P e / |P d|, P the projection on what the fit leaves over; its threshold is shared by all columns that
the data can show (union bound), and what the best leaves over is searched again.
Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from bench.analysis.doubt import FALSE_DOUBT, LEAST_MOVE
from bench.analysis.estimates import Estimate, Estimates
from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.tests import f_tail

_SEEN = 1e-6  # of a column: what the projection leaves of one that no data can show is rounding
_ALIKE = 9.0  # of twice a log-likelihood: less says nothing on which of two is true
_NEARLY = 0.02  # of it: shapes are never exactly those of the world
_EQUAL = 1.0 - 1e-9  # of the best: what is less far from it is decided by order, not by rounding
_AT_ONCE = 200  # columns: what is computed of them beside takes no more memory than a few of these
_FEW = 3  # departures: what they do not explain is told of all at once
_MOST = 20  # of them with shapes that are an item's own
_PARTS = (0.0, *np.logspace(-6.0, 0.0, 13).tolist())  # of the largest variance of the scatter
_NOT_MISSED = 1e3  # noncentrality: seen by any search
_SAME = 1e-4  # columns that differ by less are one
_BY_CHANCE = 0.05  # of a place where what was found elsewhere is looked for
_NONE = np.empty(0)


OF_SHAPES = ("after", "hours", "record", "pair", "seconds")  # what a shape has about it
OF_TIME = ("step", "step_in_a_visit", "visit", "drift", "warm_up", "cycle")


@dataclass(frozen=True)
class Departure:
    """Something that could be true instead of the model, in a size of 1 ``unit``.

    ``carrier``: what is off, "" for the reading itself.   ``shape``: how, a general one or one of a system's own; "at",
    "power" and "size" are ``of`` a label or scale, in its ``power``.   ``effect``: on the readings, (r, g), in
    their unit; several columns are one departure of which only the direction is unknown, such as a phase.
    ``about``: label values that it is confined to, and what its shape has.
    ``whole`` (r,): the same in all visits, of what is in some of them: the data do not say which visits are right.
    ``beside`` (q,): of one column on the last rows of the fit, which are no readings, in units of their noise.
    ``own``: up to which size the item may be so, as a further order of its curve, which its coefficients carry.
    """

    carrier: str
    shape: str
    unit: str
    effect: Floats
    about: Mapping[str, Any] = field(default_factory=dict)
    of: str = ""
    power: int = 0
    own: float = 0.0
    whole: Floats | None = None
    beside: Floats | None = None

    @property
    def place(self) -> dict[str, Any]:
        """Where it is: the labels that it is confined to, but for what makes its shape."""
        return {name: value for name, value in self.about.items() if name not in (*OF_SHAPES, self.of)}

    @property
    def is_of_time(self) -> bool:
        """Whether it comes, goes or changes while the readings are taken."""
        return self.shape in OF_TIME

    @property
    def family(self) -> str:
        """Name of what is alike but for where and when it is."""
        power = f" ^{self.power}" if self.power else ""
        shape = {"at": self.of, "power": self.of + power, "size": f"{self.of} absolute"}.get(self.shape, self.shape)
        return f"{self.carrier}: {shape.replace('_', ' ')}" if self.carrier else shape


@dataclass(frozen=True)
class Residuals:
    """Residuals of a fit, its rows, and how its estimates follow from them.

    ``readings`` (r,). ``white`` (n,): residuals in units of their noise; ``design`` (n, p): derivatives of the model in
    the same units; errors of standards and other priors are rows of their own. ``whiten``: columns (r, c) of readings
    to (n, c). ``scatter`` (n, s): what repeats scatter by beyond their noise, each column at the largest that is right;
    by how much they do is not known. ``noise_dof``: degrees of freedom of the estimate of the noise, 0 where it is the
    root mean square of what the fit leaves. ``operator`` (k, r): what an estimate gains per unit of each reading.
    ``expanded``, ``noise`` (k,): its expanded uncertainty, and the part of it that the noise makes. ``on_curve`` (k,):
    coefficients of curves, which carry what these leave over. ``rest``: chi-square and degrees of freedom of what no
    departure enters, beside the rows. ``shift``: what an effect on the readings, (r,), moves the estimates by, (k,),
    where that is known beyond the operator.   ``stated``: the estimates, (k,).
    """

    readings: Floats
    white: Floats
    design: Floats
    whiten: Callable[[Floats], Floats]
    operator: Floats
    expanded: Floats
    noise: Floats
    scatter: Floats | None = None
    on_curve: Flags | bool = False
    noise_dof: float = math.inf
    rest: tuple[float, int] = (0.0, 0)
    shift: Callable[[Floats], Floats] | None = None
    stated: Sequence[Estimate] = ()

    @classmethod
    def of(
        cls, *, error: Floats, free: Floats, whiten: Callable[[Floats], Floats], stated: Sequence[Estimate],
        std: Floats = _NONE, beside: Floats = _NONE, scatter: Floats | None = None, expanded: Floats | None = None,
        noise: Floats | None = None, **about: Any,
    ) -> Self:  # fmt: skip
        """Whiten what a fit leaves over, and put what is known beforehand beneath the readings.

        Args:    error (r,): what the fit, or a model that it starts from, leaves of the readings.   free (r, p):
                 derivatives of the model, in units of the readings.   whiten: columns (r, c) to units of their noise.
                 std (q,): how far the last q parameters are known.   beside: rows of ``white`` that are no readings.
                 scatter: in units of the readings.   expanded: those of ``stated`` where none are given.   noise: all
                 of them where none is given.   about: further fields, as they are.
        Returns: Residuals; its rows are readings, priors, and those beside.
        Raises:  nothing.
        Source:  priors as pseudo-observations: Gelman et al., Bayesian Data Analysis (2013), 14.8.
        """

        def white(columns: Floats) -> Floats:
            return np.vstack([whiten(columns), np.zeros((std.size + beside.size, columns.shape[1]))])

        if expanded is None:
            expanded = np.array([entry.expanded_uncertainty for entry in stated], float)
        return cls(
            white=np.concatenate([whiten(error[:, None])[:, 0], np.zeros(std.size), beside]),
            design=np.vstack([with_priors(whiten(free), std), np.zeros((beside.size, free.shape[1]))]),
            whiten=white,
            scatter=None if scatter is None else white(scatter),
            stated=stated,
            expanded=expanded,
            noise=expanded if noise is None else noise,
            **about,
        )


def with_priors(design: Floats, std: Floats) -> Floats:
    """Put a row beneath a design (n, p) for each of its last q parameters, which are known as far as ``std`` (q,)."""
    return np.vstack([design, np.eye(design.shape[1])[design.shape[1] - std.size :] / std[:, None]])


def operators_of(
    entries: Estimates, operator: Callable[[Estimate], Floats | None], readings: int
) -> tuple[Floats, list[Estimate]]:
    """Return what estimates gain per unit of each reading, (k, r), and those of them that follow from the readings.

    Args: operator: gives the row of an estimate, (r,), None of one that does not follow.   readings: how many.
    """
    found = [(row, entry) for entry in entries if (row := operator(entry)) is not None]
    return np.reshape([row for row, _ in found], (-1, readings)), [entry for _, entry in found]


@dataclass(frozen=True)
class Finding:
    """A departure that the data show: its ``size`` in its unit and what it takes off twice the log-likelihood.

    ``equals``: departures that explain the rows as well, the best first. ``moves`` (k,): by how much of its
    expanded uncertainty each estimate is moved, at most, by one that explains them nearly as well.
    """

    departure: Departure
    size: float
    gain: float
    equals: Sequence[Departure]
    moves: Floats

    @property
    def is_own(self) -> bool:
        """Whether the item may be so."""
        return abs(self.size) <= self.departure.own


@dataclass(frozen=True)
class Unseen:
    """A departure whose ``size`` moves estimate ``first`` by its uncertainty; the data show it from ``seen`` on."""

    departure: Departure
    size: float
    seen: float
    first: int


@dataclass(frozen=True)
class Search:
    """Outcome of a search: departures, and a chi-square that none explains.

    ``unseen``: of each family what moves an estimate first, where it would not have been found then.
    ``unexplained`` (k,): by what part each uncertainty would grow if the noise were as large as what is left over;
    ``is_noise``: that may be chance.   ``together`` (k,): what rests on rows in which more than one thing departs.
    ``stated``: the estimates, (k,).
    """

    findings: Sequence[Finding]
    chi2: float
    dof: int
    is_noise: bool
    unexplained: Floats
    together: Flags
    unseen: Sequence[Unseen]
    stated: Sequence[Estimate]

    @property
    def doubted(self) -> Flags:
        """Which estimates (k,) are not sound; what is an item's own is none where nothing else departs."""
        departs = not all(finding.is_own for finding in self.findings)
        moved = [finding.moves > LEAST_MOVE for finding in self.findings if departs]
        return np.asarray(np.any([*moved, self.unexplained > LEAST_MOVE, self.together], axis=0))


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
    unseen = _unseen(rows, departures, np.sqrt(left.bounds(chance)), left)
    findings: list[Finding] = []
    departing = np.zeros(rows.readings.size, bool)
    together = np.zeros(rows.expanded.size, bool)
    while len(findings) < _MOST:
        gains, sizes = left.fitted()
        odds = gains / left.bounds(chance)
        if not odds.size or odds.max() < 1.0:
            break
        best = int(np.argmax(odds >= _EQUAL * odds.max()))
        if sum(not finding.is_own for finding in findings) == _FEW:
            together[:] = True
            break
        near = np.flatnonzero(left.visible & (gains[best] - gains < max(_ALIKE, _NEARLY * gains[best])))
        alike = near[np.argsort(-np.round(gains[near] / gains[best], 9), kind="stable")].tolist()
        judged = [at for at in alike if not (_touched(departures[at]) & ~departing).any()] or alike
        findings.append(_finding(rows, departures, best, judged, gains, sizes))
        if (_touched(departures[judged[0]]) & departing).any():
            together |= np.abs(rows.operator) @ _touched(departures[judged[0]]) > 0.0
        departing |= _touched(departures[best]) & (not findings[-1].is_own)
        left.take_out(best)
    findings = [_with_siblings(rows, departures, finding, gains, sizes) for finding in findings]
    parts = [(chi2 / dof, chi2, dof) for chi2, dof in (left.chi2(), rows.rest) if dof]
    noise_dof, least = rows.noise_dof or math.inf, FALSE_DOUBT * share / 2.0 / max(len(parts), 1)
    odd = [part for part in parts if f_tail(part[0], part[2], noise_dof) <= least]
    ratio, chi2, dof = max(odd or parts, default=(1.0, 0.0, 0))
    excess = ratio - 1.0 if odd else 0.0
    grown = np.sqrt(1.0 + excess * (rows.noise / rows.expanded) ** 2) - 1.0
    return Search(findings, chi2, dof, not odd, np.where(rows.on_curve, 0.0, grown), together, unseen, rows.stated)


def _unseen(rows: Residuals, departures: Sequence[Departure], needed: Floats, left: _Left) -> list[Unseen]:
    """Return what is not found though it moves an estimate; ``needed`` (d,): length of a column that is."""
    first: dict[str, Unseen] = {}
    length = np.sqrt(left.square[left.first])
    for start in range(0, len(departures), _AT_ONCE):
        some = departures[start : start + _AT_ONCE]
        effects = np.column_stack([departure.effect[:, 0] for departure in some])
        moves = np.abs(rows.operator @ effects) / rows.expanded[:, None]
        moves[moves < _SEEN * (np.abs(rows.operator) @ np.abs(effects)) / rows.expanded[:, None]] = 0.0  # rounding
        for at, (departure, move) in enumerate(zip(some, moves.T, strict=True), start=start):
            if not departure.own and move.any() and length[at] < needed[at] * move.max():
                seen = float(needed[at] / length[at]) if length[at] else math.inf
                one = Unseen(departure, float(1.0 / move.max()), seen, int(move.argmax()))
                family = departure.family
                first[family] = min(first.get(family, one), one, key=lambda known: known.size)
    return sorted(first.values(), key=lambda one: one.departure.family)


def powers(rows: Residuals, departures: Sequence[Departure], share: float = 1.0) -> Floats:
    """Return how surely a search would show each departure that moves an estimate by its expanded uncertainty, (d, k).

    Args:    rows: of a plan, on nominal material.   departures, share: as ``search``; of several columns the first.
    Returns: probabilities; 1 where nothing is moved.
    Raises:  nothing.
    Source:  noncentral chi-square: Scheffé, The Analysis of Variance (1959), 2.8.
    """
    from scipy import special

    left = _Left(rows, departures)
    bounds = left.bounds(FALSE_DOUBT * share / 2.0 / max(left.distinct(), 1))
    effects = np.column_stack([departure.effect[:, 0] for departure in departures])
    moves = np.maximum(np.abs(rows.operator @ effects) / rows.expanded[:, None], _SEEN).T
    noncentrality = np.minimum(left.square[left.first][:, None] / moves**2, _NOT_MISSED)
    return np.asarray(1.0 - special.chndtr(bounds[:, None], left.count[:, None], noncentrality))


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
        moves=np.max([_moves(rows, effect) for effect in (*(effects[at] for at in judged), *other_sides)], axis=0),
    )


def _with_siblings(
    rows: Residuals, departures: Sequence[Departure], finding: Finding, gains: Floats, sizes: Floats
) -> Finding:
    """Return a finding with what the same moves at other places, where the rows show it as one in twenty by chance.

    What is there once is no surprise at another visit or channel: there it need not stand out of all that could be.
    """
    from scipy import special

    shape, moves = _shape_of(finding.departure), [finding.moves]
    for at, departure in enumerate(departures):
        effect = departure.effect
        if _shape_of(departure) == shape and gains[at] >= special.chdtri(effect.shape[1], _BY_CHANCE):
            moves.append(_moves(rows, effect @ sizes[at, : effect.shape[1]]))
    return replace(finding, moves=np.max(moves, axis=0))


def _shape_of(departure: Departure) -> tuple[Any, ...]:
    """Return what departures have in common that differ in their place alone."""
    place = departure.place
    own = {name: value for name, value in departure.about.items() if name not in place}
    return departure.carrier, departure.shape, departure.of, departure.power, sorted(place), sorted(own.items())


def _moves(rows: Residuals, effect: Floats) -> Floats:
    """Return by how much of its expanded uncertainty an effect on the readings, (r,), moves each estimate, (k,).

    To second order: what is in proportion to a reading changes it by the square of its part, too.
    """
    if rows.shift:
        return np.abs(rows.shift(effect)) / rows.expanded
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
        for first, departure in zip(self.first.tolist(), departures, strict=True):
            if departure.beside is not None:
                self.columns[rows.white.size - departure.beside.size :, first] = departure.beside
        self.whole = np.sqrt(np.einsum("nc,nc->c", self.columns, self.columns))
        nothing = np.empty((rows.white.size, 0))
        self.scatter = nothing if rows.scatter is None else rows.scatter
        self.error, self.dof = rows.white, rows.white.size
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

    def take_out(self, at: int) -> None:
        """Leave a departure free."""
        self._project(self.columns[:, self.first[at] : self.first[at] + self.count[at]], _SAME)

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
        gain = np.where(self.visible, best - alone, 0.0)
        if self.noise_dof:
            return gain, sizes
        left = np.maximum(self.error @ self.error - gain, _SEEN)
        return gain * np.maximum(self.dof - self.count, 0) / left, sizes

    def bounds(self, chance: float) -> Floats:
        """Return what chance takes off twice the log-likelihood with a probability, at most, (d,).

        For known noise that is a chi-square; what the scatter could hold as well is judged by scatter that its other
        directions tell, as Student's t is.
        """
        from scipy import special

        known = special.chdtri(self.count, chance)
        if math.isfinite(self.noise_dof):
            dof = self.noise_dof or np.maximum(self.dof - self.count, 1)
            known = special.fdtri(self.count, dof, 1.0 - chance) * self.count
            known = np.where(self.noise_dof or self.dof > self.count, known, math.inf)
        free = np.maximum(len(self.variance) - self.count, 1)
        ratio = special.fdtri(self.count, free, 1.0 - chance) * self.count / free
        held = (np.sum(self.of_scatter**2, axis=0) > _SEEN * self.square)[self.first]
        return np.asarray(np.where(held, np.maximum(known, len(self.variance) * np.log1p(ratio)), known))

    def distinct(self) -> int:
        """Return how many directions differ, a sign aside."""
        found: set[bytes] = set()
        for at in np.flatnonzero(self.square > 0.0):
            column = self.columns[:, at]
            size = np.abs(column)
            largest = column[np.argmax(size > (1.0 - _SAME) * size.max())]
            levels = np.round(column / (largest * 10.0 * _SAME)).astype(np.int16)
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
    # what is left of two that are one, such as a cycle of which one instant is seen, is rounding
    safe = np.where(determinant > _SEEN * aa * bb, determinant, np.inf)
    size = np.stack([(bb * ae - mixed * be) / safe, (aa * be - mixed * ae) / safe], axis=1)
    return size[:, 0] * ae + size[:, 1] * be, size


def _orthonormal(design: Floats) -> Floats:
    length = np.linalg.norm(design, axis=0)
    left, singular, _ = np.linalg.svd(design / np.where(length > 0.0, length, 1.0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-10 * singular.max(initial=0.0)])
