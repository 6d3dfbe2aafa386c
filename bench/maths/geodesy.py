"""Positions and attitudes on the ellipsoid in the Cartesian frame that touches it at one point.

A navigation solution says where a vehicle is by latitude, longitude and height, and how it moves and lies by the level
frame (north, east, down) where it is. That frame turns as the vehicle moves; a filter without transport rate needs one
that does not. The tangent frame has its axes north, east and down at its origin, which lies on the ellipsoid.

Source: WGS 84 by NIMA TR8350.2 (2000), table 3.1; EPSG Guidance Note 7-2 (2019), sections 4.1.1 (geographic to
geocentric) and 4.1.3 (geographic to topocentric).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats

SEMI_MAJOR_m = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)


def geocentric_m(latitude_deg: Floats, longitude_deg: Floats, height_m: Floats) -> Floats:
    """Return Earth-fixed Cartesian coordinates.

    Args:    latitude_deg, longitude_deg: geodetic, (n,).   height_m: above the ellipsoid, (n,).
    Returns: (n, 3), metre; x to longitude zero on the equator, z north along the Earth's axis.
    Raises:  nothing.
    Source:  EPSG Guidance Note 7-2 section 4.1.1.
    """
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    normal_m = SEMI_MAJOR_m / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(latitude) ** 2)
    out_m = (normal_m + height_m) * np.cos(latitude)
    up_m = (normal_m * (1.0 - _ECCENTRICITY2) + height_m) * np.sin(latitude)
    return np.stack([out_m * np.cos(longitude), out_m * np.sin(longitude), up_m], axis=-1)


def level_axes(latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    """Return north, east and down where the ellipsoid has this latitude and longitude.

    Args:    latitude_deg, longitude_deg: geodetic, (n,).
    Returns: (n, 3, 3): its rows are the three unit vectors in Earth-fixed axes.
    Raises:  nothing.
    Source:  Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, equation (2.150).
    """
    latitude, longitude = np.broadcast_arrays(np.radians(latitude_deg), np.radians(longitude_deg))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sin_lat)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    east = np.stack([-sin_lon, cos_lon, zero], axis=-1)
    down = np.stack([-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat], axis=-1)
    return np.stack([north, east, down], axis=-2)


def body_to_level(roll_deg: Floats, pitch_deg: Floats, heading_deg: Floats) -> Floats:
    """Return direction cosines of a vehicle (forward, right, down) in its level frame (north, east, down).

    Args:    roll_deg, pitch_deg, heading_deg: (n,); turned in the order heading, pitch, roll.
    Returns: (n, 3, 3) that takes a vector from the body to the level frame.
    Raises:  nothing.
    Source:  Groves, equation (2.24).
    """
    roll, pitch, heading = np.radians(roll_deg), np.radians(pitch_deg), np.radians(heading_deg)
    sr, cr, sp, cp, sh, ch = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch), np.sin(heading), np.cos(heading)
    rows = [
        [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
        [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def heading_matrices(heading_rad: Floats) -> Floats:
    """Return what takes a vector from the body (forward, right, down) of level vehicles to north, east, down.

    Args:    heading_rad: (n,).
    Returns: (n, 3, 3).
    """
    turn = np.zeros((heading_rad.size, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(heading_rad)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(heading_rad), -np.sin(heading_rad), 1.0
    return turn


@dataclass(frozen=True)
class TangentFrame:
    """North, east, down at a point of the ellipsoid (height zero), which is its origin."""

    latitude_deg: float
    longitude_deg: float

    def positions_m(self, latitude_deg: Floats, longitude_deg: Floats, height_m: Floats) -> Floats:
        """Return positions in this frame.

        Args:    as ``geocentric_m``, (n,) each.
        Returns: (n, 3), metre.
        Raises:  nothing.
        Source:  EPSG Guidance Note 7-2 section 4.1.3, axes in the order north, east, down.
        """
        return (geocentric_m(latitude_deg, longitude_deg, height_m) - self._origin_m) @ self._axes.T

    def heights_m(self, positions_m: Floats) -> Floats:
        """Return heights above the ellipsoid of positions in this frame, which leaves the ground as it goes.

        Args:    positions_m: (n, 3), north, east, down.
        Returns: (n,), metre; to a micrometre up to 100 km.
        Raises:  nothing.
        Source:  Bowring, Survey Review 23 (1976), 323-327: one step of the latitude.
        """
        x_m, y_m, z_m = (self._origin_m + positions_m @ self._axes).T
        out_m, minor_m = np.hypot(x_m, y_m), SEMI_MAJOR_m * (1.0 - FLATTENING)
        reduced = np.arctan2(SEMI_MAJOR_m * z_m, minor_m * out_m)
        second = _ECCENTRICITY2 / (1.0 - _ECCENTRICITY2)
        latitude = np.arctan2(
            z_m + second * minor_m * np.sin(reduced) ** 3,
            out_m - _ECCENTRICITY2 * SEMI_MAJOR_m * np.cos(reduced) ** 3,
        )
        sine = np.sin(latitude)
        down_m = SEMI_MAJOR_m * np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
        return np.asarray(out_m * np.cos(latitude) + z_m * sine - down_m)

    def from_level(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Return what takes a vector from the level frame of a vehicle to this one.

        Args:    latitude_deg, longitude_deg: of the vehicle, (n,).
        Returns: (n, 3, 3).
        Raises:  nothing.
        Source:  product of two ``level_axes``.
        """
        return self._axes @ np.swapaxes(level_axes(latitude_deg, longitude_deg), -1, -2)

    @property
    def _origin_m(self) -> Floats:
        return geocentric_m(*(np.array([coordinate]) for coordinate in (self.latitude_deg, self.longitude_deg, 0.0)))

    @property
    def _axes(self) -> Floats:
        return level_axes(np.array(self.latitude_deg), np.array(self.longitude_deg))
