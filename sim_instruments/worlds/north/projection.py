"""Earth's rate as a gyroscope on a turning table feels it: rotation matrices, no small angles.

Local frame: x East, y North, z Up, right-handed. The frame of the table follows from it by the tilt of the rotation
axis, one turn about a horizontal axis. In the table's plane angles count counter-clockwise, as seen from above, from
the table's own east: a sensing axis of heading H (clockwise from north) stands at 90 deg - H.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_instruments.worlds.common.attitude import EARTH_RATE_RAD_S

Float = NDArray[np.float64]


def earth_rate_rad_s(latitude_deg: float) -> Float:
    """Earth's rate in the local frame (East, North, Up), rad/s, (3,)."""
    latitude = np.deg2rad(latitude_deg)
    return EARTH_RATE_RAD_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def tilted(east_deg: float, north_deg: float) -> Float:
    """Matrix of the turn by the vector (east, north, 0), degrees: columns are the table's axes in the local frame.

    Source: Rodrigues' formula.
    """
    vector = np.deg2rad([east_deg, north_deg, 0.0])
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


def sensed_rad_s(in_table: Float, angle_rad: Any, axis_tilt_deg: float) -> Float:
    """Component of a rate along the sensing axis.

    Args:
        in_table: the rate in the frame of the table, rad/s, (3,).
        angle_rad: where the sensing axis stands in the table's plane, any shape.
        axis_tilt_deg: its elevation above that plane.
    Returns: rad/s, shape of ``angle_rad``: the rate times Rz(angle) (cos tilt, 0, sin tilt).
    """
    east, north, up = in_table
    in_plane = east * np.cos(angle_rad) + north * np.sin(angle_rad)
    tilt = np.deg2rad(axis_tilt_deg)
    return np.asarray(np.cos(tilt) * in_plane + np.sin(tilt) * up)
