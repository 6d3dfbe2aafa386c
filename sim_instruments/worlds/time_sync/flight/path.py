"""Paths of a simulated vehicle as exact functions of time, and the Earth it flies over.

Pieces of constant acceleration along track and yaw rate, flat, in a tangent plane (north, east, down). The body points
along the velocity: x forward, y right, z down; a right turn is a positive yaw rate. There is no bank, so a turn is a
specific force to the right. The plane is fixed to the Earth at the origin, height 0: there is no transport rate, and
the Earth's rate is constant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats

LATITUDE_DEG = 37.5
EARTH_RATE_RAD_S = 7.292115e-5
RADIUS_M = 6_371_000.0
STANDARD_GRAVITY_M_S2 = 9.80665  # what a "g" means in a sensor's specification
# WGS-84: NIMA TR8350.2, third edition (2000), tables 3.1 to 3.4
_EQUATOR_M_S2 = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_ECCENTRICITY_2 = 0.00669437999013
# Columns of the table of pieces: begin s, acceleration m/s2, yaw rate rad/s; north m, east m, speed m/s, yaw rad at the
# begin
_BEGIN = 0


def normal_gravity_m_s2(latitude_deg: float) -> float:
    """Return normal gravity on the ellipsoid, m/s2. Source: Somigliana's formula, NIMA TR8350.2 eq. (4-1)."""
    sine_2 = math.sin(math.radians(latitude_deg)) ** 2
    return _EQUATOR_M_S2 * (1.0 + _SOMIGLIANA * sine_2) / math.sqrt(1.0 - _ECCENTRICITY_2 * sine_2)


def earth_rate_rad_s(latitude_deg: float) -> Floats:
    """Return rate of the Earth against inertial space, (north, east, down), rad/s."""
    latitude = math.radians(latitude_deg)
    return EARTH_RATE_RAD_S * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])


def gravity_gradient_s2(latitude_deg: float) -> Floats:
    """Return diagonal of the gradient of gravity about the origin, that of a point mass, (3,), 1/s2."""
    return normal_gravity_m_s2(latitude_deg) / RADIUS_M * np.array([-1.0, -1.0, 2.0])


def gravity_m_s2(position_m: Floats, latitude_deg: float) -> Floats:
    """Return gravity at positions (..., 3) north, east, down of the origin, to first order in them; (..., 3), m/s2."""
    gravity = position_m * gravity_gradient_s2(latitude_deg)
    gravity[..., 2] += normal_gravity_m_s2(latitude_deg)
    return gravity


@dataclass(frozen=True)
class PathState:
    """True motion at n times. At a border of two pieces acceleration and yaw rate are those of the later one.

    ``p`` (n, 3): position, m.   ``v`` (n, 3): velocity, m/s.   ``a`` (n, 3): its derivative, m/s2.
    ``yaw`` (n,): rad, not wrapped.   ``yaw_rate`` (n,): rad/s.
    """

    p: Floats
    v: Floats
    yaw: Floats
    a: Floats
    yaw_rate: Floats


