"""A slow temperature ramp up and down with a drift: what is left between the branches when the drift is taken away, and
the joint fit of lag and hysteresis for such a record, whose noise and history are not known beforehand.

Source: ordinary least squares with a cubic in temperature, a quadratic in time and a term that is +1/2 on a ramp up and
-1/2 on a ramp down; intervals from the residuals' own correlation, noise by restricted likelihood
(estimators.correlated_noise); docs/method-af-converter.md (joint fit).

Noise that is white and, beside it, wanders and returns: its size from the residuals, and intervals that hold it.

Residuals of a slow record are alike for hours. A fit that takes them for independent states intervals many times too
narrow.
Source: Patterson and Thompson, Biometrika 58 (1971) 545 (restricted likelihood); Kenward and Roger, Biometrics 53
(1997) 983 (degrees of freedom of an estimate under an estimated covariance).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
from scipy import optimize
from scipy.linalg import lapack

from bench.maths.arrays import Floats, Integers
from bench.maths.least_squares import solve
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG, HysteresisFit, fit_hysteresis
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.hysteresis.search import Bounds

_STEP = 5e-2  # of the numeric derivatives, in logarithms
_SHARES = (1e-4, 0.01, 0.1, 0.3, 0.6, 0.9)  # of the white part in the variance, where the search begins
_TIMES = 9  # correlation times where the search begins, from a third of a step to the whole record
_FEWEST_DOF, _MOST_DOF = 1.0, 1e4


@dataclass(frozen=True)
class CorrelatedNoise:
    """Variance ``white`` of every reading, and ``slow * exp(-|dt| / time_s)`` between readings; unit squared.

    ``spread`` (3, 3): covariance of the logarithms of the three, from the curvature of the likelihood.
    """

    white: float
    slow: float
    time_s: float
    spread: Floats

    def variance_of(self, weights: Floats, t_s: Floats) -> tuple[float, float]:
        """Variance of ``weights @ readings``, and the degrees of freedom with which it is known.

        Args:    weights, t_s: (m,).
        Returns: variance in the unit of the readings squared; degrees of freedom, 1 to 10,000.
        Source:  Satterthwaite: 2 v^2 / Var(v), Var(v) from the spread of the noise parameters (Kenward and Roger).
        """
        place = np.log([self.white, self.slow, self.time_s])
        square, lags_s = np.outer(weights, weights), np.abs(t_s[:, None] - t_s)
        diagonal = float(np.trace(square))

        @cache  # two of the three logarithms leave it as it is
        def alike(time_s: float) -> float:
            return float(np.sum(square * np.exp(-lags_s / time_s)))

        def at(point: Floats) -> float:
            white, slow, time_s = np.exp(point)
            return float(white * diagonal + slow * alike(float(time_s)))

        value = at(place)
        slope = np.array([(at(place + step) - at(place - step)) / (2 * _STEP) for step in np.eye(3) * _STEP])
        spread = float(slope @ self.spread @ slope)
        dof = 2.0 * value**2 / spread if spread > 0 else _MOST_DOF
        return value, float(np.clip(dof, _FEWEST_DOF, _MOST_DOF))

    def whitening(self, t_s: Floats) -> Whitening:
        """Return V^-1/2 of readings at these times, (m,), in order."""
        return whitening(t_s, (self.white, self.slow, self.time_s))


@dataclass(frozen=True)
class Whitening:
    """V^-1/2 by a filter: of what is expected of a reading ``stays`` goes into the next, ``learnt`` of what it read.

    ``std`` (m,): of what each reading says beyond those before it.   ``log_volume``: log|V| / 2.
    """

    stays: Floats
    learnt: Floats
    std: Floats
    log_volume: float

    def of(self, columns: Floats) -> Floats:
        """V^-1/2 applied to (m,) or (m, p): what each reading says beyond those before it, in standard deviations.

        Source:  prediction error decomposition. What is expected of all readings is a triangular system of two bands.
        """
        table = columns.reshape(self.std.size, -1)
        bands = np.ones((2, self.std.size))
        bands[1] = np.append(-self.stays, 0.0)
        expected = np.zeros(table.shape, order="F")
        np.multiply(self.learnt[:, None], table[:-1], out=expected[1:])
        expected = lapack.dtbtrs(bands, expected, uplo="L", diag="U", overwrite_b=True)[0]
        return np.asarray((table - expected) / self.std[:, None]).reshape(columns.shape)


def whitening(t_s: Floats, noise: tuple[float, float, float]) -> Whitening:
    """Return what takes the correlation out of columns; takes m steps, not m^3.

    The slow part is a Markov process, so a Kalman filter of one state predicts each reading from all before it.

    Args:    t_s: (m,), in order.   noise: variance of the white part, of the slow part, correlation time in s.
    Source:  Kalman, J. Basic Eng. 82 (1960) 35; Schweppe, IEEE Trans. Inf. Theory 11 (1965) 61 (likelihood).
    """
    white, slow, time_s = (float(value) for value in noise)
    kept = np.exp(-np.diff(t_s) / time_s)
    variances = [slow]  # of the state, before each reading
    for square, fresh in zip((kept**2).tolist(), (slow * (1.0 - kept**2)).tolist(), strict=True):
        variances.append(square * variances[-1] * white / (variances[-1] + white) + fresh)
    predicted = np.array(variances)
    total = predicted + white
    log_volume = float(np.cumsum(np.log(total) / 2.0)[-1])
    return Whitening(kept * (white / total)[:-1], kept * (predicted / total)[:-1], np.sqrt(total), log_volume)


def fit_noise(t_s: Floats, readings: Floats, design: Floats) -> CorrelatedNoise:
    """Size and duration of the noise of readings about a linear model, by restricted likelihood.

    The restricted likelihood knows that the model has taken a part of the noise away; plain residuals would look
    smaller and shorter-lived than the noise is.

    Args:    t_s: (m,), in order.   readings: (m,).   design: (m, p), of full rank.
    Returns: CorrelatedNoise.
    Source:  Patterson and Thompson (1971); a grid, then scipy.optimize.minimize (Nelder-Mead).
    """
    columns = np.column_stack((readings, np.linalg.qr(design)[0]))
    step_s, length_s = float(np.median(np.diff(t_s))), float(t_s[-1] - t_s[0])
    low, high = np.array([_SHARES[0], np.log(step_s / 3)]), np.array([0.999, np.log(length_s)])

    def parts(place: Floats) -> tuple[float, float, float]:
        share, log_time = np.clip(place, low, high)
        return share, 1.0 - share, np.exp(log_time)

    starts = [np.array([share, time]) for share in _SHARES for time in np.linspace(low[1], high[1], _TIMES)]
    costs = [_profiled(t_s, columns, parts(start))[0] for start in starts]
    end = optimize.minimize(
        lambda place: _profiled(t_s, columns, parts(place))[0],
        starts[int(np.argmin(costs))],
        method="Nelder-Mead",
        options={"xatol": 1e-2, "fatol": 1e-3},
    )
    share, rest, time_s = parts(end.x)
    variance = _profiled(t_s, columns, (share, rest, time_s))[1]
    place = np.log([variance * share, variance * rest, time_s])
    spread = _spread(lambda at: _restricted(t_s, columns, at), place)
    return CorrelatedNoise(variance * share, variance * rest, float(time_s), spread)


def _profiled(t_s: Floats, columns: Floats, unit: tuple[float, float, float]) -> tuple[float, float]:
    """Minus the restricted log-likelihood for a covariance of unknown size, and the best size."""
    log_volume, square = _volume_and_square(t_s, columns, unit)
    dof = columns.shape[0] - columns.shape[1] + 1
    size = max(square / dof, float(np.finfo(np.float64).tiny))
    return log_volume + dof / 2.0 * float(np.log(size)), size


def _restricted(t_s: Floats, columns: Floats, place: Floats) -> float:
    """Minus the restricted log-likelihood, up to a constant."""
    white, slow, time_s = (float(value) for value in np.exp(place))
    log_volume, square = _volume_and_square(t_s, columns, (white, slow, time_s))
    return log_volume + square / 2.0


def _volume_and_square(t_s: Floats, columns: Floats, noise: tuple[float, float, float]) -> tuple[float, float]:
    """log|V|/2 + log|X'V^-1 X|/2, and the square of the whitened residual; columns: readings, then X."""
    filtered = whitening(t_s, noise)
    white = filtered.of(columns)
    turned, triangle = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - turned @ (turned.T @ white[:, 0])
    return filtered.log_volume + float(np.sum(np.log(np.abs(np.diag(triangle))))), float(left @ left)


