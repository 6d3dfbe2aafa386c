"""Statistics of the calibrations of one unit: drift line, agreement, control limits, time left to a limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats, Integers
from bench.maths.least_squares import LinearFit, solve
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError

NO_STANDARD = -1
_LEAST_OWN = 1e-4  # part of a variance that is always taken as the calibration's own, however much a standard claims
_AS_STATED = 1e-3  # of the degrees of freedom
_MOST_STEPS = 40
_MEAN_RANGE = 1.128  # mean range of two readings of a normal distribution, in standard deviations (d2)
_RANGE_LIMIT = 3.267  # upper limit of the moving range over its mean (D4)


@dataclass(frozen=True)
class DriftLine:
    """Straight line through the calibrations of one parameter, ``value = mean + rate (t - t_mean)``.

    A unit that was adjusted has another mean since; the line is that since the last adjustment, the rate is of all.
    ``chi2`` is that of the calibrations as they stand: it says whether they scatter more than they state.
    ``between_std``: what each calibration then has beside its own uncertainty, 0 if they do not. ``covariance`` of
    (mean, rate) holds that too.
    """

    t_mean: float  # years
    mean: float
    rate: float  # per year
    covariance: Floats  # (2, 2)
    residual: Floats  # (m,) value - line, in the order of the readings
    chi2: float
    dof: int
    between_std: float

    @property
    def factor(self) -> float:
        """Two-sided 95 % factor: of Student's t where the scatter is estimated from the calibrations themselves."""
        return coverage_factor(self.dof) if self.between_std else coverage_factor()

    @property
    def rate_std(self) -> float:
        """Standard uncertainty of the rate, per year."""
        return float(np.sqrt(self.covariance[1, 1]))

    @property
    def rate_expanded(self) -> float:
        """Half-width of the 95 % interval of the rate, per year."""
        return self.factor * self.rate_std

    def at(self, t: Floats) -> Floats:
        """Return the line at times, (k,), years."""
        return np.asarray(self.mean + self.rate * (t - self.t_mean))

    def std_at(self, t: Floats) -> Floats:
        """Return standard uncertainty of the line at times, (k,), years."""
        later = t - self.t_mean
        variance = self.covariance[0, 0] + 2.0 * later * self.covariance[0, 1] + later**2 * self.covariance[1, 1]
        return np.asarray(np.sqrt(variance))


def fit_drift_line(
    t: Floats, value: Floats, std: Floats, shared: Floats, standard: Integers, level: Integers | None = None
) -> DriftLine:
    """Fit a drift line by generalised least squares, the error of a shared standard being common to its calibrations.

    Two calibrations with the same certificate have the covariance ``shared_i shared_j``; all else is independent. Where
    they scatter more than they state, each has a random effect of its own, so large that chi-square is what it must be.

    Args:    t: (m,), years.   value, std: (m,) and standard uncertainties, > 0.
             shared: (m,) standard uncertainty that comes from the standard, part of ``std``.
             standard: (m,) label of the standard's certificate, NO_STANDARD where nothing is shared.
             level: (m,) labels in order of time, another one after each adjustment of the unit; None: there was none.
    Returns: DriftLine in the unit of ``value`` and years.
    Raises:  FitError B-FIT-001 if all calibrations of each level were made at one time; B-FIT-002 if an uncertainty is
             not positive.
    Source:  Golub and Van Loan, Matrix Computations, section 6.1; R. C. Paule, J. Mandel, J. Res. NBS 87 (1982) 377,
             for the random effect, by Newton's method: 1 / chi-square is all but straight in its variance.
    """
    if not (std > 0.0).all():
        raise FitError(
            "B-FIT-002",
            "a calibration states an uncertainty that is not positive, so it has no weight",
            next_step="check the uncertainties of these estimates with 'bench history show'",
        )
    own2 = np.maximum(std**2 - shared**2, _LEAST_OWN * std**2)
    t_mean = float(np.average(t, weights=std**-2.0))
    levels = np.ones((t.size, 1)) if level is None else (level[:, None] == np.unique(level)).astype(np.float64)
    readings, dof = np.column_stack([levels, t - t_mean, value]), t.size - levels.shape[1] - 1
    between2, chi2 = 0.0, float("nan")
    for _ in range(_MOST_STEPS):
        own = np.sqrt(own2 + between2)
        fitted, left = _line(readings, own, shared, standard)
        excess = float(left @ left) - dof
        chi2 = excess + dof if between2 == 0.0 else chi2
        if dof < 1 or excess <= _AS_STATED * dof:
            break
        pull = _whitened(left[:, None], shared / own, standard)[:, 0] / own
        between2 += (excess + dof) / dof * excess / float(pull @ pull)
    return DriftLine(
        t_mean=t_mean,
        mean=float(fitted.parameters[-2]),
        rate=float(fitted.parameters[-1]),
        covariance=fitted.covariance[-2:, -2:],
        residual=value - levels @ fitted.parameters[:-1] - fitted.parameters[-1] * (t - t_mean),
        chi2=chi2,
        dof=dof,
        between_std=float(np.sqrt(between2)),
    )


