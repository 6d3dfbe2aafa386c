"""The Earth as the simulated flights see it: rate and gravity in a local tangent plane (north, east, down).

The plane is fixed to the Earth at the origin, height 0: there is no transport rate, and the Earth's rate is constant.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

LATITUDE_DEG = 37.5
EARTH_RATE_RAD_S = 7.292115e-5
RADIUS_M = 6_371_000.0
STANDARD_GRAVITY_M_S2 = 9.80665  # what a "g" means in a sensor's specification

# WGS-84: NIMA TR8350.2, third edition (2000), tables 3.1 to 3.4
_EQUATOR_M_S2 = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_ECCENTRICITY_2 = 0.00669437999013


def normal_gravity_m_s2(latitude_deg: float) -> float:
    """Normal gravity on the ellipsoid, m/s2. Source: Somigliana's formula, NIMA TR8350.2 eq. (4-1)."""
    sine_2 = math.sin(math.radians(latitude_deg)) ** 2
    return _EQUATOR_M_S2 * (1.0 + _SOMIGLIANA * sine_2) / math.sqrt(1.0 - _ECCENTRICITY_2 * sine_2)


def earth_rate_rad_s(latitude_deg: float) -> Float:
    """Return rate of the Earth against inertial space, (north, east, down), rad/s."""
    latitude = math.radians(latitude_deg)
    return EARTH_RATE_RAD_S * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])


def gravity_gradient_s2(latitude_deg: float) -> Float:
    """Diagonal of the gradient of gravity about the origin, that of a point mass, (3,), 1/s2."""
    return normal_gravity_m_s2(latitude_deg) / RADIUS_M * np.array([-1.0, -1.0, 2.0])


def gravity_m_s2(position_m: Float, latitude_deg: float) -> Float:
    """Gravity at positions (..., 3) north, east, down of the origin, to first order in them; (..., 3), m/s2."""
    gravity = np.asarray(position_m * gravity_gradient_s2(latitude_deg))
    gravity[..., 2] += normal_gravity_m_s2(latitude_deg)
    return gravity