def _spread(cost: Callable[[Floats], float], place: Floats) -> Floats:
    """Inverse curvature at the minimum; a direction that the residuals leave open is taken as known to a factor e."""
    steps = np.eye(place.size) * _STEP
    curvature = np.empty((place.size, place.size))
    for i, j in combinations_with_replacement(range(place.size), 2):
        step, other = steps[i], steps[j]
        corners = cost(place + step + other) - cost(place + step - other)
        corners -= cost(place - step + other) - cost(place - step - other)
        curvature[i, j] = curvature[j, i] = corners / (4.0 * _STEP**2)
    values, vectors = np.linalg.eigh(curvature)
    return np.asarray((vectors / np.maximum(values, 1.0)) @ vectors.T)


BRANCH, DRIFT_NAMES = "up minus down", ("drift rate", "drift curvature")
TEMPERATURE_NAMES = ("b0", "b1", "b2", "b3")
NAMES = (*TEMPERATURE_NAMES, BRANCH, *DRIFT_NAMES)
_UNKNOWN_START = 0.0  # of the play, half-way between both branches
_PASSES = 2  # of noise and fit


@dataclass(frozen=True)
class Blocks:
    """Rows of a record gathered in stretches of one length; empty stretches are left out.

    ``member`` (k,): number of the block of each row.   ``start_s``, ``end_s``, ``middle_s`` (m,): ends, mean time.
    """

    member: Integers
    count: Floats
    start_s: Floats
    end_s: Floats
    middle_s: Floats

    def mean(self, values: Floats) -> Floats:
        """Means (m,) of the values (k,) of the rows."""
        return np.bincount(self.member, values) / self.count

    def hours(self) -> Floats:
        """Return time from the middle of the record, (m,), hours."""
        return np.asarray((self.middle_s - (self.start_s[0] + self.end_s[-1]) / 2.0) / 3600.0)


