"""The simulated magnetometer: Earth's field, the iron of the turntable, the sensor's own errors, and the roll angle
that the module's processor computes from it, paper 001 section 4.2 2).

The processor takes equations (7) to (9) with what (9) lacks: x is divided by cos alpha, after zero and gain. The angle
is that of a right-handed turn about z, from the position in which the field across z lies along +x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats, Integers
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import AxisMotion, Site, Tilt, angles_deg, in_body_axes, in_inner_axes
from sim_instruments.worlds.gnc.imu_errors import drawn

# The turntable's own iron: a part that stands still (local frame), and the magnet and the permeable steel of the
# inner gimbal, which turn with the unit and so cannot be told from the unit's own.
_STATOR_GAUSS = np.array([0.030, -0.020, 0.025])
_GIMBAL_GAUSS = np.array([0.040, -0.090, 0.060])
_GIMBAL_STEEL = np.array([[0.010, 0.004, 0.0], [0.004, -0.030, 0.012], [0.0, 0.012, 0.025]])
LOWEST, HIGHEST = -32_768, 32_767


@dataclass(frozen=True)
class EarthField:
    """Earth's magnetic field: gauss, degrees below the horizon, degrees east of true North."""

    gauss: float = 0.43
    inclination_deg: float = 55.0
    declination_deg: float = -4.0

    @property
    def local_gauss(self) -> Floats:
        """Its components East, North, Up."""
        dip, east = np.deg2rad((self.inclination_deg, self.declination_deg))
        return self.gauss * np.array([np.cos(dip) * np.sin(east), np.cos(dip) * np.cos(east), -np.sin(dip)])


@dataclass(frozen=True)
class InPlane:
    """Ellipse that a rotation of the body about z shows of the sensors x and y (paper 001, equations (5) to (9)).

    Attributes:
        offset_gauss: centre of the ellipse, (2,).
        gain: K_y, what y is multiplied with to reach the sensitivity of x.
        angle_deg: alpha of x = (x_out - y sin alpha) / cos alpha, after offset and gain.
        radius_gauss: size of the circle that is left, in the sensitivity of x.
        roll_deg: error of the roll angle atan2(-y, x) of the corrected components (soft iron; no ellipse tells it).
    """

    offset_gauss: Floats
    gain: float
    angle_deg: float
    radius_gauss: float
    roll_deg: float


class Magnetometer:
    """Sensor of one module: indicated = A field + offset, gauss, body axes.

    Args: seed of the run, serial number; ``errors`` off makes an ideal sensor.
    Attributes:
        matrix: A, (3, 3), soft iron times non-orthogonality times gain.   offset_gauss: hard iron and zero, (3,).
    """

    def __init__(self, seed: int, serial: str, *, errors: bool = True) -> None:
        rng = generator(seed, f"gnc magnetometer {serial}")
        gains = np.diag(1.0 + drawn(rng, 0.03, 3))
        alpha, beta, gamma = np.deg2rad(rng.choice((-1.0, 1.0), 3) * rng.uniform(1.0, 2.0, 3))
        axes = np.array(
            [[np.cos(alpha), np.sin(alpha), 0.0], [0.0, 1.0, 0.0], [np.sin(beta), np.sin(gamma), np.cos(beta)]]
        )
        iron = drawn(rng, 0.003, (3, 3))
        soft = np.eye(3) + (iron + iron.T) / 2.0
        self.matrix = gains @ axes @ soft if errors else np.eye(3)
        self.offset_gauss = drawn(rng, 0.1, 3) * errors

    def indicated_gauss(self, field_gauss: Floats) -> Floats:
        """Return what it shows of a field in body axes (n, 3), without noise, gauss."""
        return field_gauss @ self.matrix.T + self.offset_gauss

    def in_plane(self, across_z_gauss: float, along_z_gauss: float) -> InPlane:
        """Return ellipse of x and y when the body turns about z in a field with these components across and along z."""
        sensor_x, sensor_y = self.matrix[:2, :2]
        sizes = np.hypot(*sensor_x), np.hypot(*sensor_y)
        return InPlane(
            offset_gauss=self.offset_gauss[:2] + self.matrix[:2, 2] * along_z_gauss,
            gain=float(sizes[0] / sizes[1]),
            angle_deg=float(np.rad2deg(np.arcsin(sensor_x @ sensor_y / (sizes[0] * sizes[1])))),
            radius_gauss=float(sizes[0] * across_z_gauss),
            roll_deg=-float(np.rad2deg(np.arctan2(sensor_y[0], sensor_y[1]))),
        )


def field_gauss(
    motion: Sequence[AxisMotion],
    table: str,
    site: Site,
    earth: EarthField,
    tilt: Tilt | None,
    t_ns: Integers,
    mounting: str,
) -> Floats:
    """Return magnetic field at the module in body axes at times (n,), (n, 3), gauss; ``table``: see Surroundings."""
    angles = angles_deg(motion, t_ns)
    on_turntable = table == "turntable"
    local = earth.local_gauss + _STATOR_GAUSS * on_turntable
    field = in_inner_axes(local, angles, site)
    if on_turntable:
        field = field @ (np.eye(3) + _GIMBAL_STEEL).T + _GIMBAL_GAUSS
    return in_body_axes(field, mounting, None if tilt is None else tilt.rad(angles))


@dataclass(frozen=True)
class Correction:
    """Zero by axis in counts, gain of y against x, sine of the angle by which the axes are not square."""

    offset: tuple[int, int, int] = (0, 0, 0)
    gain: float = 1.0
    sin_alpha: float = 0.0

    def roll(self, counts: Sequence[int]) -> tuple[float, tuple[int, int, int]]:
        """Roll angle in degrees, -180 to 180, and the corrected field in counts."""
        x_out, y_out, z = (int(value) - zero for value, zero in zip(counts, self.offset, strict=True))
        y = y_out * self.gain
        x = (x_out - y * self.sin_alpha) / math.sqrt(1.0 - self.sin_alpha**2)
        return math.degrees(math.atan2(-y, x)), (_count(x), _count(y), _count(z))


def _count(value: float) -> int:
    return min(max(round(value), LOWEST), HIGHEST)
