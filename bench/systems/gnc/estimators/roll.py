"""Roll angle from the corrected magnetometer components across the roll axis.

Sign: the angle is 0 where the field lies along +x and grows while the unit turns right-handed about +z: the field then
goes from +x towards -y.

Source: GNC paper (001) section 4.2 2); JCGM 100:2008 section 5.1 (uncertainty).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.magnetometer.ellipse import PlaneParameters

Array = NDArray[np.float64]
_EVERY_deg = 5.0


@dataclass(frozen=True)
class RollUncertainty:
    """Standard uncertainty of the roll angle in degrees over a whole turn.

    ``rms_deg``, ``worst_deg``: from the parameters; ``noise_deg``: of a single reading, to be added in quadrature.
    """

    rms_deg: float
    worst_deg: float
    noise_deg: float


def roll_deg(x: Array, y: Array) -> Array:
    """Roll angle of corrected components.

    Args:    x, y: (n,), any common unit.
    Returns: (n,), degrees, -180 to 180.
    Source:  see the head of this file.
    """
    return np.asarray(np.rad2deg(np.arctan2(-np.asarray(y), np.asarray(x))))


def roll_uncertainty(parameters: PlaneParameters, noise: float) -> RollUncertainty:
    """Return what the uncertainty of the five parameters and the noise of a reading make of the roll angle.

    Args:    parameters: with covariance and expected error of the method, both taken as random here.
             noise: of one reading on each axis, unit of the readings.
    Returns: RollUncertainty.
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
    return RollUncertainty(
        rms_deg=float(np.rad2deg(np.sqrt(variance.mean()))),
        worst_deg=float(np.rad2deg(np.sqrt(variance.max()))),
        noise_deg=float(np.rad2deg(noise / parameters.radius)),
    )
