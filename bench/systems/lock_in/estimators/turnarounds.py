"""The crossings round each turnaround of a dithered ring laser, as one table that every compensator reads.

Between two zeros of the dither angle, where the pick-off switches, the dither turns round exactly once.

Which multiple of pi the phase of a ring laser passes at each edge of its beat signal.

The comparator of the sine switches where the phase is a multiple n of pi. The comparator of the cosine says then
whether n is even, and both together in which direction the phase goes; so counting needs no model of the gyroscope.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.maths.arrays import Flags, Floats, Integers
from bench.model.errors import FitError

CROSSINGS = 16  # used on each side of a turnaround
GRAZING_rad = 0.01  # a phase that goes past a level by less crosses it too slowly for a comparator
_REGULAR = 0.2  # of half a dither period; a lost edge of the pick-off makes twice as much


@dataclass(frozen=True)
class Turnarounds:
    """Crossings round the turnaround in each interval between pick-off edges, n intervals, M crossings a side.

    Attributes:
        clock_Hz: of the ticks.   omega_rad_s: of the dither, from the pick-off.
        rate_rad_s: mean rate of the phase beside the dither, from the first and last count; lock-in errors are in it.
        sign: of the curvature, (n,), -1 at a maximum of the phase.   regular: the interval is half a period, (n,).
        usable: there are M good crossings on each side, (n,).
        grazing: the innermost crossings were left out, (n,), for the phase hardly passed their level.
        reference_tick: origin of ``time_s``, (n,).
        time_s, phase_rad: of the crossings, (n, 2 M), in order of time: M before the turnaround, M behind it.
        counts: how many are not usable, by reason.
    """

    clock_Hz: float
    omega_rad_s: float
    rate_rad_s: float
    sign: Integers
    regular: Flags
    usable: Flags
    grazing: Flags
    reference_tick: Integers
    time_s: Floats
    phase_rad: Floats
    counts: Mapping[str, int]

    @property
    def crossings(self) -> int:
        """M."""
        return int(self.time_s.shape[1] // 2)

    def inner(self, crossings: int) -> tuple[Floats, Floats]:
        """Times and phases of the usable turnarounds, the ``crossings`` nearest on each side: (u, 2 crossings)."""
        kept = slice(self.crossings - crossings, self.crossings + crossings)
        return self.time_s[self.usable, kept], self.phase_rad[self.usable, kept]


@dataclass(frozen=True)
class Jumps:
    """Jumps of the phase at each turnaround by one compensator, (n,); NaN where it is not usable.

    Attributes:
        dpsi_rad: phase behind less phase before, both carried on to the zero-rate instant.
        psi0_rad: phase there, between the two.   curvature_rad_s2: size of its second derivative.
    """

    dpsi_rad: Floats
    psi0_rad: Floats
    curvature_rad_s2: Floats


def spread(usable: Flags, values: Floats) -> Floats:
    """Return values of the usable turnarounds, (u,), in their places among all, (n,), NaN elsewhere.

    Source: none; bookkeeping.
    """
    placed = np.full(usable.size, np.nan)
    placed[usable] = values
    return placed


def turnarounds(edges: EdgeLevels, pickoff_tick: Integers, pickoff_rising: ArrayLike, clock_Hz: float) -> Turnarounds:
    """Find the turnarounds and the crossings round them.

    Args:    edges: of the beat, one unbroken stretch.   pickoff_tick: edges of the pick-off of the dither angle in it,
             (n + 1,), in order.   pickoff_rising: (n + 1,), True where the rate is at its positive maximum.
             clock_Hz: of the ticks.
    Raises:  FitError B-FIT-096 if there are too few pick-off edges to tell the dither's period, B-FIT-097 if no
             turnaround has ``CROSSINGS`` on each side.
    Source:  Lim, EP 0103080 A2 (1982): fits before and behind the same zero-rate instant.
    """
    pickoff, upward = np.asarray(pickoff_tick, np.int64), np.asarray(pickoff_rising, bool)
    half = half_period_ticks(pickoff)
    sign = np.where(upward[:-1], -1, 1)
    begin, end = np.searchsorted(edges.tick, pickoff[:-1]), np.searchsorted(edges.tick, pickoff[1:])
    before, behind, grazing, enough = _crossings(edges, begin, end, sign)
    regular = (np.abs(np.diff(pickoff) / half - 1.0) < _REGULAR) & (upward[1:] != upward[:-1])
    torn = _any_within(edges.suspect, before - CROSSINGS + 1, before + 1)
    torn |= _any_within(edges.suspect, behind, behind + CROSSINGS)
    broken = np.zeros(edges.tick.size, bool)
    broken[edges.breaks] = True
    reasons = {"pickoff": ~regular, "few_crossings": ~enough, "break": _any_within(broken, begin, end), "suspect": torn}
    usable, counts = np.ones(sign.size, bool), {}
    for reason, refused in reasons.items():
        counts[reason] = int((usable & refused).sum())
        usable &= ~refused
    _require(usable, counts)
    place = np.arange(CROSSINGS)
    index = np.column_stack((before[:, None] - CROSSINGS + 1 + place, behind[:, None] + place))
    index = np.where(usable[:, None], index, 0)
    reference = (edges.tick[index[:, CROSSINGS - 1]] + edges.tick[index[:, CROSSINGS]]) // 2
    level0 = edges.level[index[:, CROSSINGS]].astype(np.int64) // 2 * 2
    return Turnarounds(
        clock_Hz=clock_Hz,
        omega_rad_s=float(np.pi * clock_Hz / half),
        rate_rad_s=_mean_rate(edges, pickoff, upward) * clock_Hz,
        sign=sign,
        regular=regular,
        usable=usable,
        grazing=grazing & usable,
        reference_tick=reference,
        time_s=(edges.tick[index] - reference[:, None]) / clock_Hz,
        phase_rad=np.asarray(np.pi * (edges.level[index] - level0[:, None])),
        counts=counts,
    )


def half_period_ticks(pickoff: Integers) -> float:
    """Ticks in half a dither period: all of them together, with those that a lost edge hides.

    Args:    pickoff: ticks of the pick-off's edges, (n,).
    Raises:  FitError B-FIT-096 if there are fewer than 3 or they do not go on.
    Source:  mean over the record, each interval counted as the nearest multiple of their median.
    """
    step = np.diff(pickoff)
    if step.size < 2 or float(np.median(step)) <= 0.0:
        raise FitError(
            "B-FIT-096",
            f"{pickoff.size} edges of the dither's pick-off do not tell its period; at least 3 are due, in order",
            next_step="look at the pick-off's channel of the time tagger: its threshold, and whether the dither runs",
        )
    return float(step.sum() / np.rint(step / np.median(step)).sum())


def _mean_rate(edges: EdgeLevels, pickoff: Integers, upward: Flags) -> float:
    """Radians of phase per tick, between the first and the last pick-off edge of one sense inside the edges."""
    inside = (pickoff >= edges.tick[0]) & (pickoff < edges.tick[-1])
    same = np.flatnonzero(inside & (upward == upward[np.argmax(inside)]))
    if same.size < 2:
        return 0.0
    level = edges.level[np.searchsorted(edges.tick, pickoff[same[[0, -1]]], side="right") - 1]
    return float(np.pi * (level[1] - level[0]) / (pickoff[same[-1]] - pickoff[same[0]]))


def _crossings(
    edges: EdgeLevels, begin: Integers, end: Integers, sign: Integers
) -> tuple[Integers, Integers, Flags, Flags]:
    """Last edge before and first behind each turnaround, whether an inner pair was left out, whether there are M."""
    before, behind, bounced = _innermost(edges, begin, end, sign)
    reach = CROSSINGS + 1  # one more for a pair that is left out
    enough = (before - reach + 1 >= begin) & (behind + reach - 1 < end)
    grazing = bounced | (enough & _grazing(edges, before, behind, enough))
    return before - grazing, behind + grazing, grazing, enough


def _innermost(edges: EdgeLevels, begin: Integers, end: Integers, sign: Integers) -> tuple[Integers, Integers, Flags]:
    """Last edge before and first edge behind each turnaround, and whether the direction changes more than once."""
    last = edges.tick.size - 1
    before, behind, bounced = np.empty_like(begin), np.empty_like(begin), np.zeros(begin.size, bool)
    for curvature in (-1, 1):
        here = sign == curvature
        towards = np.flatnonzero(edges.direction == -curvature)
        final = _picked(towards, np.searchsorted(towards, end[here]) - 1, -1)
        del towards  # as long as half of the edges
        away = np.flatnonzero(edges.direction == curvature)
        first = _picked(away, np.searchsorted(away, begin[here]), last)
        del away
        crossed = final > first
        before[here], behind[here] = np.where(crossed, first - 1, final), np.where(crossed, final + 1, first)
        bounced[here] = crossed
    return before, np.minimum(behind, last), bounced


def _picked(values: Integers, place: Integers, otherwise: int) -> Integers:
    """Return values at places, and another one where there is no such place."""
    there = (place >= 0) & (place < values.size)
    picked = np.full(place.size, otherwise, np.int64)
    picked[there] = values[place[there]]
    return picked


def _grazing(edges: EdgeLevels, before: Integers, behind: Integers, enough: Flags) -> Flags:
    """Whether the phase passes the innermost level by less than ``GRAZING_rad``: half curvature times time squared."""
    inner, outer = np.where(enough, before, CROSSINGS), np.where(enough, behind, 0)
    near = (edges.tick[outer] - edges.tick[inner]).astype(np.float64)
    far = (edges.tick[np.where(enough, outer + CROSSINGS, 0)] - edges.tick[inner - CROSSINGS]).astype(np.float64)
    past = CROSSINGS * np.pi * near**2 / np.maximum(far**2 - near**2, 1.0)
    return np.asarray((past < GRAZING_rad) & (edges.level[inner] == edges.level[outer]))


def _any_within(flags: Flags, first: Integers, behind: Integers) -> Flags:
    """Return whether a flag is set at first ... behind - 1, (n,)."""
    set_at = np.flatnonzero(flags)
    return np.searchsorted(set_at, behind) > np.searchsorted(set_at, first)


def _require(usable: Flags, counts: Mapping[str, int]) -> None:
    if not usable.any():
        reasons = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise FitError(
            "B-FIT-097",
            f"none of {usable.size} dither turnarounds has {CROSSINGS} good crossings on each side ({reasons})",
            next_step="look at the beat's edges and at the pick-off in the record: the dither's amplitude, lost "
            "events, and whether the channels are exchanged",
        )


@dataclass(frozen=True)
class EdgeLevels:
    """Edges of one unbroken stretch of a record.

    Attributes:
        tick: time stamps, (m,).   level: (m,), the phase at the edge is ``level`` times pi, counted from 0 or 1.
        direction: (m,), +1 where the phase rises.
        suspect: (m,), the level's parity is not that of the cosine: two edges of a phase that hardly passed the level
            changed places, so these two are not to be used; the count is right again behind them.
        breaks: edges before which one was lost at a turnaround, (k,): the count from there on may be off by one turn
            of 2 pi, which nothing in the record tells.
        repaired: single edges lost in a run of one direction; their level was left out, so the count is right.
    """

    tick: Integers
    level: NDArray[np.int32]
    direction: NDArray[np.int8]
    suspect: Flags
    breaks: Integers
    repaired: int


def edge_levels(tick: Integers, rising: ArrayLike, cosine: ArrayLike) -> EdgeLevels:
    """Count the levels that the phase passes.

    Args:    tick: time stamps of the edges of the sine, (m,), in order.   rising: (m,), its level behind the edge.
             cosine: (m,), level of the cosine at the edge.
    Raises:  FitError B-FIT-095 if there are fewer than two edges or the ticks go back.
    Source:  quadrature counting; d sin(psi) / dt = cos(psi) dpsi / dt at psi = n pi, cos(n pi) = (-1)^n.
    """
    tick, upward, even = np.asarray(tick, np.int64), np.asarray(rising, bool), np.asarray(cosine, bool)
    if tick.size < 2 or bool((tick[1:] < tick[:-1]).any()):
        raise FitError(
            "B-FIT-095",
            f"{tick.size} edges of the beat are no stretch of a record: at least two are due, with ticks that never go "
            "back",
            next_step="cut the record where events were lost, and give each stretch by itself",
        )
    direction = np.where(upward == even, np.int8(1), np.int8(-1))
    step = (direction[:-1] + direction[1:]) // np.int8(2)  # bytes: a record of 20 s has 6 million edges
    # Edges of a comparator rise and fall by turns: two alike in succession have lost one between them, or changed
    # places with their neighbours.
    alike = upward[1:] == upward[:-1]
    lost = alike & (step != 0)
    step[lost] *= 2
    level = np.empty(tick.size, np.int32)  # no record has a thousand million edges
    level[0] = 0 if even[0] else 1
    np.cumsum(step, out=level[1:])
    level[1:] += level[0]
    torn = np.flatnonzero(alike & ~lost)
    first, breaks = _pairs_and_breaks(torn)
    swapped = np.concatenate((first, first + 1))
    level[swapped] += np.tile(direction[first - 1], 2)  # they stand on the level behind the last one
    if breaks.size:
        shift = np.zeros_like(level)
        shift[breaks] = direction[breaks]  # one level, this side or that: with it the parity is right again
        level += shift.cumsum()
    suspect = np.zeros(tick.size, bool)
    suspect[swapped] = True
    return EdgeLevels(tick, level, direction, suspect, breaks, int(lost.sum()))


def _pairs_and_breaks(torn: Integers) -> tuple[Integers, Integers]:
    """Return first edges of pairs that changed places, and edges behind a loss at a turnaround.

    A pair that changed places, at edges i + 1 and i + 2, leaves two doubtful steps: i to i + 1 and i + 2 to i + 3.
    """
    pair = np.flatnonzero(np.diff(torn) == 2)
    if pair.size:
        pair = pair[np.concatenate(([True], np.diff(pair) > 1))]
    single = np.ones(torn.size, bool)
    single[pair] = False
    single[pair + 1] = False
    return np.asarray(torn[pair] + 1), np.asarray(torn[single] + 1)
