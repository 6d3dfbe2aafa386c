"""Readings of a unit with thermal lag and hysteresis as a function of their causes, averaged over each gate.

Model: y = sum b_k x^k + W s + extra columns + noise, x = T - T_ref, T the lagged temperature, s = (P - T) / (2 r) the
play in units of its full width: -1/2 on a rising branch, +1/2 on a falling one. So W = 2 h r is the hysteresis width,
falling minus rising, and linear; the lag and r are the only nonlinear parameters. The play operator is the elementary
rate-independent hysteresis, a piston with slack. Where the noise is a random walk, b0 is its mean over the readings.
Source: docs/method-af-converter.md; Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989),
section 2 (generalised play); Cressie, Statistics for Spatial Data (1993), section 3.4 (universal kriging).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.gates import Drive, lagged, lagged_means

WIDTH = "hysteresis width"


def play(temperature_degC: Floats, half_width_degC: float, start: float = 1.0) -> Floats:
    """Output P of a play of half-width r: P moves only where it would otherwise be more than r away from T.

    On a rising branch P = T - r, on a falling one P = T + r; after a reversal 2 r is crossed before P moves.

    Args:    temperature_degC: T, (k,), in order of time; between two values it must be monotone.
             half_width_degC: r >= 0.   start: (P - T) / r at the first value, -1 to 1; 1 = it came from above.
    Returns: P, (k,), degC.
    Source:  Krasnosel'skii and Pokrovskii (1989), section 2: P_k = max(T_k - r, min(T_k + r, P_{k-1})).
    """
    if temperature_degC.size < 2:
        return temperature_degC + start * half_width_degC
    low, high = temperature_degC - half_width_degC, temperature_degC + half_width_degC
    rising = np.diff(temperature_degC) > 0
    turns = np.flatnonzero(rising[1:] != rising[:-1]) + 1
    before = [float(temperature_degC[0]) + start * half_width_degC]  # P where a stretch without a turn begins
    for floor, ceiling, up in zip(low[turns].tolist(), high[turns].tolist(), rising[turns - 1].tolist(), strict=True):
        before.append(max(before[-1], floor) if up else min(before[-1], ceiling))
    held = np.repeat(before, np.diff(turns, prepend=0, append=temperature_degC.size))
    on_rise = np.append(rising, rising[-1])
    return np.asarray(np.where(on_rise, np.maximum(held, low), np.minimum(held, high)))


def cell_means(temperature_degC: Floats, output_degC: Floats) -> Floats:
    """Mean of P between neighbouring values, (k - 1,), exact where T is a straight line between them.

    P stands still for a part of the cell and follows T for the rest, so the mean is not half the sum of the ends.

    Args:    temperature_degC, output_degC: T and P = play(T), (k,).
    Source:  algebra: P0 + dP |dP / dT| / 2.
    """
    moved, run = np.diff(output_degC), np.abs(np.diff(temperature_degC))
    share = np.abs(moved) / np.where(run > 0, run, 1.0)
    return output_degC[:-1] + moved * share / 2.0


@dataclass(frozen=True)
class Gates:
    """When each of m readings was taken: from ``start_s`` to ``end_s`` on the clock of the drive."""

    start_s: Floats
    end_s: Floats

    @property
    def middle_s(self) -> Floats:
        """(m,), second."""
        return (self.start_s + self.end_s) / 2.0


@dataclass(frozen=True)
class ModelShape:
    """Terms that the fit is to contain.

    ``order``: degree of the polynomial.   ``extra_columns`` (m, q) with ``extra_names``: further linear terms, such
    as powers of time for a drift.   ``play_start``: (P - T) / r at the first time of the drive; 1: it came from above.
    """

    reference_degC: float = 20.0
    order: int = 3
    extra_columns: Floats = field(default_factory=lambda: np.empty((0, 0)))
    extra_names: Sequence[str] = ()
    play_start: float = 1.0


class HysteresisModel:
    """Columns of the linear parameters for any lag and play half-width; the grid of times is laid once."""

    def __init__(self, gates: Gates, drive: Drive, shape: ModelShape) -> None:
        m = gates.start_s.size
        self.extra = shape.extra_columns if shape.extra_columns.size else np.empty((m, 0))
        if self.extra.shape != (m, len(shape.extra_names)):
            raise FitError(
                "B-FIT-021",
                f"extra columns of the shape {self.extra.shape}, but {m} readings and {len(shape.extra_names)} names",
                next_step="give one row per reading and one name per column",
            )
        self.shape, self.start_degC = shape, drive.start_degC
        self.names = [*(f"b{k}" for k in range(shape.order + 1)), WIDTH, *shape.extra_names]
        self._t_s = np.unique(np.concatenate((drive.t_s, gates.start_s, gates.end_s)))
        self._drive_degC = np.interp(self._t_s, drive.t_s, drive.degC)
        self._first = np.searchsorted(self._t_s, gates.start_s)
        self._stop = np.searchsorted(self._t_s, gates.end_s)
        self._step_s = np.diff(self._t_s)
        self._gate_s = gates.end_s - gates.start_s
        self._known: dict[float, tuple[Floats, Floats]] = {}

    def unit_degC(self, lag_s: float) -> Floats:
        """Lagged temperature averaged over each gate, (m,)."""
        return self._unit(lag_s)[1]

    def span_degC(self, lag_s: float) -> tuple[float, float]:
        """Coldest and warmest lagged temperature from the first gate to the last: the ends of the loop."""
        inside = self._unit(lag_s)[0][self._first[0] : self._stop[-1] + 1]
        return float(inside.min()), float(inside.max())

    def shape_column(self, lag_s: float, half_width_degC: float, late_s: float = 0.0) -> Floats:
        """s = (P - T) / (2 r) averaged over each gate, (m,); ``late_s``: lag of s itself, of a loop that opens late."""
        on_grid = self._unit(lag_s)[0]
        moved = play(on_grid, half_width_degC, self.shape.play_start)
        if late_s:
            behind = lagged_means(self._t_s, moved - on_grid, lagged(self._t_s, moved - on_grid, late_s), late_s)
        else:
            behind = cell_means(on_grid, moved)
            behind -= (on_grid[:-1] + on_grid[1:]) / 2.0  # straight between the times, as in the mean of P
        return self._gate_means(behind) / (2.0 * half_width_degC)

    def columns(self, lag_s: float, half_width_degC: float) -> Floats:
        """Design matrix (m, p) of the linear parameters ``names``."""
        x = self.unit_degC(lag_s) - self.shape.reference_degC
        powers = np.vander(x, self.shape.order + 1, increasing=True)
        return np.column_stack((powers, self.shape_column(lag_s, half_width_degC), self.extra))

    def _unit(self, lag_s: float) -> tuple[Floats, Floats]:
        """Lagged temperature on the grid and by gate; the last few lags are kept, a search asks for them again."""
        if lag_s not in self._known:
            if len(self._known) > 16:
                self._known.pop(next(iter(self._known)))
            on_grid = lagged(self._t_s, self._drive_degC, lag_s, self.start_degC)
            cells = lagged_means(self._t_s, self._drive_degC, on_grid, lag_s)
            self._known[lag_s] = on_grid, self._gate_means(cells)
        return self._known[lag_s]

    def _gate_means(self, cells: Floats) -> Floats:
        integral = np.concatenate(([0.0], np.cumsum(cells * self._step_s)))
        return (integral[self._stop] - integral[self._first]) / self._gate_s


@dataclass(frozen=True)
class Level:
    """The mean of the walk over the readings: its covariance with every reading, (m,), and its variance."""

    covariance: Floats
    variance: float

    def referred(self, covariance: Floats, design_product: Floats, square: float) -> Floats:
        """Covariance (n, n) of the parameters when the first one holds the mean of the walk, best predicted.

        Args:    covariance: (n, n) of the generalised least squares.   design_product: X' V^-1 c, (n,).
                 square: c' V^-1 c, with c = ``self.covariance``.
        Source:  Cressie (1993), equation 3.4.5: the variance of universal kriging.
        """
        turned = -design_product
        turned[0] += 1.0
        mixed = covariance @ turned
        referred = covariance.copy()
        referred[0, :] = referred[:, 0] = mixed
        referred[0, 0] = turned @ mixed + max(self.variance - square, 0.0)
        return referred


def mean_of_walk(start_s: Floats, end_s: Floats, walk_A_rth: float) -> Level:
    """Level of a random walk that starts with the first gate, averaged over gates that do not overlap.

    Args:    start_s, end_s: (m,), in order of time, second.   walk_A_rth: standard deviation after one hour.
    Returns: Level; the covariance of two gates is sigma^2 times the earlier middle, a sixth of a gate less for one
             with itself.
    Source:  integral of min(t, t') over two gates.
    """
    m = start_s.size
    middle_s = (start_s + end_s) / 2.0 - start_s[0]
    earlier = np.cumsum(middle_s) + middle_s * (m - 1 - np.arange(m)) - (end_s - start_s) / 6.0
    shared = walk_A_rth**2 / 3600.0 * earlier / m
    return Level(shared, float(np.mean(shared)))
