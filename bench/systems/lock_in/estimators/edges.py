"""Which multiple of pi the phase of a ring laser passes at each edge of its beat signal.

The comparator of the sine switches where the phase is a multiple n of pi. The comparator of the cosine says then
whether n is even, and both together in which direction the phase goes; so counting needs no model of the gyroscope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.maths.arrays import Flags, Integers
from bench.model.errors import FitError


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
