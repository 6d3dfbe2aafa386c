"""Worlds of a GNC module's calibration in which something is not as the models have it; physics in numpy alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import imu_material as imu
import numpy as np

FIELD_gauss = 0.45


@dataclass(frozen=True)
class World:
    """The right world; a wrong one changes one of its parts. Positions, turns and fields are counted from 0 each."""

    size: float = 0.0

    def gravity_g(self, pose_g: Any, record: int) -> Any:
        """Specific force (3,) of a position, g, body axes."""
        return pose_g

    def turned_deg(self, turn_deg: float, record: int) -> float:
        """Return by how much the table really turns."""
        return turn_deg

    def accelerometer(self, output_g: Any, force_g: Any, record: int) -> Any:
        """Output (n, 3) without noise."""
        return output_g

    def gyro(self, output_deg_s: Any, rate_deg_s: Any, record: int) -> Any:
        """Output (n, 3) without noise."""
        return output_deg_s

    def field_gauss(self, field_gauss: Any, record: int, rng: np.random.Generator) -> Any:
        """Return the field in body axes, (n, 3); record 0 is the turn."""
        return field_gauss

    def magnetometer(self, output_gauss: Any, record: int) -> Any:
        """Output (n, 3) without noise."""
        return output_gauss

    def read(self, kind: str, output: Any, record: int) -> Any:
        """Readings with noise, (n, 3)."""
        return output


class GravityWrong(World):
    def gravity_g(self, pose_g: Any, record: int) -> Any:
        return pose_g * (1.0 + self.size)


class TableTurnsMore(World):
    def turned_deg(self, turn_deg: float, record: int) -> float:
        return turn_deg * (1.0 + self.size)


class OneTurnShort(World):
    def turned_deg(self, turn_deg: float, record: int) -> float:
        return turn_deg - self.size if record == 2 else turn_deg


class MountedAskew(World):
    def gravity_g(self, pose_g: Any, record: int) -> Any:
        return imu.turned(2, self.size) @ pose_g


class OnePoseTilted(World):
    def gravity_g(self, pose_g: Any, record: int) -> Any:
        return imu.turned(2, self.size) @ pose_g if record == 0 else pose_g


class UpsideDown(World):
    """The first poses are not what the records say."""

    def gravity_g(self, pose_g: Any, record: int) -> Any:
        return -pose_g if record < self.size else pose_g


class EvenOrder(World):
    def accelerometer(self, output_g: Any, force_g: Any, record: int) -> Any:
        return output_g + self.size * force_g**2


class BiasStep(World):
    def accelerometer(self, output_g: Any, force_g: Any, record: int) -> Any:
        return output_g + self.size * (record > 2)


class BumpedAtRest(World):
    def accelerometer(self, output_g: Any, force_g: Any, record: int) -> Any:
        half = np.arange(len(output_g)) > 0.6 * len(output_g)
        return output_g + self.size * (half * (record == 3))[:, None] * np.array([0.0, 1.0, 0.5])


class GyroAsymmetry(World):
    def gyro(self, output_deg_s: Any, rate_deg_s: Any, record: int) -> Any:
        return output_deg_s + self.size * np.abs(rate_deg_s)


class GyroBiasStep(World):
    def gyro(self, output_deg_s: Any, rate_deg_s: Any, record: int) -> Any:
        return output_deg_s + self.size * (record in (1, 2, 5))


class ScaleChanges(World):
    """Between the sets: an impact, or another temperature."""

    def accelerometer(self, output_g: Any, force_g: Any, record: int) -> Any:
        return output_g * (1.0 + self.size * (record >= 6))

    def gyro(self, output_deg_s: Any, rate_deg_s: Any, record: int) -> Any:
        return output_deg_s * (1.0 + self.size * (record >= 6))


class BadSamples(World):
    """One sample of a position and one of a turn, at rest and on the move."""

    def read(self, kind: str, output: Any, record: int) -> Any:
        odd = output.copy()
        if kind == "accel" and record == 2:
            odd[500, 1] += self.size
        if kind == "gyro" and record == 4:
            odd[900, 0] += 8.0 * self.size
        return odd


class HungAxis(World):
    """An axis holds what it showed in the record before, through some positions."""

    def read(self, kind: str, output: Any, record: int) -> Any:
        held = output.copy()
        if kind == "accel" and 1 <= record <= self.size:
            held[:, 1] = 0.0
        return held


class BadReading(World):
    def read(self, kind: str, output: Any, record: int) -> Any:
        odd = output.copy()
        if kind == "mag" and record in (0, 3):
            odd[300, 0] += self.size
        return odd


class FieldWanders(World):
    """The field stays off by the same over 700 readings, then by another size."""

    def field_gauss(self, field_gauss: Any, record: int, rng: np.random.Generator) -> Any:
        off = np.repeat(rng.normal(0.0, self.size, (1 + len(field_gauss) // 700, 3)), 700, axis=0)
        return field_gauss + off[: len(field_gauss)]


class FieldSteps(World):
    """A tool is put down near the table before the last three attitudes."""

    def field_gauss(self, field_gauss: Any, record: int, rng: np.random.Generator) -> Any:
        return field_gauss + self.size * (record > 4) * field_gauss[0] / FIELD_gauss


class FieldDrifts(World):
    def field_gauss(self, field_gauss: Any, record: int, rng: np.random.Generator) -> Any:
        return field_gauss * (1.0 + self.size * record)


class AxisSaturates(World):
    def magnetometer(self, output_gauss: Any, record: int) -> Any:
        return output_gauss - self.size * output_gauss**3 / FIELD_gauss**2


class MagnetisedBetween(World):
    """The unit is magnetised between the turn and the attitudes."""

    def magnetometer(self, output_gauss: Any, record: int) -> Any:
        return output_gauss + self.size * (record == 0) * np.array([1.0, 0.5, 0.0])


class SteelOnTheTable(World):
    """Magnetised along the field as it lies in the unit: an induced field of third order in the direction."""

    def field_gauss(self, field_gauss: Any, record: int, rng: np.random.Generator) -> Any:
        unit = field_gauss / FIELD_gauss
        return field_gauss + self.size * unit * (unit[:, :1] * unit[:, 1:2])
