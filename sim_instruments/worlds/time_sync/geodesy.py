"""From the tangent plane of the simulated flight to what a navigation unit tells: WGS-84 position, local level frame.

Frames: t, north-east-down at the origin of the flight (Cartesian, fixed to the Earth); e, Earth-centred Earth-fixed;
n, north-east-down where the vehicle is. Angles inside are radians.

Source: WGS 84 (NGA.STND.0036, section 3: semi-axis and flattening); H. Vermeille, "Direct transformation from
geocentric coordinates to geodetic coordinates", J. Geodesy 76 (2002), 451-454, equations (1) to (22).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats

SEMI_AXIS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
TURN_RAD = 2.0 * np.pi
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)


def to_earth(latitude_rad: Floats, longitude_rad: Floats, height_m: Floats) -> Floats:
    """Return Earth-centred coordinates (..., 3) in metre of geodetic ones (...)."""
    sine, cosine = np.sin(latitude_rad), np.cos(latitude_rad)
    across_m = SEMI_AXIS_M / np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    level_m = (across_m + height_m) * cosine
    polar_m = ((1.0 - ECCENTRICITY_2) * across_m + height_m) * sine
    return np.stack([level_m * np.cos(longitude_rad), level_m * np.sin(longitude_rad), polar_m], axis=-1)


def to_geodetic(earth_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return latitude and longitude (radian) and height (metre) of points (..., 3), not near the centre."""
    x, y, z = np.moveaxis(np.asarray(earth_m, float), -1, 0)
    e2, e4 = ECCENTRICITY_2, ECCENTRICITY_2**2
    p = (x**2 + y**2) / SEMI_AXIS_M**2
    q = (1.0 - e2) / SEMI_AXIS_M**2 * z**2
    r = (p + q - e4) / 6.0
    s = e4 * p * q / (4.0 * r**3)
    t = np.cbrt(1.0 + s + np.sqrt(s * (2.0 + s)))
    u = r * (1.0 + t + 1.0 / t)
    v = np.sqrt(u**2 + e4 * q)
    w = e2 * (u + v - q) / (2.0 * v)
    k = np.sqrt(u + v + w**2) - w
    level_m = k * np.hypot(x, y) / (k + e2)
    reach_m = np.hypot(level_m, z)
    height_m = (k + e2 - 1.0) / k * reach_m
    return 2.0 * np.arctan2(z, level_m + reach_m), np.arctan2(y, x), height_m


def level_axes(latitude_rad: Floats, longitude_rad: Floats) -> Floats:
    """Turn from the local level frame to the Earth's: columns are north, east and down, (..., 3, 3)."""
    latitude_rad, longitude_rad = np.broadcast_arrays(latitude_rad, longitude_rad)
    sl, cl, so, co = np.sin(latitude_rad), np.cos(latitude_rad), np.sin(longitude_rad), np.cos(longitude_rad)
    zero = np.zeros_like(sl)
    rows = [-sl * co, -so, -cl * co, -sl * so, co, -cl * so, cl, zero, -sl]
    return np.stack(rows, axis=-1).reshape(*sl.shape, 3, 3)


def euler_rad(turn: Floats) -> Floats:
    """Return roll, pitch, heading (..., 3) of turns from body to level (..., 3, 3), not at pitch 90 deg.

    Heading from 0 to below 2 pi.
    """
    roll = np.arctan2(turn[..., 2, 1], turn[..., 2, 2])
    pitch = np.arctan2(-turn[..., 2, 0], np.hypot(turn[..., 2, 1], turn[..., 2, 2]))
    heading = np.arctan2(turn[..., 1, 0], turn[..., 0, 0]) % TURN_RAD
    heading = np.where(heading < TURN_RAD, heading, 0.0)  # a rounding below north
    return np.stack([roll, pitch, heading], axis=-1)


@dataclass(frozen=True)
class Told:
    """Position, velocity and attitude as a navigation unit tells them, n samples.

    ``latitude_deg, longitude_deg, height_m`` (n,); ``velocity_m_s`` (n, 3) north, east, down where the vehicle is;
    ``attitude_deg`` (n, 3) roll, pitch, heading there.
    """

    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    velocity_m_s: Floats
    attitude_deg: Floats


@dataclass(frozen=True)
class TangentPlane:
    """The frame t of a flight: its origin, at height 0."""

    latitude_deg: float
    longitude_deg: float

    def told(self, position_m: Floats, velocity_m_s: Floats, turn: Floats) -> Told:
        """Return what a unit tells at a position with a velocity (n, 3), in t, its body turned by ``turn`` (n, 3, 3).

        Earth-fixed velocity, so that only its direction of axes changes.
        """
        latitude, longitude = np.radians(self.latitude_deg), np.radians(self.longitude_deg)
        axes = level_axes(latitude, longitude)  # t to e
        origin_m = to_earth(latitude, longitude, np.zeros(()))
        latitude, longitude, height_m = to_geodetic(origin_m + position_m @ axes.T)
        to_level = np.swapaxes(level_axes(latitude, longitude), -1, -2) @ axes  # t to n
        there = np.einsum("nij,nj->ni", to_level, velocity_m_s)
        attitude_deg = np.degrees(euler_rad(to_level @ turn))
        return Told(np.degrees(latitude), np.degrees(longitude), height_m, there, attitude_deg)
