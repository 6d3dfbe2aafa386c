"""The joint fit of lag and hysteresis for a record whose noise and history are not known beforehand.

Source: docs/decisions/0006-bias-and-hysteresis.md; noise by restricted likelihood (estimators.correlated_noise).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.maths.least_squares import solve
from bench.systems.af_converter.estimators.correlated_noise import CorrelatedNoise, fit_noise
from bench.systems.af_converter.estimators.drift_ramp import DRIFT_NAMES, Blocks, drift_columns
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG, HysteresisFit, fit_hysteresis
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.hysteresis.search import Bounds
from bench.systems.af_converter.estimators.thermal_lag import Drive

Array = NDArray[np.float64]
_UNKNOWN_START = 0.0  # of the play, half-way between both branches
_PASSES = 2  # of noise and fit


@dataclass(frozen=True)
class RampHysteresis:
    """``fit`` with the noise it rests on.

    ``start_std``: standard uncertainty of the width because nobody knows from where the temperature came before the
    record, unit of the readings.
    """

    fit: HysteresisFit
    noise: CorrelatedNoise
    start_std: float

    @property
    def width(self) -> tuple[float, float]:
        """Hysteresis width, falling minus rising, and its standard uncertainty."""
        return self.fit.value(WIDTH), float(np.hypot(self.fit.std(WIDTH), self.start_std))


def search_bounds(blocks: Blocks, drive: Drive) -> Bounds:
    """Return where lag and play half-width are looked for: what a record of this length, step and span can show.

    Args:    blocks: of the readings.   drive: temperature.
    Returns: lag from a tenth of a block to a tenth of the record; half-width from 0.2 % to a third of the span.
    Source:  see the module.
    """
    block_s, length_s = float(blocks.end_s[0] - blocks.start_s[0]), float(blocks.end_s[-1] - blocks.start_s[0])
    span_degC = float(np.ptp(drive.degC))
    return Bounds((block_s / 10.0, length_s / 10.0), (span_degC / 500.0, span_degC / 3.0))


def fit_ramp_hysteresis(
    blocks: Blocks, readings: Array, drive: Drive, noise: CorrelatedNoise, reference_degC: float
) -> RampHysteresis:
    """Fit polynomial, width, lag, half-width and quadratic drift together.

    The noise comes from the drift model first, then from what this fit itself leaves over.

    Args:    readings: block means, (m,).   drive: sensor at the unit.   noise: to begin with.
             reference_degC: of the polynomial.
    Returns: RampHysteresis; the numbers of ``fit`` are those of estimators.hysteresis.fit.fit_hysteresis.
    Raises:  FitError B-FIT-001 if the record does not determine the linear parameters, naming those.
    Source:  docs/decisions/0006-bias-and-hysteresis.md.
    """
    gates, bounds = Gates(blocks.start_s, blocks.end_s), search_bounds(blocks, drive)
    shape = ModelShape(
        reference_degC=reference_degC,
        extra_columns=drift_columns(blocks),
        extra_names=DRIFT_NAMES,
        play_start=_UNKNOWN_START,
    )
    model = HysteresisModel(gates, drive, shape)
    for _ in range(_PASSES):
        used = noise
        fit = fit_hysteresis(readings, gates, drive, _whitener(used, blocks), shape=shape, bounds=bounds)
        noise = fit_noise(blocks.middle_s, readings, model.columns(fit.value(LAG), fit.value(HALF_WIDTH)))
    widths = [
        _width_from(HysteresisModel(gates, drive, replace(shape, play_start=start)), fit, readings, used, blocks)
        for start in (-1.0, 1.0)
    ]
    return RampHysteresis(fit, used, abs(widths[1] - widths[0]) / float(np.sqrt(12.0)))


def _whitener(noise: CorrelatedNoise, blocks: Blocks) -> Callable[[Array], Array]:
    return lambda columns: noise.whiten(blocks.middle_s, columns)


def _width_from(
    model: HysteresisModel, fit: HysteresisFit, readings: Array, noise: CorrelatedNoise, blocks: Blocks
) -> float:
    """Width for another start of the play, lag and half-width as found; rectangular between the two extremes."""
    columns = noise.whiten(blocks.middle_s, model.columns(fit.value(LAG), fit.value(HALF_WIDTH)))
    basis, triangle = np.linalg.qr(columns)
    white = noise.whiten(blocks.middle_s, readings)
    linear = solve(triangle, basis.T @ white, np.eye(triangle.shape[0]), model.names).parameters
    return float(linear[model.names.index(WIDTH)])
