"""Strapdown integration of the increments of an inertial unit, for many lanes at once.

Attitude by the rotation vector with coning from the increment before, velocity with the rotation within the interval
and sculling, position by the trapezoid rule; the navigation frame is a local tangent plane that turns with the Earth.

Arrays have the axes of space first and the lanes last: a step then is a few dozen long vector operations. Every
operation acts on each lane by itself, by products and sums alone, so that a lane gives the same bits in any company.

Source: Savage, Strapdown inertial navigation integration algorithm design, JGCD 21(1) 1998 part 1 (rotation vector =
increment + coning, coning = 1/12 of the product of the increments before and now) and JGCD 21(2) 1998 part 2 (velocity
= increment + rotation compensation in its exact form + sculling, 1/12 of the mixed products).

Gravity and Earth rate in a local tangent plane, north-east-down, fixed to the Earth.

Source: WGS-84 (NIMA TR8350.2, 3rd edition, table 3.4 and equation 4-1): normal gravity on the ellipsoid by Somigliana's
formula; its gradient about the origin as that of a point mass, -1/R level and 2/R vertical.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats

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


def gradient(latitude_deg: float) -> Floats:
    """Return diagonal of the gravity gradient (north, east, down), 1/s^2: change of gravity per metre of position."""
    return normal_gravity(latitude_deg) / EARTH_RADIUS_m * np.array([-1.0, -1.0, 2.0])


def earth_rate(latitude_deg: float) -> Floats:
    """Return rate of the Earth in t, (3,), rad/s."""
    angle = np.deg2rad(latitude_deg)
    return EARTH_RATE_rad_s * np.array([np.cos(angle), 0.0, -np.sin(angle)])


def _around(vector: Floats) -> Floats:
    """Return a vector (3, ...) as ``_cross`` wants it: (5, ...), rows 3 and 4 repeat rows 0 and 1."""
    return np.concatenate((vector, vector[:2]))


def _cross(a: Floats, b: Floats) -> Floats:
    """Return a x b, (3, ...), of (5, ...) vectors, in a tenth of the time of np.cross."""
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]


def small_rotation(vector: Floats) -> Floats:
    """Return exp([vector x]) for angles below 0.1 rad, by its series.

    Args:    vector: (3, ...) rad.
    Returns: (3, 3, ...).
    """
    square = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
    sine, versine = _series(square)
    out = vector[:, None] * vector[None, :] * versine
    for i in range(3):
        out[i, i] += 1.0 - versine * square
        j, k = (i + 1) % 3, (i + 2) % 3
        out[k, j] += sine * vector[i]
        out[j, k] -= sine * vector[i]
    return out


def _series(square: Floats) -> tuple[Floats, Floats]:
    """Return sin(x)/x and (1 - cos(x))/x^2 from x^2."""
    sine = 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square / 5040.0))
    versine = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40320.0))
    return sine, versine


class Strapdown:
    """Position, velocity and attitude of lanes of any shape, stepped by increments.

    Attributes: p (3, *lanes) m, v (3, *lanes) m/s in t, C (3, 3, *lanes) body to t, all three views of state
                (15, *lanes); bias_v m/s^2 and bias_theta rad/s (3, *lanes) are taken from the increments; specific
                (3, *lanes) m/s: sum of the increments of velocity in t since it was last set to zero.
    """

    def __init__(self, lanes: tuple[int, ...], latitude_deg: float, interval_s: float) -> None:
        self.state = np.zeros((15, *lanes))
        self.p, self.v, self.C = self.state[:3], self.state[3:6], self.state[6:].reshape(3, 3, *lanes)
        self.specific, self.bias_v, self.bias_theta = (np.zeros((3, *lanes)) for _ in range(3))
        ones = (1,) * len(lanes)
        self._rate = earth_rate(latitude_deg)
        self._gradient = gradient(latitude_deg).reshape(3, *ones)
        self._gravity = np.array([0.0, 0.0, normal_gravity(latitude_deg)]).reshape(3, *ones)
        self._earth = small_rotation(-self._rate * interval_s).reshape(3, 3, 1, *ones)
        self._coriolis = np.cross(self._rate, np.eye(3)).reshape(3, 3, *ones)  # rows: minus [rate x]
        self._before: tuple[Floats, Floats] | None = None  # increments of angle and velocity

    def step(self, dv: Floats, dtheta: Floats, dt: float) -> None:
        """Go on by one interval.

        Args: dv m/s, dtheta rad: (3, *lanes) or what broadcasts to it, body.   dt: s.
        """
        theta, dv = _around(dtheta - self.bias_theta * dt), _around(dv - self.bias_v * dt)
        theta_before, dv_before = self._before or (theta, dv)  # none before: as if it had been the same, no coning
        self._before = theta, dv
        phi = _around(theta[:3] + _cross(theta_before, theta) * (1.0 / 12.0))
        sculling = (_cross(theta_before, dv) + _cross(dv_before, theta)) * (1.0 / 12.0)
        bent = _cross(phi, dv)
        self._move(sculling + dv[:3] + bent * 0.5 + _cross(phi, _around(bent)) * (1.0 / 6.0), dt)
        self._turn(phi)

    def _move(self, dv: Floats, dt: float) -> None:
        """Take in a velocity increment in the body as it was at the begin of the interval."""
        increment = np.add.reduce(self.C * dv, axis=1)
        self.specific += increment
        gravity = ((self.v * (0.5 * dt) + self.p) * self._gradient + self._gravity) * dt  # in the middle
        # Coriolis of the velocity in the middle, 2 rate x (v + (increment + gravity)/2), and half of the turn of t
        # within the interval on the increment: rate x (2 v + 1.5 increment + gravity)
        turning = self.v * 2.0 + gravity + increment * 1.5
        change = gravity + increment + np.add.reduce(self._coriolis * turning, axis=1) * dt
        self.p += (change * 0.5 + self.v) * dt
        self.v += change

    def _turn(self, phi: Floats) -> None:
        """C exp([phi x]) by the products of the rows with phi, then the turn of the Earth."""
        sine, versine = _series(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
        rows, phi = self.C.swapaxes(0, 1), phi[:, None]  # the rows of C as vectors side by side
        first = _cross(_around(rows), phi)
        rows += first * sine
        rows += _cross(_around(first), phi) * versine
        np.add.reduce(self._earth * self.C, axis=1, out=self.C)


@dataclass(frozen=True)
class Track:
    """Solution at the end of every interval: ``t_s`` (n,), ``p`` m and ``v`` m/s in t, (n, 3) or (n, R, 3), ``C`` body
    to t, (n, 3, 3) or (n, R, 3, 3).
    """

    t_s: Floats
    p: Floats
    v: Floats
    C: Floats


def navigate(
    t_s: Floats,
    dv: Floats,
    dtheta: Floats,
    p0: Floats,
    v0: Floats,
    C0: Floats,
    latitude_deg: float,
    begin_s: float | None = None,
) -> Track:
    """Integrate increments without any aiding.

    Args:    t_s: (n,) ends of the intervals.   dv m/s, dtheta rad: (n, 3) or (n, R, 3), body.   p0 m, v0 m/s: (3,) or
             (R, 3) at the begin, C0 (3, 3) or (R, 3, 3) body to t.   begin_s: begin of the first interval; None takes
             it one median interval before the first end.
    Returns: Track.
    Source:  see the head of this file.
    """
    lanes = dv.shape[1:-1]
    steps = np.diff(t_s, prepend=np.nan)
    nominal = float(np.nanmedian(steps))
    steps[0] = nominal if begin_s is None else t_s[0] - begin_s
    ins = Strapdown(lanes, latitude_deg, nominal)
    ins.p[...] = np.moveaxis(np.broadcast_to(p0, (*lanes, 3)), -1, 0)
    ins.v[...] = np.moveaxis(np.broadcast_to(v0, (*lanes, 3)), -1, 0)
    ins.C[...] = np.moveaxis(np.broadcast_to(C0, (*lanes, 3, 3)), (-2, -1), (0, 1))
    p, v, C = np.empty(dv.shape), np.empty(dv.shape), np.empty((*dv.shape, 3))
    rows_p, rows_v, rows_dv, rows_dtheta = (np.moveaxis(x, -1, 1) for x in (p, v, dv, dtheta))
    rows_C = np.moveaxis(C, (-2, -1), (1, 2))
    for k, dt in enumerate(steps.tolist()):
        ins.step(rows_dv[k], rows_dtheta[k], dt)
        rows_p[k], rows_v[k], rows_C[k] = ins.p, ins.v, ins.C
    return Track(t_s, p, v, C)
