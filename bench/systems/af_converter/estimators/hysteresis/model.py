"""What a reading of a unit with thermal lag and hysteresis depends on, averaged over each gate.

Model: y = sum b_k x^k + W s + extra columns + noise, x = T - T_ref, T the lagged temperature, s = (P - T) / (2 r) the
play in units of its full width: -1/2 on a rising branch, +1/2 on a falling one. So W = 2 h r is the hysteresis width,
falling minus rising, and linear; the lag and r are the only nonlinear parameters.
Source: docs/decisions/0006-bias-and-hysteresis.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.maths.play import cell_means, play
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.thermal_lag import Drive, lagged, lagged_means

Array = NDArray[np.float64]
WIDTH = "hysteresis width"


@dataclass(frozen=True)
class Gates:
    """When each of m readings was taken: from ``start_s`` to ``end_s`` on the clock of the drive."""

    start_s: Array
    end_s: Array

    @property
    def middle_s(self) -> Array:
        """(m,), second."""
        return np.asarray((self.start_s + self.end_s) / 2.0)


@dataclass(frozen=True)
class ModelShape:
    """What the fit is to contain.

    ``order``: degree of the polynomial.   ``extra_columns`` (m, q) with ``extra_names``: further linear terms, such
    as powers of time for a drift.   ``play_start``: (P - T) / r at the first time of the drive; 1: it came from above.
    """

    reference_degC: float = 20.0
    order: int = 3
    extra_columns: Array = field(default_factory=lambda: np.empty((0, 0)))
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
        self._known: dict[float, tuple[Array, Array]] = {}

    def unit_degC(self, lag_s: float) -> Array:
        """Lagged temperature averaged over each gate, (m,)."""
        return self._unit(lag_s)[1]

    def span_degC(self, lag_s: float) -> tuple[float, float]:
        """Coldest and warmest lagged temperature from the first gate to the last: the ends of the loop."""
        inside = self._unit(lag_s)[0][self._first[0] : self._stop[-1] + 1]
        return float(inside.min()), float(inside.max())

    def shape_column(self, lag_s: float, half_width_degC: float) -> Array:
        """s = (P - T) / (2 r) averaged over each gate, (m,)."""
        on_grid = self._unit(lag_s)[0]
        behind = cell_means(on_grid, play(on_grid, half_width_degC, self.shape.play_start))
        behind -= (on_grid[:-1] + on_grid[1:]) / 2.0  # straight between the times, as in the mean of P
        return self._gate_means(behind) / (2.0 * half_width_degC)

    def columns(self, lag_s: float, half_width_degC: float) -> Array:
        """Design matrix (m, p) of the linear parameters ``names``."""
        x = self.unit_degC(lag_s) - self.shape.reference_degC
        powers = np.vander(x, self.shape.order + 1, increasing=True)
        return np.column_stack((powers, self.shape_column(lag_s, half_width_degC), self.extra))

    def _unit(self, lag_s: float) -> tuple[Array, Array]:
        """Lagged temperature on the grid and by gate; the last few lags are kept, a search asks for them again."""
        if lag_s not in self._known:
            if len(self._known) > 16:
                self._known.pop(next(iter(self._known)))
            on_grid = lagged(self._t_s, self._drive_degC, lag_s, self.start_degC)
            cells = lagged_means(self._t_s, self._drive_degC, on_grid, lag_s)
            self._known[lag_s] = on_grid, self._gate_means(cells)
        return self._known[lag_s]

    def _gate_means(self, cells: Array) -> Array:
        integral = np.concatenate(([0.0], np.cumsum(cells * self._step_s)))
        return np.asarray((integral[self._stop] - integral[self._first]) / self._gate_s)
