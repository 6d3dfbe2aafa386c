"""Place and motion of the simulated module: table angles, mounting, Earth's rate and gravity.

Local frame: x East, y North, z Up. v_n = Rz(90 deg - azimuth) Rz(outer) Ry(middle) Rx(inner) M v_b, right-handed,
angles in degrees; M puts the body axis named by the mounting along the inner axis of the table. A small tilt turns the
body against the inner axis; it is kept to its first order (1 arcmin squared is 8e-8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bench.model.arrays import Floats, Integers

EARTH_RATE_RAD_S = 7.292115e-5
STANDARD_GRAVITY_M_S2 = 9.80665  # the "g" of the bench's units
BODY_OF_TABLE = {"x": (0, 1, 2), "y": (2, 0, 1), "z": (1, 2, 0)}  # which table component body x, y, z is


class AxisMotion(Protocol):
    """Angle and rate of one axis of the table at bench times."""

    def angle_deg(self, t_ns: Integers) -> Floats:
        """Return angle at bench times (n,), degrees."""

    def rate_deg_s(self, t_ns: Integers) -> Floats:
        """Return its derivative, degrees per second."""


class Surroundings(Protocol):
    """The world as the sensors see it. ``motion`` is (outer, middle, inner)."""

    motion: Sequence[AxisMotion]
    mounting: str  # body axis along the inner axis: "x", "y" or "z"
    table: str  # "turntable", "non_magnetic" or "bench"


@dataclass(frozen=True)
class Site:
    """The place of the bench; with all angles zero the inner axis points at ``azimuth_deg``, clockwise from North."""

    latitude_deg: float = 34.2
    gravity_m_s2: float = 9.7969
    azimuth_deg: float = 90.0

    @property
    def earth_rate_deg_s(self) -> Floats:
        """Earth's rate in the local frame (East, North, Up), degrees per second."""
        latitude = np.deg2rad(self.latitude_deg)
        return np.array([0.0, np.cos(latitude), np.sin(latitude)]) * float(np.rad2deg(EARTH_RATE_RAD_S))

    @property
    def rest_force_g(self) -> Floats:
        """Specific force at rest in the local frame, standard g: up."""
        return np.array([0.0, 0.0, self.gravity_m_s2 / STANDARD_GRAVITY_M_S2])


@dataclass(frozen=True)
class Tilt:
    """Small turn of the body against the inner axis, radians about the table's axes: a constant of the mounting,
    and a wobble with the inner and with the middle angle (first harmonics), a third of the variance each.
    """

    constant: Floats  # (3,)
    with_inner: Floats  # (2, 3), of cosine and sine
    with_middle: Floats  # (2, 3)

    def rad(self, angles_deg: Floats) -> Floats:
        """Turn at table angles (n, 3), radians, (n, 3)."""
        inner, middle = np.deg2rad(angles_deg[:, 2]), np.deg2rad(angles_deg[:, 1])
        wobble = np.stack((np.cos(inner), np.sin(inner)), 1) @ self.with_inner
        return self.constant + wobble + np.stack((np.cos(middle), np.sin(middle)), 1) @ self.with_middle


def cross_matrix(vector: Floats) -> Floats:
    """Return the matrix of the cross product with a vector (3,), (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def angles_deg(motion: Sequence[AxisMotion], t_ns: Integers) -> Floats:
    """Return outer, middle and inner angle at bench times, (n, 3), degrees."""
    return np.stack([axis.angle_deg(t_ns) for axis in motion], axis=1)


def in_inner_axes(vector: Floats, angles: Floats, site: Site) -> Floats:
    """Return a vector of the local frame (3,) in the axes of the inner gimbal at table angles (n, 3): (n, 3)."""
    outer, middle, inner = np.deg2rad(angles).T
    turn = outer + np.deg2rad(90.0 - site.azimuth_deg)
    east, north, up = vector
    x, y = np.cos(turn) * east + np.sin(turn) * north, np.cos(turn) * north - np.sin(turn) * east
    x, z = np.cos(middle) * x - np.sin(middle) * up, np.sin(middle) * x + np.cos(middle) * up
    return np.stack((x, np.cos(inner) * y + np.sin(inner) * z, np.cos(inner) * z - np.sin(inner) * y), axis=1)


def in_body_axes(inner_axes: Floats, mounting: str, tilt_rad: Floats | None = None) -> Floats:
    """Return vectors in the axes of the inner gimbal (n, 3) in those of the body; ``tilt_rad`` as ``Tilt`` gives it."""
    if tilt_rad is not None:
        inner_axes = inner_axes - np.cross(tilt_rad, inner_axes)
    return inner_axes[:, BODY_OF_TABLE[mounting]]


def turned_deg(first: Floats, last: Floats, between: Floats, gain_deg: Floats) -> Floats:
    """Return small turn of the inner gimbal between two sets of table angles, degrees about its own axes.

    Args:
        first, last: table angles at both ends, (n, 3), degrees; their differences enter exactly.
        between: table angles (2, n, 3) at the two nodes that stand for the time between.
        gain_deg: rates at the second node minus those at the first, times the time between the ends, (n, 3).
    """
    outer, middle, inner = np.moveaxis(last - first, 1, 0)
    of_outer, of_middle, _ = np.moveaxis(gain_deg, 1, 0)
    _, about_y, about_x = np.moveaxis(np.deg2rad(between), 2, 0)
    cos_x, sin_x, cos_y, sin_y = np.cos(about_x), np.sin(about_x), np.cos(about_y), np.sin(about_y)
    x = inner - _shared(outer, of_outer, sin_y)
    y = _shared(middle, of_middle, cos_x) + _shared(outer, of_outer, cos_y * sin_x)
    z = _shared(outer, of_outer, cos_y * cos_x) - _shared(middle, of_middle, sin_x)
    return np.stack((x, y, z), axis=1)


def _shared(way_deg: Floats, gain_deg: Floats, share: Floats) -> Floats:
    """Return integral of a rate times its share (2, n) at the nodes: exactly the way where it does not change."""
    return way_deg * share.mean(axis=0) + gain_deg * (share[1] - share[0]) / 4.0
