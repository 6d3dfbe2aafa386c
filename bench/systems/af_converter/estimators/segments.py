"""Ramps and holds of a temperature programme, found in its set-point or in a measured temperature.

Source: the corners of a piecewise linear programme are where the straight lines of its neighbouring pieces meet.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from bench.maths.arrays import Floats, Integers

Kind = Literal["up", "down", "hold"]
_NAMES: dict[int, Kind] = {1: "up", -1: "down", 0: "hold"}
_SLOW = 0.1  # of the fastest rate: what is slower is a hold
_POINTS = 9  # of a moving line, odd
_LEAST_WINDOWS = 3  # a shorter run is the turn of a neighbour, such as an overshoot
_LEAST_SPAN_degC = 0.5  # a record that moves less has no ramp


@dataclass(frozen=True)
class Segment:
    """A stretch of one direction; ``rate_degC_h`` is the slope of the straight line through it."""

    kind: Kind
    start_s: float
    end_s: float
    rate_degC_h: float
    start_degC: float
    end_degC: float

    @property
    def length_h(self) -> float:
        """Length, hours."""
        return (self.end_s - self.start_s) / 3600.0


def find_segments(t_s: Floats, temperature_degC: Floats, window_s: float = 900.0) -> list[Segment]:
    """Split a record into ramps and holds.

    A line through a moving window gives the rate at every place; slower than a tenth of the fastest is a hold, what is
    shorter than three windows joins its neighbour. Corners are then put where the lines of neighbouring stretches meet.

    Args:    t_s, temperature_degC: (k,), in order of time, finite.   window_s: length of the moving line; nothing
             shorter than three of it is found.
    Returns: segments in order, from the first time to the last; one hold if the temperature moves less than 0.5 degC.
    Source:  see the module.
    """
    step_s = window_s / (_POINTS - 1)
    grid_s, means = _bin_means(t_s, temperature_degC, step_s)
    if grid_s.size < _LEAST_WINDOWS * _POINTS or np.ptp(means) < _LEAST_SPAN_degC:
        return [_line("hold", t_s, temperature_degC)]
    rate = _moving_rate(means, step_s)
    directions = np.where(np.abs(rate) < _SLOW * np.quantile(np.abs(rate), 0.98), 0, np.sign(rate)).astype(np.int64)
    runs = _without_short(list(_runs(directions)), _LEAST_WINDOWS * (_POINTS - 1))
    inner = [_inner(t_s, temperature_degC, grid_s[a], grid_s[b - 1], window_s / 2, _NAMES[kind]) for kind, a, b in runs]
    return _joined(inner, float(t_s[0]), float(t_s[-1]))


def branches(t_s: Floats, segments: list[Segment]) -> Integers:
    """Direction at each time: 1 on a ramp up, -1 on a ramp down, 0 in a hold.

    Args:    t_s: (k,) inside the segments, in any order.
    Returns: (k,).
    Source:  see the module.
    """
    ends = np.array([segment.end_s for segment in segments[:-1]])
    signs = {name: sign for sign, name in _NAMES.items()}
    directions = np.array([signs[segment.kind] for segment in segments], dtype=np.int64)
    return directions[np.searchsorted(ends, t_s, side="right")]


def _bin_means(t_s: Floats, values: Floats, step_s: float) -> tuple[Floats, Floats]:
    """Means of the readings in cells of one length, empty cells bridged by a straight line."""
    cell = ((t_s - t_s[0]) // step_s).astype(np.int64)
    count = np.bincount(cell).astype(np.float64)
    sums = np.bincount(cell, values)
    known = count > 0
    middle_s = t_s[0] + (np.arange(count.size) + 0.5) * step_s
    return middle_s, np.interp(middle_s, middle_s[known], sums[known] / count[known])


def _moving_rate(means: Floats, step_s: float) -> Floats:
    """Slope of the line through each window, degC/s; at the ends that of the nearest whole window."""
    reach = _POINTS // 2
    offsets = np.arange(-reach, reach + 1)
    slopes = np.correlate(means, offsets / float(offsets @ offsets), mode="valid") / step_s
    return np.pad(slopes, reach, mode="edge")


def _runs(directions: Integers) -> Iterator[tuple[int, int, int]]:
    edges = [0, *(np.flatnonzero(np.diff(directions)) + 1), directions.size]
    for start, stop in pairwise(edges):
        yield int(directions[start]), int(start), int(stop)


def _without_short(runs: list[tuple[int, int, int]], least: int) -> list[tuple[int, int, int]]:
    """Runs of at least ``least`` cells: a shorter one joins the longer of its neighbours, equal neighbours join."""
    while len(runs) > 1:
        at = min(range(len(runs)), key=lambda index: runs[index][2] - runs[index][1])
        if runs[at][2] - runs[at][1] >= least:
            break
        sides = [side for side in (at - 1, at + 1) if 0 <= side < len(runs)]
        kept = max(sides, key=lambda index: runs[index][2] - runs[index][1])
        runs[at] = (runs[kept][0], *runs[at][1:])
        runs = _merged(runs)
    return runs


def _merged(runs: list[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    joined = [runs[0]]
    for kind, start, stop in runs[1:]:
        if kind == joined[-1][0]:
            joined[-1] = (kind, joined[-1][1], stop)
        else:
            joined.append((kind, start, stop))
    return joined


def _inner(t_s: Floats, values: Floats, first_s: float, last_s: float, edge_s: float, kind: Kind) -> Segment:
    """Line through the middle of a run: its ends lie in the turn."""
    cut = min(edge_s, (last_s - first_s) / 4)
    inside = (t_s >= first_s + cut) & (t_s <= last_s - cut)
    inside = inside if np.count_nonzero(inside) > 2 else (t_s >= first_s) & (t_s <= last_s)
    return _line(kind, t_s[inside], values[inside])


def _line(kind: Kind, t_s: Floats, values: Floats) -> Segment:
    middle_s, mean = float(np.mean(t_s)), float(np.mean(values))
    spread = t_s - middle_s
    square = float(spread @ spread)
    slope = float(spread @ values) / square if square > 0 else 0.0
    ends = [float(t_s[0]), float(t_s[-1])]
    start_degC, end_degC = (mean + slope * (at - middle_s) for at in ends)
    return Segment(kind, ends[0], ends[1], slope * 3600.0, start_degC, end_degC)


def _joined(inner: list[Segment], first_s: float, last_s: float) -> list[Segment]:
    """Return lines carried on to where they meet, at most half the gap between them beyond it."""
    corners = [first_s]
    for before, after in pairwise(inner):
        low, high = before.end_s, after.start_s
        slope = (before.rate_degC_h - after.rate_degC_h) / 3600.0
        gap = after.start_degC - before.end_degC - after.rate_degC_h / 3600.0 * (high - low)
        meet = low + gap / slope if slope else low
        corners.append(float(np.clip(meet, low - (high - low) / 2, high + (high - low) / 2)))
    corners.append(last_s)
    return [_carried(segment, a, b) for segment, a, b in zip(inner, corners[:-1], corners[1:], strict=True)]


def _carried(segment: Segment, start_s: float, end_s: float) -> Segment:
    slope = segment.rate_degC_h / 3600.0
    return replace(
        segment,
        start_s=start_s,
        end_s=end_s,
        start_degC=segment.start_degC + slope * (start_s - segment.start_s),
        end_degC=segment.end_degC + slope * (end_s - segment.end_s),
    )
