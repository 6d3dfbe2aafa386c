"""What a tilted rotation axis does to the north that was found.

The lock-ins see the component of the Earth's rate across the rotation axis. An axis that leans east by a small angle
(right-handed tilt about north) mixes some of the vertical rate, omega sin(latitude), into the plane, towards west: the
north that is found turns west by tilt times tan(latitude). A lean to the north changes the amplitude only.

Source: projection of (0, cos lat, sin lat) on the plane across (tilt, 0, 1) to first order; what FOG paper (002)
equation (7) leaves out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.model.errors import FitError
from bench.systems.north.estimators.phasors import Array

LARGEST_LATITUDE_deg = 89.0


def tilt_correction_deg(x_mrad: ArrayLike, y_mrad: ArrayLike, heading_deg: ArrayLike, latitude_deg: float) -> Array:
    """Correction of the heading found, for the tilt of the rotation axis.

    Args:    x_mrad: tilt about the direction of the sensing axis at encoder zero, right-handed.   y_mrad: about the
             direction 90 degrees clockwise of it.   heading_deg: of the sensing axis at encoder zero, as found.
             latitude_deg: north positive, at most 89 either way.
    Returns: degrees, to be added to the heading; of second order at most 0.0015 deg is left at 10 mrad and 37 degrees.
    Raises:  FitError B-FIT-115 nearer to a pole, where there is no north to find.
    Source:  see the head of this file: -(x cos H - y sin H) tan(latitude).
    """
    heading = np.deg2rad(np.asarray(heading_deg, np.float64))
    about_north = np.asarray(x_mrad, np.float64) * np.cos(heading) - np.asarray(y_mrad, np.float64) * np.sin(heading)
    return np.asarray(-np.rad2deg(1e-3 * about_north) * _tangent(latitude_deg))


def tilt_std_deg(level_std_mrad: float, latitude_deg: float) -> float:
    """Return standard uncertainty of the heading from that of the level, alike and independent on both axes: degrees.

    Raises:  FitError B-FIT-115 within one degree of a pole.
    """
    return float(np.rad2deg(1e-3 * level_std_mrad) * abs(_tangent(latitude_deg)))


def _tangent(latitude_deg: float) -> float:
    if not abs(latitude_deg) <= LARGEST_LATITUDE_deg:
        raise FitError(
            "B-FIT-115",
            f"latitude {latitude_deg:g} deg (limit {LARGEST_LATITUDE_deg:g}): the Earth's rate has no horizontal part",
            next_step="state latitude_deg of the site in degrees, north positive",
        )
    return float(np.tan(np.deg2rad(latitude_deg)))
