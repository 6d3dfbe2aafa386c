"""The Earth's rate and gravity as a unit on a three-axis table sees them.

Local frame: East, North, Up. A vector of the body stands in the local frame as
``v_n = Rz(90 deg - azimuth) Rz(outer) Ry(middle) Rx(inner) M v_b``, right-handed; M says which body axis lies along
the inner axis of the table, the other two follow cyclically.

Source: GNC module paper section 4.2 (mounts); Groves, Principles of GNSS, Inertial, and Multisensor Integrated
Navigation Systems, section 2.4 (Earth rate in local coordinates).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.triad import AXES, propagate_inputs

Array = NDArray[np.float64]
EARTH_RATE_DEG_S = math.degrees(7.292115e-5)
TURNED = ("inner", "outer")


@dataclass(frozen=True)
class Site:
    """Where the table stands: latitude and azimuth of the inner axis at zero angles (clockwise from North), degrees.

    The standard uncertainties are of the latitude, of the azimuth and of each of the three small angles by which the
    unit is not in the pose asked for.
    """

    latitude_deg: float
    azimuth_deg: float
    latitude_std_deg: float = 0.0
    azimuth_std_deg: float = 0.0
    tilt_std_deg: float = 0.0


@dataclass(frozen=True)
class Pose:
    """Angles of the table in degrees, and the body axis ("x", "y", "z") that lies along its inner axis."""

    outer_deg: float = 0.0
    middle_deg: float = 0.0
    inner_deg: float = 0.0
    mounting: str = "x"


def mounting_matrix(mounting: str) -> Array:
    """M (3, 3): table = M body. "x": identity; "y": (y, z, x); "z": (z, x, y). Source: the frame of this module."""
    return np.roll(np.eye(3), AXES.index(mounting), axis=1)


def table_to_local(site: Site) -> Array:
    """(3, 3) from the frame of the table's base (inner axis at zero angles first, Up last) to East, North, Up."""
    return turned_about(2, 90.0 - site.azimuth_deg)


def attitude(pose: Pose, site: Site) -> Array:
    """(3, 3) matrix that takes a vector from the body to East, North, Up. Source: the formula of this module."""
    return np.asarray(table_to_local(site) @ body_to_table(pose))


def body_to_table(pose: Pose) -> Array:
    """(3, 3) from the body to the frame of the table's base."""
    outer, middle = turned_about(2, pose.outer_deg), turned_about(1, pose.middle_deg)
    return np.asarray(outer @ middle @ turned_about(0, pose.inner_deg) @ mounting_matrix(pose.mounting))


def turned_about(axis: int, angle_deg: float) -> Array:
    """Right-handed rotation matrix (3, 3) about axis 0, 1 or 2 by an angle in degrees."""
    angle, second, third = math.radians(angle_deg), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[second, second] = matrix[third, third] = math.cos(angle)
    matrix[second, third], matrix[third, second] = -math.sin(angle), math.sin(angle)
    return matrix


def earth_rate_local_deg_s(latitude_deg: float) -> Array:
    """(3,) East, North, Up: omega (0, cos lat, sin lat), deg/s. Source: Groves, equation (2.123) turned to ENU."""
    latitude = math.radians(latitude_deg)
    return EARTH_RATE_DEG_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def earth_rate_body_deg_s(pose: Pose, site: Site) -> Array:
    """(3,) what ideal gyroscopes read on a table at rest, deg/s; to be taken off a measured rate.

    Args:    pose, site: of the unit.
    Returns: (3,) deg/s in body axes. For a level axis it is omega cos(latitude) cos(its azimuth).
    Raises:  nothing.
    Source:  the formula of this module.
    """
    return np.asarray(attitude(pose, site).T @ earth_rate_local_deg_s(site.latitude_deg))


def earth_rate_covariance(pose: Pose, site: Site) -> Array:
    """Return covariance (3, 3), (deg/s)^2, of ``earth_rate_body_deg_s`` from latitude, azimuth and tilt of the site.

    Args:    pose, site: as above, the standard uncertainties of the site in degrees.
    Returns: (3, 3).
    Raises:  nothing.
    Source:  JCGM 102:2011 section 6.2.
    """

    def rate(inputs: Array) -> Array:
        there = Site(inputs[0], inputs[1])
        tilt = np.radians(inputs[2:])
        seen = earth_rate_body_deg_s(pose, there)
        return np.asarray(seen + np.cross(seen, tilt))

    std = np.array([site.latitude_std_deg, site.azimuth_std_deg, *[site.tilt_std_deg] * 3])
    at = np.array([site.latitude_deg, site.azimuth_deg, 0.0, 0.0, 0.0])
    return propagate_inputs(rate, at, np.diag(std**2))


def up_in_body(pose: Pose) -> Array:
    """(3,) unit vector: the specific force at rest, in g, that ideal accelerometers read. Source: this module."""
    return np.asarray(body_to_table(pose)[2])


def turn_axis_in_body(pose: Pose, turned: str) -> Array:
    """(3,) unit vector in body axes about which the unit turns at a positive rate of the table axis.

    Args:    pose: at the begin of the turn.   turned: "inner" or "outer".
    Returns: (3,), constant during the turn.
    Raises:  ValueError for another axis.
    Source:  the formula of this module.
    """
    if turned not in TURNED:
        raise ValueError(f"a table axis {turned!r} is none of {', '.join(TURNED)}")
    if turned == "outer":
        return up_in_body(pose)
    return np.asarray(mounting_matrix(pose.mounting)[0])