@dataclass(frozen=True)
class DriftFit:
    """``parameters`` (7,) called ``names``: b0 to b3 (Y/degC^k about the reference), "up minus down" (Y), "drift rate"
    (Y/h, at the middle of the record), "drift curvature" (Y/h2).   ``operator`` (7, m) maps readings to them.
    """

    names: tuple[str, ...]
    parameters: Floats
    operator: Floats
    residual: Floats
    noise: CorrelatedNoise
    middle_s: Floats

    def estimate(self, name: str) -> tuple[float, float, float]:
        """Return value, standard uncertainty and degrees of freedom of a parameter."""
        index = self.names.index(name)
        variance, dof = self.noise.variance_of(self.operator[index], self.middle_s)
        return float(self.parameters[index]), float(np.sqrt(variance)), dof


@dataclass(frozen=True)
class BranchDifference:
    """Ramp up minus ramp down where a sensor reads the same temperature, with nothing else taken into account."""

    temperature_degC: float
    value: float
    std: float
    dof: float


def block_means(t_s: Floats, count: int) -> Blocks:
    """Divide a record into blocks of one length.

    Args:    t_s: (k,), in order.   count: blocks from the first time to the last.
    Returns: Blocks.
    Source:  see the module.
    """
    length_s = (float(t_s[-1] - t_s[0]) or 1.0) * (1.0 + 1e-9) / count
    number, member = np.unique(((t_s - t_s[0]) // length_s).astype(np.int64), return_inverse=True)
    size = np.bincount(member).astype(np.float64)
    start_s = t_s[0] + number * length_s
    return Blocks(member, size, start_s, start_s + length_s, np.bincount(member, t_s) / size)


def drift_columns(blocks: Blocks) -> Floats:
    """Return time and its square about the middle of the record, (m, 2), hours and hours squared.

    Args:    blocks: of the readings.
    Source:  see the module.
    """
    hours = blocks.hours()
    return np.column_stack((hours, hours**2))


def drift_design(blocks: Blocks, temperature_degC: Floats, branch: Floats, reference_degC: float) -> Floats:
    """Return the columns (m, 7) of a fit, in the order of ``NAMES``.

    Args:    as for ``fit_drift``.
    Source:  see the module.
    """
    powers = np.vander(temperature_degC - reference_degC, 4, increasing=True)
    return np.column_stack((powers, branch, drift_columns(blocks)))


def fit_drift(
    blocks: Blocks, temperature_degC: Floats, readings: Floats, branch: Floats, reference_degC: float,
    noise: CorrelatedNoise | None = None,
) -> DriftFit:  # fmt: skip
    """Fit cubic in temperature, quadratic in time and the up/down term.

    Args:    temperature_degC, readings: block means, (m,).   branch: +1/2 up, -1/2 down, 0 hold, (m,).
             reference_degC: of the polynomial.   noise: of the readings; None: from the residuals.
    Returns: DriftFit.
    Raises:  FitError B-FIT-001 if the record does not determine a term, naming it.
    Source:  see the module; JCGM 100:2008, 5.2: the estimates are ``operator @ readings``, whatever the noise is.
    """
    design = drift_design(blocks, temperature_degC, branch, reference_degC)
    basis, triangle = np.linalg.qr(design)
    fit = solve(triangle, basis.T @ readings, np.eye(triangle.shape[0]), NAMES)
    residual = readings - design @ fit.parameters
    noise_used = fit_noise(blocks.middle_s, readings, design) if noise is None else noise
    return DriftFit(NAMES, fit.parameters, fit.operator @ basis.T, residual, noise_used, blocks.middle_s)


def branch_differences(
    drift: DriftFit,
    temperature_degC: Floats,
    readings: Floats,
    ramps: tuple[Integers, Integers],
    at_degC: Sequence[float],
) -> list[BranchDifference]:
    """Up minus down at equal temperature, the way one would read it off a plot of the two branches.

    Args:    drift: gives the noise.   temperature_degC, readings: block means, (m,).   ramps: indices of the blocks of
             the ramp up and of the ramp down.   at_degC: temperatures; one without blocks on both is left out.
    Source:  straight lines through the blocks of each branch within half a degree, or one and a half blocks of a fast
             ramp, where they meet the temperature; means alone would differ by the slope where blocks lie otherwise.
    """
    differences = []
    for at in at_degC:
        near = [_near(temperature_degC, ramp, at) for ramp in ramps]
        if not all(blocks.size for blocks in near):
            continue
        weights = np.zeros_like(readings)
        for sign, blocks in zip((1.0, -1.0), near, strict=True):
            off = temperature_degC[blocks] - temperature_degC[blocks].mean()
            to = at - float(temperature_degC[blocks].mean())
            weights[blocks] = sign * (1.0 / blocks.size + to * off / float(off @ off))
        variance, dof = drift.noise.variance_of(weights, drift.middle_s)
        differences.append(BranchDifference(at, float(np.sum(weights * readings)), float(np.sqrt(variance)), dof))
    return differences


def _near(temperature_degC: Floats, ramp: Integers, at: float) -> Integers:
    """Return the blocks of a ramp around a temperature, none where it does not lie between two of them."""
    off = temperature_degC[ramp] - at
    within = np.abs(off) <= max(0.5, 1.5 * float(np.median(np.abs(np.diff(off)))) if off.size > 1 else 0.0)
    return ramp[within] if off[within].size and off[within].min() < 0.0 < off[within].max() else ramp[:0]


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
    return Bounds((block_s / 1000.0, length_s / 10.0), (span_degC / 500.0, span_degC / 3.0))


def ramp_shape(blocks: Blocks, reference_degC: float) -> ModelShape:
    """Return the terms of the joint fit of a record: quadratic drift, the start of the play half-way.

    Args:    blocks: of the readings.   reference_degC: of the polynomial.
    Source:  see the module.
    """
    return ModelShape(
        reference_degC=reference_degC,
        extra_columns=drift_columns(blocks),
        extra_names=DRIFT_NAMES,
        play_start=_UNKNOWN_START,
    )


def fit_ramp_hysteresis(
    blocks: Blocks, readings: Floats, drive: Drive, noise: CorrelatedNoise, reference_degC: float
) -> RampHysteresis:
    """Fit polynomial, width, lag, half-width and quadratic drift together.

    The noise comes from the drift model first, then from what this fit itself leaves over.

    Args:    readings: block means, (m,).   drive: sensor at the unit.   noise: to begin with.
             reference_degC: of the polynomial.
    Returns: RampHysteresis; the numbers of ``fit`` are those of estimators.hysteresis.fit.fit_hysteresis.
    Raises:  FitError B-FIT-001 if the record does not determine the linear parameters, naming those.
    Source:  docs/method-af-converter.md.
    """
    gates, bounds = Gates(blocks.start_s, blocks.end_s), search_bounds(blocks, drive)
    shape = ramp_shape(blocks, reference_degC)
    model = HysteresisModel(gates, drive, shape)
    for _ in range(_PASSES):
        used = noise
        fit = fit_hysteresis(readings, gates, drive, used.whitening(blocks.middle_s).of, shape=shape, bounds=bounds)
        noise = fit_noise(blocks.middle_s, readings, model.columns(fit.value(LAG), fit.value(HALF_WIDTH)))
    widths = [
        _width_from(HysteresisModel(gates, drive, replace(shape, play_start=start)), fit, readings, used, blocks)
        for start in (-1.0, 1.0)
    ]
    return RampHysteresis(fit, used, abs(widths[1] - widths[0]) / float(np.sqrt(12.0)))


def _width_from(
    model: HysteresisModel, fit: HysteresisFit, readings: Floats, noise: CorrelatedNoise, blocks: Blocks
) -> float:
    """Width for another start of the play, lag and half-width as found; rectangular between the two extremes."""
    whiten = noise.whitening(blocks.middle_s).of
    columns = whiten(model.columns(fit.value(LAG), fit.value(HALF_WIDTH)))
    basis, triangle = np.linalg.qr(columns)
    white = whiten(readings)
    linear = solve(triangle, basis.T @ white, np.eye(triangle.shape[0]), model.names).parameters
    return float(linear[model.names.index(WIDTH)])
