"""Gravity and Earth rate in a local tangent plane, north-east-down, fixed to the Earth.

Source: WGS-84 (NIMA TR8350.2, 3rd edition, table 3.4 and equation 4-1): normal gravity on the ellipsoid by Somigliana's
formula; its gradient about the origin as that of a point mass, -1/R level and 2/R vertical.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EARTH_RATE_rad_s = 7.292115e-5
EARTH_RADIUS_m = 6_371_000.0  # of the gradient
_EQUATOR_m_s2 = 9.7803253359
_SOMIGLIANA = 1.93185265241e-3
_ECCENTRICITY_SQUARED = 6.69437999014e-3


def normal_gravity(latitude_deg: float) -> float:
    """Return normal gravity at height 0, m/s^2, positive down.

    Source: Somigliana's formula with the constants of WGS-84.
    """
    sine2 = float(np.sin(np.deg2rad(latitude_deg))) ** 2
    return float(_EQUATOR_m_s2 * (1.0 + _SOMIGLIANA * sine2) / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * sine2))


def gradient(latitude_deg: float) -> Array:
    """Return diagonal of the gravity gradient (north, east, down), 1/s^2: change of gravity per metre of position."""
    return normal_gravity(latitude_deg) / EARTH_RADIUS_m * np.array([-1.0, -1.0, 2.0])


def earth_rate(latitude_deg: float) -> Array:
    """Return rate of the Earth in t, (3,), rad/s."""
    angle = np.deg2rad(latitude_deg)
    return EARTH_RATE_rad_s * np.array([np.cos(angle), 0.0, -np.sin(angle)])
