"""What is left out of a north finder's data before anything is fitted, and named: readings and samples that stand still
or are pinned at a level, single samples unlike all others, and the one set whose eight samples contradict each other.

Four samples of one lock-in a quarter of a turn apart, with signs in turn, add to zero whatever signal, offset, gain and
placement are: what is left is noise, or one bad reading.
Source: FOG paper (digital north finding), equations (13a-d) and (14a-d); F test of one against all others, the union
bound over the readings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from bench.analysis import Floats
from bench.systems.north.estimators.likelihood import LikelihoodNorth
from bench.systems.north.sets import SINE, NorthSet, Waveform, waveform_of
from bench.systems.north.wording import say

_SIGNS = np.array([1.0, -1.0, 1.0, -1.0])
_ODD = 1e-3  # chance that a right campaign loses a set
_LEAST_SHARE = 1e-3  # of the amplitude: rounding of the lock-ins is not looked at
_FEWEST = 6
_STILL_deg, _STILL = 10.0, 5  # of the turn, samples: a sine of few steps stands still at its crests
_CHANCE = 1e-6
_PINNED, _PINNED_SHARE, _MORE_THAN_NEXT = 10, 1e-3, 5.0
_FAR, _MOST_LEFT_OUT = 8.0, 1e-3  # standard deviations; of the samples of a set, but one


def screen(sets: Sequence[NorthSet]) -> None:
    """Name what stands still, is pinned or contradicts itself as a fault of its set."""
    for north_set in sets:
        north_set.faults += [
            say("fault.same_value", role=role)
            for role, read_V in ((SINE, north_set.u1_V), ("lock_in_2", north_set.u2_V))
            if (read_V[1:3] == read_V[:2]).all() or (read_V[2:] == read_V[1:3]).all()
        ]
        waveform = waveform_of(north_set)
        if waveform is not None:
            north_set.raw_faults += _still_or_pinned(waveform)
    _unlike(sets)


def _unlike(sets: Sequence[NorthSet]) -> None:
    """Name the set with one reading that all others speak against, unless it is the only one of its kind."""
    good = [north_set for north_set in sets if not north_set.faults]
    if len(good) < _FEWEST:
        return
    left_V = np.array([[each.u1_V @ _SIGNS, each.u2_V @ _SIGNS] for each in good])
    size_V = float(np.median([np.ptp(each.u1_V) + np.ptp(each.u2_V) for each in good])) / 2.0
    which, role = np.unravel_index(int(np.argmax(np.abs(left_V))), left_V.shape)
    worst_V, count = float(left_V[which, role]), left_V.size
    left_V[which, role] = 0.0
    rest_V2 = float(np.sum(left_V**2)) / (count - 1)
    if abs(worst_V) <= _LEAST_SHARE * size_V or not rest_V2 > 0.0:
        return
    chance = float(special.fdtrc(1.0, count - 1.0, worst_V**2 / rest_V2)) * count
    own = good[int(which)]
    if chance < _ODD and Counter((each.item, each.sense) for each in good)[own.item, own.sense] > 1:
        own.faults.append(
            say("fault.contradicts", number=int(role) + 1, value=worst_V, ratio=abs(worst_V) / rest_V2**0.5)
        )


def _still_or_pinned(waveform: Waveform) -> list[str]:
    faults = []
    for record in np.unique(waveform.record).tolist():
        u_V, theta_deg, per_turn = waveform.turns(record)
        least = max(_STILL, int(per_turn * _STILL_deg / 360.0))
        for what, column, few in (("output", u_V, least), ("encoder", theta_deg, _STILL)):
            if (still := _longest_still(column)) > few:
                faults.append(say(f"fault.{what}_still", count=still, index=record))
        for level_V, end in ((float(u_V.max()), u_V), (float(u_V.min()), -u_V)):
            if (pinned := _pinned(end)) > max(_PINNED, _PINNED_SHARE * len(u_V)):
                faults.append(say("fault.pinned", count=pinned, level=level_V, index=record))
    return faults


def _longest_still(column: Floats) -> int:
    """Return the longest run of equal samples if chance does not explain it by how often neighbours are equal."""
    equal = np.concatenate(([False], np.diff(column) == 0.0, [False]))
    edges = np.flatnonzero(np.diff(equal.astype(np.int8)))
    if not edges.size:
        return 0
    runs = edges[1::2] - edges[::2]
    longest = int(runs.max())
    elsewhere = (int(runs.sum()) - longest + 1) / max(len(column) - longest, 1)
    return longest + 1 if len(column) * min(elsewhere, 1.0) ** longest < _CHANCE else 0


def _pinned(column: Floats) -> int:
    """Return how many samples are at the largest value, 0 if there are about as many just below it."""
    values, counts = np.unique(column, return_counts=True)
    return int(counts[-1]) if len(values) > 1 and counts[-1] > _MORE_THAN_NEXT * counts[-2] else 0


def far_samples(waveform: Waveform, fit: LikelihoodNorth, orders: Sequence[int]) -> NDArray[np.bool_] | None:
    """Return which samples are unlike all others, (n,); None for none, or for more than one in a thousand."""
    theta = np.deg2rad(waveform.theta_deg)
    left_V = waveform.u_V - float(fit.offset_V)
    for order, phasor in ((1, complex(fit.phasor)), *zip(orders, fit.harmonics.tolist(), strict=True)):
        left_V = left_V - phasor.real * np.sin(order * theta) - phasor.imag * np.cos(order * theta)
    beside_V = np.abs(left_V - np.median(left_V))
    far = beside_V > _FAR * 1.4826 * np.median(beside_V)
    few = 0 < np.count_nonzero(far) <= max(1.0, _MOST_LEFT_OUT * far.size)
    return np.asarray(far) if few else None
