"""Two magnetometer axes turned about the third: the paper's extremes beside the ellipse, and the roll angle of both.

The way of the paper uses five readings of thousands: noise pushes every extreme outwards, the reading that happens
to be the largest stands up to some degrees beside the true top, and where the turn holds a whole number of readings
the top may be missed altogether. What this does to each parameter follows from the distribution of the largest of
many readings, which the phases and the noise of the least-squares ellipse give. RMS errors of 50 simulated units (0.43
gauss, noise 0.5 mgauss, 3 min at 200 Hz, 15 turns per second or 15 deg/s): zero 0.15 mgauss, K_y 0.04 to 0.09 %, alpha
1.2 to 2.5 degrees; the ellipse is better by 36 to 50, 26 to 55 and 1,400 to 2,600 times.

Sign of roll: the angle is 0 where the field lies along +x and grows while the unit turns right-handed about +z: the
field then goes from +x towards -y.

Source: GNC paper (001) equations (5) to (9), K_y and sin(alpha) of its section 4.2 2); David and Nagaraja, Order
Statistics (2003), section 2.2: F_max(m) = prod F_i(m); JCGM 100:2008 section 5.1 (uncertainty of roll).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from bench.maths.arrays import Floats, rms
from bench.systems.gnc.estimators.magnetometer.ellipse import EllipseFit, PlaneParameters, fit_ellipse

EXTREMES, ELLIPSE = "extremes", "ellipse"
_REACH = 8.0  # noise deviations below the top: readings further down are never the largest
_BELOW, _ABOVE = 5.0, 7.0  # noise deviations about the top in which the largest of up to a million readings lies
_GRID = 200
_EVERY_deg = 5.0


@dataclass(frozen=True)
class PlaneComparison:
    """Both methods on the same readings.

    Attributes:
        ellipse, extremes: the fits.   roll: uncertainty of the roll angle by method.
        roll_difference_deg: (rms, largest) of roll by extremes minus roll by ellipse over the readings.
        score: (5,) difference of the parameters over its standard uncertainty, in the order of
            ``bench.systems.gnc.estimators.magnetometer.ellipse.PARAMETERS``.
    """

    ellipse: EllipseFit
    extremes: ExtremesFit
    roll_std_deg: dict[str, float]
    roll_difference_deg: tuple[float, float]
    score: Floats

    @property
    def by_method(self) -> dict[str, PlaneParameters]:
        """Parameters under the names that results carry: "extremes", "ellipse"."""
        return {EXTREMES: self.extremes.parameters, ELLIPSE: self.ellipse.parameters}


def compare_methods(x_out: Floats, y_out: Floats, noise: float | None = None) -> PlaneComparison:
    """Fit the readings of a rotation by both methods.

    Args:    x_out, y_out: (n,), same unit, gaps left out.   noise: of readings that hold none.
    Returns: PlaneComparison.
    Raises:  FitError B-FIT-090, B-FIT-091 as ``ellipse.fit_ellipse``: readings that do not determine the
             ellipse have no extremes either.
    Source:  see the head of this file.
    """
    ellipse = fit_ellipse(x_out, y_out, noise)
    x_out, y_out = x_out[~ellipse.odd], y_out[~ellipse.odd]
    extremes = fit_extremes(x_out, y_out, ellipse)
    both = {EXTREMES: extremes.parameters, ELLIPSE: ellipse.parameters}
    rolls = {name: roll_deg(*parameters.corrected(x_out, y_out)) for name, parameters in both.items()}
    difference = (rolls[EXTREMES] - rolls[ELLIPSE] + 180.0) % 360.0 - 180.0
    largest = (rms(difference), float(np.abs(difference).max()))
    return _compared(ellipse, extremes, largest)


def widened(seen: PlaneComparison, wander: float, dof: float) -> PlaneComparison:
    """Return the same fits with the noise that other records of the same field were found to have.

    Few turns cannot tell a field that wanders from an offset. The extremes go with the offset of the ellipse.

    Args:    wander: variance of a sum of readings over that of independent noise, >= 1, at the rate of these readings.
             dof: degrees of freedom behind it.
    Returns: PlaneComparison; as it was where its own readings wander more.
    Source:  variance of a sum of correlated readings (``estimators.magnetometer.wander``).
    """
    own = seen.ellipse.quadric.wander.factor**2 if seen.ellipse.quadric.wander.blocks else 1.0
    if wander <= own:
        return seen
    was, of_extremes = seen.ellipse.parameters, seen.extremes.parameters
    both_dof = np.minimum(was.dof, dof)
    wider = replace(was, covariance=was.covariance * wander / own, dof=both_dof)
    added = replace(
        of_extremes, covariance=of_extremes.covariance + was.covariance * (wander - 1.0) / own, dof=both_dof
    )
    ellipse, extremes = replace(seen.ellipse, parameters=wider), replace(seen.extremes, parameters=added)
    return _compared(ellipse, extremes, seen.roll_difference_deg)


def _compared(ellipse: EllipseFit, extremes: ExtremesFit, roll_difference_deg: tuple[float, float]) -> PlaneComparison:
    both = {EXTREMES: extremes.parameters, ELLIPSE: ellipse.parameters}
    return PlaneComparison(
        ellipse=ellipse,
        extremes=extremes,
        roll_std_deg={name: roll_std_deg(parameters) for name, parameters in both.items()},
        roll_difference_deg=roll_difference_deg,
        score=(extremes.parameters.values - ellipse.parameters.values)
        / np.hypot(extremes.parameters.std, ellipse.parameters.std),
    )


@dataclass(frozen=True)
class ExtremesFit:
    """``parameters``: of the paper's method; ``parameters.bias`` is the error that the phases and the noise lead to
    expect, which the paper's equations do not take off. ``phases``: distinct phases of the turn that were read, 0
    for a turn without a gap.
    """

    parameters: PlaneParameters
    phases: int


@dataclass(frozen=True)
class _Top:
    """Largest of many readings about a cosine: expected excess over its true top, scatter of it, and phase of the
    winner (radian from the top), mean and scatter."""

    excess: float
    scatter: float
    phase: float
    phase_scatter: float


def fit_extremes(x_out: Floats, y_out: Floats, ellipse: EllipseFit) -> ExtremesFit:
    """Return the paper's five equations, with an uncertainty of what they leave out.

    Args:    x_out, y_out: (n,), same unit.   ellipse: of the same readings; its phases and noise serve the
             uncertainty only, no value comes from it.
    Returns: ExtremesFit.
    Source:  see the head of this file; sin(alpha) = x / y where y is largest, both after zero and gain.
    """
    high, low = np.array([x_out.max(), y_out.max()]), np.array([x_out.min(), y_out.min()])
    offset, span = (high + low) / 2.0, high - low
    gain = float(span[0] / span[1])
    top = int(np.argmax(y_out))
    sine = float(np.clip((x_out[top] - offset[0]) / (gain * (y_out[top] - offset[1])), -1.0, 1.0))
    bias, covariance = _expected(ellipse)
    parameters = PlaneParameters(
        offset=offset,
        gain=gain,
        alpha_deg=float(np.rad2deg(np.arcsin(sine))),
        radius=float(span[0] / 2.0),
        covariance=covariance,
        bias=bias,
    )
    return ExtremesFit(parameters, ellipse.phases)


def _expected(ellipse: EllipseFit) -> tuple[Floats, Floats]:
    """Expected error (5,) and covariance (5, 5) of the parameters, first order in the errors of the extremes."""
    fitted = ellipse.parameters
    phase = np.deg2rad(ellipse.phase_deg)
    skew = np.deg2rad(fitted.alpha_deg)
    amplitude_y = fitted.radius / fitted.gain
    tops = [_top(phase - skew - turn, fitted.radius, ellipse.noise) for turn in (0.0, np.pi)]
    tops += [_top(phase - turn, amplitude_y, ellipse.noise) for turn in (np.pi / 2.0, -np.pi / 2.0)]
    at_top = tops[2]  # where y is largest, x is read for alpha
    slope = np.array([
        [0.5, -0.5, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.5, -0.5, 0.0],
        [0.5 / amplitude_y, 0.5 / amplitude_y, *[-0.5 * fitted.gain / amplitude_y] * 2, 0.0],
        [0.0, 0.0, 0.0, 0.0, -np.rad2deg(1.0)],
        [0.5, 0.5, 0.0, 0.0, 0.0],
    ])  # fmt: skip
    mean = np.array([*(top.excess for top in tops), at_top.phase])
    single = ellipse.noise / fitted.radius  # noise of the one reading of x that gives alpha
    spread = np.array([*(top.scatter for top in tops), np.hypot(at_top.phase_scatter, single)])
    bias = slope @ mean
    bias[2] = fitted.gain * (fitted.radius + bias[4]) / (fitted.radius + fitted.gain * mean[2:4].mean()) - fitted.gain
    return bias, slope @ np.diag(spread**2) @ slope.T


def _top(phase: Floats, amplitude: float, noise: float) -> _Top:
    """Distribution of the largest of the readings ``amplitude cos(phase) + noise``."""
    fold = (phase + np.pi) % (2.0 * np.pi) - np.pi
    level = amplitude * (np.cos(fold) - 1.0)
    best = float(level.max())
    near = level >= best - _REACH * noise
    level, fold = level[near], fold[near]
    if noise == 0.0:
        return _Top(best, 0.0, float(fold[np.argmax(level)]), 0.0)
    grid = np.linspace(best - _BELOW * noise, best + _ABOVE * noise, _GRID)
    log_below, hazard = np.zeros(_GRID), np.zeros((3, _GRID))
    for index, at in enumerate(grid):
        score = (at - level) / noise
        log_cdf = special.log_ndtr(score)
        log_below[index] = log_cdf.sum()
        rate = np.exp(-(score**2) / 2.0 - log_cdf)
        hazard[:, index] = rate.sum(), rate @ fold, rate @ fold**2
    weight = hazard * np.exp(log_below)
    total = weight[0].sum()
    share = weight[0] / total
    excess = float(share @ grid)
    mean_phase = float(weight[1].sum() / total)
    return _Top(
        excess=excess,
        scatter=float(np.sqrt(share @ (grid - excess) ** 2)),
        phase=mean_phase,
        phase_scatter=float(np.sqrt(max(weight[2].sum() / total - mean_phase**2, 0.0))),
    )


def roll_deg(x: Floats, y: Floats) -> Floats:
    """Roll angle of corrected components.

    Args:    x, y: (n,), any common unit.
    Returns: (n,), degrees, -180 to 180.
    Source:  see the head of this file.
    """
    return np.rad2deg(np.arctan2(-np.asarray(y), np.asarray(x)))


def roll_std_deg(parameters: PlaneParameters) -> float:
    """Return what the uncertainty of the five parameters makes of the roll angle, root mean square over a whole turn.

    Args:    parameters: with covariance and expected error of the method, both taken as random here.
    Returns: degrees; the noise of a single reading is to be added in quadrature.
    Source:  first derivatives: d roll = (sin r dx + cos r dy) (-1) / radius with dx, dy of the corrected components.
    """
    angle = np.deg2rad(np.arange(0.0, 360.0, _EVERY_deg))
    x, y = np.cos(angle) * parameters.radius, -np.sin(angle) * parameters.radius
    sine, cosine = np.sin(np.deg2rad(parameters.alpha_deg)), np.cos(np.deg2rad(parameters.alpha_deg))
    ones = np.ones(angle.size)
    along_x = np.column_stack((
        -ones / cosine,
        ones * parameters.gain * sine / cosine,
        -y / parameters.gain * sine / cosine,
        np.deg2rad(x * sine / cosine - y),
        0.0 * ones,
    ))  # fmt: skip
    along_y = np.column_stack((0.0 * ones, -parameters.gain * ones, y / parameters.gain, 0.0 * ones, 0.0 * ones))
    slope = -(np.sin(angle)[:, None] * along_x + np.cos(angle)[:, None] * along_y) / parameters.radius
    covariance = parameters.covariance + np.diag(parameters.bias**2)
    variance = np.einsum("np,pq,nq->n", slope, covariance, slope)
    return float(np.rad2deg(np.sqrt(variance.mean())))
