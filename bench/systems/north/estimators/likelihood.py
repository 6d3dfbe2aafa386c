"""North by maximum likelihood: linear least squares of the raw samples on sine and cosine of the encoder angle; how
well north can be known at all, and how long it takes.

``U = a sin(theta) + b cos(theta) + c + harmonics``, phi = atan2(b, a). The reference is a pure sine, so the second and
higher harmonics leave phi alone over whole turns, and no share of the signal is lost. The angle is the encoder's, so a
table that swings about its rotation does no harm.

The standard uncertainty is that of white noise, unless the residuals say otherwise: they are looked at turn by turn,
and where these scatter more than white noise would (F test at the significance asked for), the scatter of the turns
takes its place.

Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, section 4.3 and example 4.2 (linear model
in white Gaussian noise), example 3.4 (bound); for the square reference, the Fourier series of FOG paper (002) eq. (10).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.maths.arrays import Floats, Integers
from bench.maths.tests import f_tail
from bench.model.errors import FitError
from bench.systems.north.estimators.phasors import Complex, angle_deg

SQUARE_PENALTY = math.pi / math.sqrt(8.0)  # of the standard deviation: mean noise power 1, of the sine's share 8/pi^2
LEAST_SEPARATION = 0.05  # smallest singular value over the largest, columns of unit size
FEWEST_TURNS = 5  # whose scatter says anything
SIGNIFICANCE = 0.01


def north_bound_deg(ke_V: float, sigma_V: float, samples: int) -> float:
    """Cramer-Rao bound of the phase: the smallest standard deviation of an estimator without bias.

    Args:    ke_V: amplitude of the earth signal.   sigma_V: standard deviation of the white noise of one sample.
             samples: in all whole turns together.
    Returns: degrees, sqrt(2) sigma / (Ke sqrt(N)), the same whether amplitude and offset are known or not.
    Source:  Kay, equation (3.41) and example 3.14: offset and amplitude are orthogonal to the phase over whole turns.
    """
    return float(np.rad2deg(sigma_V / ke_V * np.sqrt(2.0 / samples)))


def time_to_accuracy_s(
    std_deg: ArrayLike, seconds: float, accuracy_deg: float, *, factor: float = 1.0, floor_deg: ArrayLike = 0.0
) -> Floats:
    """Time of turning until ``factor`` standard uncertainties are within the accuracy.

    Args:    std_deg: standard deviation by noise after ``seconds``: measured scatter or bound.
             seconds: of signal in it.   accuracy_deg: required, > 0.   factor: coverage factor, 1 for the standard one.
             floor_deg: standard uncertainty that no time takes away (calibration, tilt).
    Returns: seconds, like 1/accuracy^2; infinity where the floor alone is too much.
    Raises:  FitError B-FIT-114 unless accuracy and seconds are above zero.
    Source:  variance of a mean of independent white noise.
    """
    if not (accuracy_deg > 0.0 and seconds > 0.0):
        raise FitError(
            "B-FIT-114",
            f"required accuracy {accuracy_deg:g} deg after {seconds:g} s: both must be above zero",
            next_step="state the limit azimuth_error in degrees, above zero",
        )
    left_deg2 = (accuracy_deg / factor) ** 2 - np.square(np.asarray(floor_deg, np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        time_s = seconds * np.square(np.asarray(std_deg, np.float64)) / left_deg2
    return np.where(left_deg2 > 0.0, time_s, math.inf)


@dataclass(frozen=True)
class LikelihoodNorth:
    """Phase of the earth signal from the raw samples of one record.

    Attributes:
        phi_deg: -180 (excluded) to 180.   std_deg: standard uncertainty, ``dof`` degrees of freedom.
        phasor: amplitude exp(i phi), V.   noise_V: standard deviation of one sample.   offset_V: constant part.
        harmonics: amplitude times exp(i phase) of each order asked for, V, (h,).
        bound_deg: Cramer-Rao bound at this amplitude and noise.   whiteness: variance of the turns over that of white
            noise, NaN for fewer than five turns.   turns: their number.   widened: where their scatter is the
            uncertainty.
        samples, dropped: used, and left out because a value is NaN.
    """

    phi_deg: float
    std_deg: float
    dof: float
    phasor: complex
    noise_V: float
    offset_V: float
    harmonics: Complex
    bound_deg: float
    whiteness: float
    turns: int
    widened: bool
    samples: int
    dropped: int

    @property
    def amplitude(self) -> float:
        """Amplitude of the earth signal, V."""
        return float(np.abs(self.phasor))

    @property
    def white_std_deg(self) -> float:
        """Standard uncertainty that white noise of this size would give, degrees."""
        return self.std_deg / math.sqrt(self.whiteness) if self.widened else self.std_deg


@dataclass(frozen=True)
class _Turning:
    """Columns of the linear model (n, 3 + 2 h): sine, cosine, one, then pairs; inverse normal matrix; turn (n,)."""

    columns: Floats
    inverse: Floats
    turn: Integers


def likelihood_north(
    u_V: ArrayLike, theta_deg: ArrayLike, *, harmonics: Sequence[int] = (), noise_V: float | None = None,
    significance: float = SIGNIFICANCE,
) -> LikelihoodNorth:  # fmt: skip
    """Return phase of the earth signal from raw samples and encoder angles of one record.

    Args:    u_V: output of the gyroscope, (n,), in order of time; NaN for a sample that is missing.
             theta_deg: encoder angle at the middle of each sample, (n,), modulo a turn or not.
             harmonics: orders above 1 to fit as well, such as (2, 3).
             noise_V: declared standard deviation of one sample, white; None for what the fit leaves over.
             significance: chance that white noise widens the record; smaller where many are judged together.
    Returns: LikelihoodNorth; phi is against the encoder, so it belongs to sense +1 whichever way the table turned.
    Raises:  FitError B-FIT-112 if the samples do not determine north: too few, or too small a part of a turn.
    Source:  see the head of this file.
    """
    u, theta = np.asarray(u_V, np.float64), np.asarray(theta_deg, np.float64)
    if u.ndim != 1 or theta.shape != u.shape:
        raise _undetermined(f"{u.shape} samples and {theta.shape} encoder angles do not belong together")
    good = np.isfinite(u) & np.isfinite(theta)
    u, turning = u[good], _turning(theta[good], harmonics)
    values = turning.inverse @ (turning.columns.T @ u)
    residual = u - turning.columns @ values
    dof = float(u.size - len(values))
    noise = float(np.sqrt(residual @ residual / dof)) if noise_V is None else noise_V
    phasor = complex(values[0], values[1])
    across = np.array([-values[1], values[0]]) / (abs(phasor) or 1.0)  # the component that turns phi
    std = noise * float(np.sqrt(across @ turning.inverse[:2, :2] @ across))
    seen = noise if noise_V is None else 0.0  # a noise that is declared is white
    ratio, turns = _whiteness(residual, turning.columns[:, :2] @ across, turning.turn, seen)
    widened = turns >= FEWEST_TURNS and bool(f_tail(ratio, turns - 1, dof) < significance)
    if widened:
        std, dof = std * math.sqrt(ratio), float(turns - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        bound_deg = north_bound_deg(np.abs(phasor), noise, u.size)
        std_deg = float(np.rad2deg(std / np.abs(phasor)))
    return LikelihoodNorth(
        phi_deg=float(angle_deg(phasor)),
        std_deg=std_deg,
        dof=dof,
        phasor=phasor,
        noise_V=noise,
        offset_V=float(values[2]),
        harmonics=np.asarray(values[3:].reshape(-1, 2) @ np.array([1.0, 1.0j])),
        bound_deg=bound_deg,
        whiteness=ratio,
        turns=turns,
        widened=widened,
        samples=u.size,
        dropped=good.size - u.size,
    )


def _turning(theta_deg: Floats, orders: Sequence[int]) -> _Turning:
    """Return what follows from the encoder angles; refuses those that do not determine north."""
    angle, unknown = np.deg2rad(np.mod(theta_deg, 360.0)), 3 + 2 * len(orders)
    if angle.size <= unknown:
        raise _undetermined(f"{angle.size} good samples for {unknown} unknowns")
    more = [function(order * angle) for order in orders for function in (np.sin, np.cos)]
    columns = np.column_stack((np.sin(angle), np.cos(angle), np.ones(angle.size), *more))
    normal = columns.T @ columns  # well conditioned once checked
    unit = np.sqrt([2.0, 2.0, 1.0, *[2.0] * (unknown - 3)])
    sizes = np.linalg.eigvalsh(normal * np.outer(unit, unit))
    separation = float(np.sqrt(max(sizes[0], 0.0) / sizes[-1]))
    if separation < LEAST_SEPARATION:
        raise _undetermined(
            f"the encoder angles cover too little of a turn (separation {separation:.2g}, limit {LEAST_SEPARATION:g})"
        )
    turned = np.unwrap(theta_deg, period=360.0) - theta_deg[0]
    return _Turning(columns, np.linalg.inv(normal), np.floor(np.abs(turned) / 360.0).astype(np.int64))


def _undetermined(what: str) -> FitError:
    return FitError(
        "B-FIT-112",
        f"the raw samples do not determine north: {what}",
        next_step="record whole turns at a steady rate; look at the lost frames and at the encoder in the report",
    )


def _whiteness(residual: Floats, slope: Floats, turn: Integers, noise: float) -> tuple[float, int]:
    """Variance of what each turn says of phi over that of white noise, and the turns; NaN for too few."""
    weight = np.bincount(turn, np.square(slope))
    whole = weight > 0.5 * weight.max()
    turns = int(np.count_nonzero(whole))
    if turns < FEWEST_TURNS or noise == 0.0:
        return float("nan"), turns
    score = np.bincount(turn, residual * slope)[whole] / np.sqrt(weight[whole])
    return float(np.square(score).sum() / (turns - 1) / noise**2), turns