def _line(readings: Floats, own: Floats, shared: Floats, standard: Integers) -> tuple[LinearFit, Floats]:
    """Return levels and rate of columns (level ..., t, value), and the residual made white."""
    white = _whitened(readings / own[:, None], shared / own, standard)
    turned, triangle = np.linalg.qr(white[:, :-1])
    names = [*["value"] * (triangle.shape[0] - 1), "rate"]
    fitted = solve(triangle, turned.T @ white[:, -1], np.eye(len(names)), names)
    return fitted, white[:, -1] - white[:, :-1] @ fitted.parameters


def _whitened(rows: Floats, shared: Floats, standard: Integers) -> Floats:
    """Return rows (m, k) that are white but for what the members of a certificate share, made white.

    The covariance of a certificate is ``1 + a a'``; its inverse square root is ``1 - c a a'`` with
    ``c = (1 - 1 / sqrt(1 + a'a)) / a'a``, so nothing of size (m, m) is ever made.
    """
    white = rows.copy()
    for label in np.unique(standard[standard != NO_STANDARD]):
        members = standard == label
        common = shared[members]
        power = float(common @ common)
        if power > 0.0:
            factor = (1.0 - 1.0 / np.sqrt(1.0 + power)) / power
            white[members] -= factor * np.outer(common, common @ rows[members])
    return white


def en_scores(change: Floats, expanded: tuple[Floats, Floats], shared_expanded: tuple[Floats, Floats]) -> Floats:
    """Return E_n of two calibrations, what both took from the same standard being left out.

    ``E_n = change / sqrt(U1^2 + U2^2 - 2 S1 S2)``; |E_n| <= 1 means that they agree within their uncertainties.

    Args:    change: second minus first, any shape.   expanded: U1, U2.
             shared_expanded: S1, S2, the expanded parts from a standard common to both; 0 where there is none.
    Returns: E_n, the shape of ``change``; NaN where a reading is missing or nothing is left of the uncertainty.
    Source:  ISO/IEC 17043, annex B (E_n); JCGM 100 equation (13) for the correlated part.
    """
    (first, second), (shared_first, shared_second) = expanded, shared_expanded
    variance = first**2 + second**2 - 2.0 * shared_first * shared_second
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(variance > 0.0, change / np.sqrt(variance), np.nan))


@dataclass(frozen=True)
class IndividualsChart:
    """Control limits of single readings from their moving range; ``sigma`` is the short-term standard deviation."""

    centre: float
    sigma: float
    mean_range: float

    @property
    def warning(self) -> tuple[float, float]:
        """Lower and upper limit at 2 sigma."""
        return self.centre - 2.0 * self.sigma, self.centre + 2.0 * self.sigma

    @property
    def action(self) -> tuple[float, float]:
        """Lower and upper limit at 3 sigma."""
        return self.centre - 3.0 * self.sigma, self.centre + 3.0 * self.sigma

    @property
    def range_limit(self) -> float:
        """Upper limit of the moving range."""
        return _RANGE_LIMIT * self.mean_range


def individuals_chart(readings: Floats) -> IndividualsChart:
    """Return Shewhart chart of individual readings with moving ranges of two (I-MR).

    Args:    readings: (m,), m >= 2, in order of time; of a drifting parameter: its residuals about the drift line.
    Returns: IndividualsChart in the unit of the readings.
    Raises:  FitError B-FIT-001 with fewer than two readings.
    Source:  Shewhart 1931; Montgomery, Introduction to Statistical Quality Control, section 6.4; ISO 7870-2.
    """
    if readings.size < 2:
        raise FitError(
            "B-FIT-001",
            f"{readings.size} readings have no moving range",
            next_step="add calibrations of this unit to the history",
        )
    mean_range = float(np.abs(np.diff(readings)).mean())
    return IndividualsChart(float(readings.mean()), mean_range / _MEAN_RANGE, mean_range)


def days_to_limit(
    value: Floats, std: Floats, rate: Floats, rate_std: Floats, low: Floats, high: Floats, *, most_days: int
) -> Integers:
    """Return whole days until ``value + rate t -+ k u(t)`` reaches a limit, ``u(t)^2 = std^2 + (rate_std t)^2``.

    Args:    value, std: (p,) what is known at t = 0.   rate, rate_std: (p,) per day; NaN means that no drift is known.
             low, high: (p,) limits, infinite where there is none.   most_days: no more is promised than this.
    Returns: (p,) days, 0 ... most_days; most_days where there is no limit, 0 where the value or its uncertainty is not
             known.
    Source:  ILAC-G24 / OIML D 10, control-chart method; coverage factor k of JCGM 100 section 6.3.
    """
    day = np.arange(most_days + 1, dtype=np.float64)[:, None]
    speed, speed_std = np.nan_to_num(rate), np.nan_to_num(rate_std)
    middle, reach = value + speed * day, coverage_factor() * np.hypot(std, speed_std * day)
    over = ~((middle + reach < high) & (middle - reach > low))
    first = np.where(over.any(axis=0), over.argmax(axis=0), most_days + 1)
    return np.asarray(np.clip(first - 1, 0, most_days), dtype=np.int64)
