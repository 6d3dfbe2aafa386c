"""Worlds of a GNC module's calibration in which something is not as the models have it; physics in numpy alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import imu_material as imu
import numpy as np
from doubt_classes import Switch

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


def wrong(**parts: Any) -> type[World]:
    """Return a world in which some parts are others; they take the world first, whose ``size`` they go by."""
    return type("Wrong", (World,), parts)


def tilted(w: World, pose_g: Any, record: int = 0) -> Any:
    return imu.turned(2, w.size) @ pose_g


def bumped(w: World, output_g: Any, force_g: Any, record: int) -> Any:
    late = np.arange(len(output_g)) > 0.6 * len(output_g)
    return output_g + w.size * (late * (record == 3))[:, None] * np.array([0.0, 1.0, 0.5])


def scale_changed(w: World, output: Any, _: Any, record: int) -> Any:
    """Between the sets: an impact, or another temperature."""
    return output * (1.0 + w.size * (record >= 6))


def bad_samples(w: World, kind: str, output: Any, record: int) -> Any:
    """One sample of a position and one of a turn, at rest and on the move."""
    odd = output.copy()
    if (kind, record) in (("accel", 2), ("gyro", 4)):
        odd[(500, 1) if kind == "accel" else (900, 0)] += w.size * (1.0 if kind == "accel" else 8.0)
    return odd


def hung(w: World, kind: str, output: Any, record: int) -> Any:
    """An axis holds what it showed in the record before, through some positions."""
    return output * [1.0, 0.0, 1.0] if kind == "accel" and 1 <= record <= w.size else output


def bad_reading(w: World, kind: str, output: Any, record: int) -> Any:
    odd = output.copy()
    odd[300, 0] += w.size if kind == "mag" and record in (0, 3) else 0.0
    return odd


def wandering(w: World, field: Any, record: int, rng: np.random.Generator) -> Any:
    """The field stays off by the same over 700 readings, then by another size."""
    off = np.repeat(rng.normal(0.0, w.size, (1 + len(field) // 700, 3)), 700, axis=0)
    return field + off[: len(field)]


def magnetised(w: World, output: Any, record: int) -> Any:
    """Between the turn and the attitudes."""
    return output + w.size * (record == 0) * np.array([1.0, 0.5, 0.0])


def steel(w: World, field: Any, record: int, rng: np.random.Generator) -> Any:
    """Magnetised along the field as it lies in the unit: an induced field of third order in the direction."""
    unit = field / FIELD_gauss
    return field + w.size * unit * (unit[:, :1] * unit[:, 1:2])


SWITCHES = (
    Switch("gravity_wrong", wrong(gravity_g=lambda w, up, _: up * (1.0 + w.size)), (1e-6, 1e-4, 1e-2), "local_gravity"),
    Switch(
        "table_turns_more", wrong(turned_deg=lambda w, deg, _: deg * (1.0 + w.size)), (1e-6, 1e-4, 1e-2), "table_angle"
    ),
    Switch("mounted_askew", wrong(gravity_g=tilted), (1e-4, 1e-2, 1.0), "mounting"),
    Switch(
        "one_turn_short", wrong(turned_deg=lambda w, deg, n: deg - w.size * (n == 2)), (1e-3, 0.1, 10.0), "table_angle"
    ),
    Switch(
        "one_pose_tilted", wrong(gravity_g=lambda w, up, n: up if n else tilted(w, up)), (1e-4, 2e-2, 2.0), "mounting"
    ),
    Switch(
        "upside_down", wrong(gravity_g=lambda w, up, n: -up if n < w.size else up), (1.0, 2.0, 12.0)
    ),  # the first poses are not what the records say
    Switch("even_order", wrong(accelerometer=lambda w, out, force, _: out + w.size * force**2), (1e-5, 3e-4, 1e-2)),
    Switch("bias_step", wrong(accelerometer=lambda w, out, _, n: out + w.size * (n > 2)), (1e-5, 3e-4, 1e-2)),
    Switch("bumped_at_rest", wrong(accelerometer=bumped), (1e-5, 1e-3, 1e-1)),
    Switch("gyro_asymmetry", wrong(gyro=lambda w, out, rate, _: out + w.size * abs(rate)), (1e-6, 1e-4, 1e-2)),
    Switch("gyro_bias_step", wrong(gyro=lambda w, out, _, n: out + w.size * (n in (1, 2, 5))), (1e-4, 1e-2, 1.0)),
    Switch("scale_changes", wrong(accelerometer=scale_changed, gyro=scale_changed), (1e-5, 3e-4, 1e-2)),
    Switch("bad_samples", wrong(read=bad_samples), (1e-2, 1.0, 30.0)),
    Switch("hung_axis", wrong(read=hung), (1.0, 2.0, 4.0)),
    Switch("bad_reading", wrong(read=bad_reading), (2e-3, 3e-2, 0.7)),
    Switch("field_wanders", wrong(field_gauss=wandering), (1e-5, 1e-4, 1e-3), "magnetic_surroundings"),
    # a tool is put down near the table before the last three attitudes
    Switch(
        "field_steps",
        wrong(field_gauss=lambda w, field, n, _: field + w.size * (n > 4) * field[0] / FIELD_gauss),
        (1e-5, 1e-3, 1e-1),
    ),
    Switch(
        "field_drifts",
        wrong(field_gauss=lambda w, field, n, _: field * (1.0 + w.size * n)),
        (1e-5, 1e-3, 1e-1),
        "magnetic_surroundings",
    ),
    Switch(
        "axis_saturates",
        wrong(magnetometer=lambda w, out, _: out - w.size * out**3 / FIELD_gauss**2),
        (1e-5, 1e-3, 1e-1),
    ),
    Switch("magnetised_between", wrong(magnetometer=magnetised), (1e-6, 1e-3, 1e-1)),
    Switch("steel_on_the_table", wrong(field_gauss=steel), (1e-5, 1e-3, 1e-1), "magnetic_surroundings"),
)