class FlightPath:
    """Path of pieces in closed form; position and velocity are continuous at their borders.

    Args:
        pieces: (begin s, acceleration along track m/s2, yaw rate deg/s) in order of time; the last goes on for ever.
            Before the first the vehicle goes straight on at the first speed.
        speed_m_s, heading_deg: at the begin of the first piece, where the vehicle is above the origin.
        down_m: constant; negative is above the plane.
    """

    def __init__(
        self,
        pieces: Sequence[tuple[float, float, float]],
        speed_m_s: float = 0.0,
        heading_deg: float = 0.0,
        down_m: float = -3000.0,
    ) -> None:
        self._down_m = down_m
        self._table = np.zeros((max(16, len(pieces) + 1), 7))
        self._table[0] = (pieces[0][0], 0.0, 0.0, 0.0, 0.0, speed_m_s, np.radians(heading_deg))
        self._count = 1  # row 0 is the time before the first piece
        for piece in pieces:
            self.add(*piece)

    def add(self, begin_s: float, acceleration_m_s2: float, yaw_rate_deg_s: float) -> None:
        """Go on differently from ``begin_s`` on; whatever was planned for then or later is forgotten.

        Raises: ValueError if that is before the first piece.
        """
        if begin_s < self._table[0, _BEGIN]:
            raise ValueError(f"a piece from {begin_s} s is before the path, which begins at {self._table[0, _BEGIN]} s")
        while self._count > 1 and self._table[self._count - 1, _BEGIN] >= begin_s:
            self._count -= 1
        state = [float(value[0]) for value in self._motion(np.array([begin_s]))[0]]
        if self._count == self._table.shape[0]:
            self._table = np.concatenate((self._table, np.zeros_like(self._table)))
        self._table[self._count] = (begin_s, acceleration_m_s2, np.radians(yaw_rate_deg_s), *state)
        self._count += 1

    def borders_s(self, first_s: float, last_s: float) -> Floats:
        """Return begins of pieces strictly between two times."""
        begins = self._table[1 : self._count, _BEGIN]
        return begins[(begins > first_s) & (begins < last_s)]

    def state(self, t_s: Floats) -> PathState:
        """Return motion at times (n,) of any order, s."""
        t_s = np.asarray(t_s, float)
        (north, east, speed, yaw), along, rate = self._motion(t_s)
        cosine, sine, across = np.cos(yaw), np.sin(yaw), speed * rate
        p, v, a = np.empty((t_s.size, 3)), np.zeros((t_s.size, 3)), np.zeros((t_s.size, 3))
        p[:, 0], p[:, 1], p[:, 2] = north, east, self._down_m
        v[:, 0], v[:, 1] = speed * cosine, speed * sine
        a[:, 0], a[:, 1] = along * cosine - across * sine, along * sine + across * cosine
        return PathState(p, v, yaw, a, rate)

    def _motion(self, t_s: Floats) -> tuple[tuple[Floats, Floats, Floats, Floats], Floats, Floats]:
        """Return (North, east, speed, yaw), acceleration along track and yaw rate at times (n,).

        The displacement since a piece began is the integral of (v0 + a t) exp(i (yaw0 + w t)). Taken about the middle
        of that time T it is T exp(i (yaw0 + x)) (mean speed j0(x) + i a T / 2 j1(x)) with x = w T / 2 and the spherical
        Bessel functions j0 and j1: no special case for w = 0.
        """
        piece = self._table[np.searchsorted(self._table[1 : self._count, _BEGIN], t_s, side="right")]
        begin_s, along, rate, north, east, speed, yaw = piece.T
        since_s = t_s - begin_s
        gained, half = along * since_s, 0.5 * rate * since_s
        bessel_0, bessel_1 = _bessel(half)
        forward = since_s * (speed + 0.5 * gained) * bessel_0
        right = 0.5 * since_s * gained * bessel_1
        cosine, sine = np.cos(yaw + half), np.sin(yaw + half)
        north = north + (forward * cosine - right * sine)
        east = east + (forward * sine + right * cosine)
        return (north, east, speed + gained, yaw + 2.0 * half), along, rate


def _bessel(x: Floats) -> tuple[Floats, Floats]:
    """Return sin x / x and (sin x - x cos x) / x2; by their series near 0, where the second loses its digits."""
    if not x.any():
        return np.ones_like(x), x
    square = x * x
    zero = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    one = x / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0 * (1.0 - square / 54.0 * (1.0 - square / 88.0))))
    far = square > 0.01
    if far.any():
        large = x[far]
        zero[far] = np.sin(large) / large
        one[far] = (zero[far] - np.cos(large)) / large
    return zero, one


# Table 4 and Fig. 2 of the paper: speed m/s, pieces
MANOEUVRES = {
    "stationary": (0.0, ((0.0, 0.0, 0.0),)),
    "linear": (100.0, ((0.0, 0.0, 0.0),)),
    "acceleration": (100.0, ((0.0, 0.0, 0.0), (20.0, 5.0, 0.0), (40.0, 0.0, 0.0))),
    "turn": (100.0, ((0.0, 0.0, 0.0), (20.0, 0.0, 4.5), (40.0, 0.0, 0.0))),
    "sar": (100.0, ((0.0, 0.0, 0.0), (20.0, 15.0, 0.0), (30.0, 0.0, 0.0), (50.0, 0.0, 9.0), (60.0, 0.0, 0.0))),
}


def manoeuvre(name: str) -> FlightPath:
    """Return a new path, which may be extended, of one of ``MANOEUVRES``."""
    speed_m_s, pieces = MANOEUVRES[name]
    return FlightPath(pieces, speed_m_s)
