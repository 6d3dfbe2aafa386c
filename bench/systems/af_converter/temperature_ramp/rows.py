"""Rows of an imported log that are not what they seem: single ones unlike their neighbours, repeated stamps, gaps, and
columns that stand still.

One bad row among thousands is named, left out and counted; a column that stands still makes every result doubtful.
Source: docs/decisions/0025-doubt.md; Hampel, J. Am. Stat. Assoc. 69 (1974) 383 (median of the neighbourhood).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Evidence, Floats
from bench.systems.af_converter.wording import say

Mask = NDArray[np.bool_]
_BESIDE = 3  # rows on either side that a row is held against
_SIGMAS, _SPAN = 20.0, 0.05  # a bad row is off by this many robust deviations, and by this part of the column's span
_MOST = 0.01  # of the rows; more are not single rows
_GAP = 5.0  # of the usual step
_STILL_ROWS, _STILL_SHARE = 30, 0.02  # rows on end without a change, and their part of the record
_LIVELY, _TURNING = 0.5, 0.2  # share of rows that change, and of changes that turn back, in a column with noise
_ALIKE = 0.9  # correlation of two columns that go together
_FOLLOWS = 0.2  # of its span: how far something else moves meanwhile


def bad_rows(t_s: Floats, columns: Mapping[str, Floats]) -> Mask:
    """Return True for rows (k,) to be left out: a stamp not later than all before, a value unlike its neighbours.

    If more than one row in a hundred is so, the values are the log's own nature and stay.
    """
    repeated = np.concatenate(([False], t_s[1:] <= np.maximum.accumulate(t_s)[:-1]))
    odd = np.any([_unlike(values) for values in columns.values()], axis=0)
    few = np.count_nonzero(odd) <= max(1.0, _MOST * t_s.size)
    return np.asarray(repeated | odd if few else repeated)


def _unlike(values: Floats) -> Mask:
    padded = np.pad(values, _BESIDE, constant_values=np.nan)
    beside = np.lib.stride_tricks.sliding_window_view(padded, 2 * _BESIDE + 1)
    off = np.abs(values - np.nanmedian(np.delete(beside, _BESIDE, axis=1), axis=1))
    sigma = 1.4826 * float(np.median(off))
    low, high = np.quantile(values, (0.05, 0.95))
    return np.asarray(off > max(_SIGMAS * sigma, _SPAN * float(high - low), 1e-9 * abs(float(np.median(values)))))


def row_notes(t_s: Floats, bad: Floats) -> list[str]:
    """Return sentences on the rows left out, by their times (b,), and on the gaps between those kept, (k,)."""
    notes = []
    if bad.size:
        named = ", ".join(f"{time_s / 3600.0:.3f} h" for time_s in bad[:5]) + (" ..." if bad.size > 5 else "")
        notes.append(say("log.left_out", count=bad.size, times=named))
    step_s = np.diff(t_s)
    gaps = np.flatnonzero(step_s > _GAP * float(np.median(step_s)))
    if gaps.size:
        longest = gaps[int(np.argmax(step_s[gaps]))]
        minutes = {"whole": float(step_s[gaps].sum()) / 60, "longest": float(step_s[longest]) / 60}
        notes.append(say("log.gaps", count=gaps.size, gap=_GAP, **minutes, begin=float(t_s[longest]) / 3600))
    return notes


def still_evidence(t_s: Floats, columns: Mapping[str, Floats], programme: Sequence[str]) -> Iterator[Evidence]:
    """Yield a doubt for each column that stands still though its own noise or another temperature says it cannot.

    Args: columns: (k,) by name.   programme: those that are allowed to stand still and are only held beside.
    """
    for name, values in columns.items():
        if name in programme:
            continue
        first, last = _longest_still(values)
        if last - first < max(_STILL_ROWS, _STILL_SHARE * values.size):
            continue
        others = [other for key, other in columns.items() if key != name]
        if _noisy(np.delete(values, slice(first, last))) or _moved(others, values, first, last):
            hours = float(t_s[last - 1] - t_s[first]) / 3600.0
            sentence = say("evidence.stands_still", name=name, hours=hours, begin=float(t_s[first]) / 3600.0)
            yield Evidence("stands_still", sentence, hours, 0.0)


def _longest_still(values: Floats) -> tuple[int, int]:
    """First row, and the one behind the last, of the longest stretch without a change."""
    edges = np.flatnonzero(np.diff(values) != 0.0) + 1
    bounds = np.concatenate(([0], edges, [values.size]))
    longest = int(np.argmax(np.diff(bounds)))
    return int(bounds[longest]), int(bounds[longest + 1])


def _noisy(values: Floats) -> bool:
    """Whether nearly every row differs from the one before, up and down: noise above the last digit."""
    steps = np.diff(values)
    changes = steps[steps != 0.0]
    if changes.size < _LIVELY * max(steps.size, 1) or changes.size < _STILL_ROWS:
        return False
    return float(np.mean(np.sign(changes[1:]) != np.sign(changes[:-1]))) > _TURNING


def _moved(others: Sequence[Floats], values: Floats, first: int, last: int) -> bool:
    """Whether a column that otherwise goes with this one leaves it standing by a fifth of its span."""
    rest = np.delete(values, slice(first, last))
    for other in others:
        beside = np.delete(other, slice(first, last))
        if rest.size > _STILL_ROWS and np.ptp(rest) > 0 and np.ptp(beside) > 0:
            alike = float(np.corrcoef(rest, beside)[0, 1])
            if alike > _ALIKE and np.ptp(other[first:last]) > _FOLLOWS * np.ptp(other):
                return True
    return False
