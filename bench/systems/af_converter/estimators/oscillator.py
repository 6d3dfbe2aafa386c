"""Error of the master oscillator over temperature, counted against a function generator.

Source: AF-converter paper section 4.1 (1 + dMSTR = f_FG t_INT0 / n_FG; generator within 3 ppm).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.budget import effective_dof
from bench.maths.least_squares import solve
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.gates import Whitener, series_covariance
from bench.systems.af_converter.estimators.readings import master_clock_error

GENERATOR_STD = 3e-6 / np.sqrt(3.0)  # rectangular within 3 ppm, relative
FIT, GENERATOR, SENSOR = "fit", "function generator", "temperature sensor"
_STEP_degC = 0.1  # temperatures nearer than this count as one
_PPM = 1e6


@dataclass(frozen=True)
class OscillatorWindows:
    """m windows in order of time, all (m,).

    ``times_s``: middle; ``gate_s``: nominal gate by the master count; ``fg_count``: pulses of the generator in it;
    ``unit_degC``: temperature of the unit, NaN = unknown; ``contiguous``: begins where the one before ended.
    """

    times_s: Floats
    gate_s: Floats
    fg_count: Floats
    unit_degC: Floats
    contiguous: Flags


@dataclass(frozen=True)
class OscillatorFit:
    """dMSTR(T) = c0 + c1 x + c2 x^2 ..., x = T - T_ref; positive = the master oscillator runs fast.

    ``coefficients_ppm`` (order + 1,) in ppm/degC^k and ``covariance_ppm2`` of the fit alone, widened to the scatter of
    the residuals where that is larger than whole pulses explain.   ``generator_std_ppm``: error of the generator,
    common to all windows, so in c0 alone.   ``sensor_std_degC``: error of the unit's sensor, common as well.
    ``residual_ppm`` (m,): window minus polynomial, NaN where dropped.   ``reduced_chi2``: of the whitened
    residuals, before widening.   ``span_degC``: coldest and warmest window.
    """

    reference_degC: float
    coefficients_ppm: Floats
    covariance_ppm2: Floats
    generator_std_ppm: float
    sensor_std_degC: float
    residual_ppm: Floats
    reduced_chi2: float
    span_degC: tuple[float, float]
    generator_dof: float = math.inf  # of the generator's certificate

    @property
    def rms_ppm(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.nanmean(self.residual_ppm**2)))

    @property
    def n_used(self) -> int:
        """Windows in the fit."""
        return int(np.isfinite(self.residual_ppm).sum())

    @property
    def n_dropped(self) -> int:
        """Windows without generator pulses, gate or temperature."""
        return self.residual_ppm.size - self.n_used

    def components_ppm(self, weights: Floats) -> dict[str, float]:
        """Independent parts of the standard uncertainty of ``weights @ coefficients_ppm``, by name."""
        moved = weights[:-1] @ (np.arange(1, weights.size) * self.coefficients_ppm[1:])  # by a sensor 1 degC off
        return {
            FIT: float(np.sqrt(weights @ self.covariance_ppm2 @ weights)),
            GENERATOR: float(weights[0]) * self.generator_std_ppm,
            SENSOR: abs(float(moved)) * self.sensor_std_degC,
        }

    def std_ppm(self, weights: Floats) -> float:
        """Return standard uncertainty of ``weights @ coefficients_ppm``, everything included."""
        return float(np.linalg.norm(list(self.components_ppm(weights).values())))

    def dof(self, weights: Floats) -> float:
        """Return degrees of freedom of that uncertainty."""
        generator_ppm = self.components_ppm(weights)[GENERATOR]
        return effective_dof(self.std_ppm(weights) ** 2, [(generator_ppm**2, self.generator_dof)])


def fit_oscillator(
    windows: OscillatorWindows,
    fg_Hz: float,
    *,
    order: int = 3,
    reference_degC: float = 20.0,
    generator_std: float = GENERATOR_STD,
    sensor_std_degC: float = 0.0,
) -> OscillatorFit:
    """Polynomial of the master oscillator's error over the temperature of the unit, by generalised least squares.

    The counts of contiguous windows telescope, so their errors are correlated by -1/2. What the residuals of a plain
    fit scatter beyond whole pulses is taken for white noise of the readings, but never less than the counts bring:
    while the temperature holds, two steady clocks repeat their fractions of a pulse, and a fit that trusts the
    telescoping alone states intervals that hold the truth in half of the cases. The covariance takes the scatter of
    each whitened residual as it is, because noise of the temperature counts for more where the slope is steep, and at
    least 1 on average; if the residuals hang together it is scaled by (1 + a) / (1 - a), with a their lag-1
    autocorrelation.

    Args:    windows: m windows; those without generator pulses, gate or temperature are dropped and counted.
             fg_Hz: frequency of the generator.   order: degree.   reference_degC: T_ref.   generator_std: relative
             standard uncertainty of the generator.   sensor_std_degC: standard uncertainty common to all temperatures.
    Returns: OscillatorFit.
    Raises:  FitError B-FIT-026 if fewer than order + 2 windows or order + 1 temperatures are left.
    Source:  AF-converter paper section 4.1; H. White, Econometrica 48 (1980) 817 (uneven scatter);
             M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536 (autocorrelated residuals).
    """
    used = np.isfinite(windows.unit_degC) & (windows.fg_count > 0) & (windows.gate_s > 0)
    kept = _kept(windows, used)
    _require(kept, order)
    x = kept.unit_degC - reference_degC
    error = master_clock_error(kept.fg_count, kept.gate_s, fg_Hz)
    whitener = _noise(kept, x, error, order)
    coefficients, covariance, chi2 = _weighted(whitener, x, error, order)
    residual_ppm = np.full(used.size, np.nan)
    residual_ppm[used] = _PPM * (error - np.vander(x, order + 1, increasing=True) @ coefficients)
    return OscillatorFit(
        reference_degC=reference_degC,
        coefficients_ppm=_PPM * coefficients,
        covariance_ppm2=_PPM**2 * covariance,
        generator_std_ppm=_PPM * generator_std,
        sensor_std_degC=sensor_std_degC,
        residual_ppm=residual_ppm,
        reduced_chi2=chi2,
        span_degC=(float(kept.unit_degC.min()), float(kept.unit_degC.max())),
    )


def _kept(windows: OscillatorWindows, used: Flags) -> OscillatorWindows:
    """Return the usable windows; one after a dropped window no longer follows its neighbour."""
    beside = np.concatenate(([False], used[:-1]))
    return OscillatorWindows(
        windows.times_s[used],
        windows.gate_s[used],
        windows.fg_count[used],
        windows.unit_degC[used],
        (windows.contiguous & beside)[used],
    )


def _temperatures(windows: OscillatorWindows) -> int:
    return int(np.unique(np.round(windows.unit_degC / _STEP_degC)).size)


def _require(windows: OscillatorWindows, order: int) -> None:
    if windows.times_s.size < order + 2 or _temperatures(windows) < order + 1:
        raise FitError(
            "B-FIT-026",
            f"{windows.times_s.size} windows with generator pulses at {_temperatures(windows)} temperatures do not "
            f"determine a polynomial of degree {order}; {order + 2} windows at {order + 1} temperatures are due",
            next_step="check that the function generator was on and the unit's temperature recorded, or ask for a "
            "lower degree",
        )


def _noise(windows: OscillatorWindows, x: Floats, error: Floats, order: int) -> Whitener:
    """Return covariance of the relative errors: telescoping counts, and at least as much of independent noise."""
    design = np.vander(x, order + 1, increasing=True)
    residual = solve(design, error, np.eye(error.size), _names(order)).residual
    count_variance = float(np.mean((1.0 / windows.fg_count) ** 2 / 6.0))
    excess = max(float(residual @ residual) / (error.size - order - 1) - count_variance, count_variance)
    white = np.sqrt(excess * 2.0 * float(np.mean(windows.gate_s)))
    quantum = windows.gate_s / windows.fg_count
    return series_covariance("gated", windows.times_s, windows.gate_s, quantum, white, 0.0, windows.contiguous)


def _weighted(whitener: Whitener, x: Floats, error: Floats, order: int) -> tuple[Floats, Floats, float]:
    """Return coefficients, covariance and reduced chi-square of the whitened residuals."""
    basis, triangle = np.linalg.qr(whitener.whiten(np.vander(x, order + 1, increasing=True)))
    white = whitener.whiten(error)
    fit = solve(triangle, basis.T @ white, np.eye(order + 1), _names(order))
    rest = white - basis @ (basis.T @ white)
    square = float(rest @ rest)
    chi2 = square / (error.size - order - 1)
    autocorrelation = float(rest[1:] @ rest[:-1]) / square if square else 0.0
    scatter = rest**2 + max(1.0 - chi2, 0.0)
    covariance = fit.operator @ (basis.T @ (scatter[:, None] * basis)) @ fit.operator.T
    return fit.parameters, covariance * _inflation(autocorrelation), chi2


def _inflation(autocorrelation: float) -> float:
    """Return how much larger the variance of a mean is when neighbours agree; 0.99 keeps it finite."""
    correlated = min(max(autocorrelation, 0.0), 0.99)
    return (1.0 + correlated) / (1.0 - correlated)


def _names(order: int) -> list[str]:
    return [f"temperature coefficient {k}" for k in range(order + 1)]
