"""Fits of simulated ramps and their errors in units of the stated uncertainty, for tests and the sweep."""

from __future__ import annotations

from typing import Any

import numpy as np
from bias_simulation import K0_C, Ramp, WALK_A_rth, WHITE_A_rtHz

from bench.systems.af_converter.estimators.gates import Drive, series_covariance, usable_drive
from bench.systems.af_converter.estimators.hysteresis.fit import HysteresisFit, fit_hysteresis
from bench.systems.af_converter.estimators.hysteresis.model import Gates, ModelShape, mean_of_walk
from bench.systems.af_converter.estimators.hysteresis.search import Bounds

WIDTH_AT = 4


def fit_ramp(
    one: Ramp,
    *,
    drive: Drive | None = None,
    lag_s: tuple[float, float] = (120.0, 5400.0),
    shape: ModelShape | None = None,
    level: bool = True,
    walk_A_rth: float = WALK_A_rth,
    contiguous: bool = True,
) -> HysteresisFit:
    """Joint fit of gated readings; ``walk_A_rth`` and ``contiguous`` may make a plausible mistake in the noise."""
    noise: Any = series_covariance(
        "gated",
        (one.start_s + one.end_s) / 2.0,
        one.end_s - one.start_s,
        K0_C[one.unit.kind],
        WHITE_A_rtHz,
        walk_A_rth,
        contiguous,
    )
    return fit_hysteresis(
        one.bias_A,
        Gates(one.start_s, one.end_s),
        drive or usable_drive(one.trace_t_s, one.air_degC),
        noise.whiten,
        shape=shape,
        bounds=Bounds(lag_s=lag_s),
        level=mean_of_walk(one.start_s, one.end_s, walk_A_rth) if level else None,
    )


def truths(one: Ramp) -> np.ndarray:
    """True b0 to b3, width, lag and half-width, (7,)."""
    return np.array([*map(one.truth, range(4)), one.unit.width_A, one.unit.lag_s, one.unit.half_width_degC])


def scores(one: Ramp, fit: HysteresisFit) -> np.ndarray:
    """Errors over stated standard uncertainties, (7,)."""
    return (fit.parameters - truths(one)) / np.sqrt(np.diag(fit.covariance))
