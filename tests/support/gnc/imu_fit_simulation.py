"""Outputs of an inertial unit on a three-axis table, by formulas of its own: nothing of bench.systems computes here.

Angles of the table and their integrals are closed forms of a trapezoid; rotations come from scipy. One sample is the
mean over the interval that ends at its time stamp.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bench.systems.gnc.estimators.earth_rate import Pose, RotationRecord

EARTH_DEG_S = 15.041067 / 3600.0  # one turn in a sidereal day
CYCLE = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}
ARROWS = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}


@dataclass(frozen=True)
class Unit:
    """Sensitivity and bias of a triad: N = S (input + bias)."""

    sensitivity: np.ndarray
    bias: np.ndarray


def draw(rng: np.random.Generator, scale: float, cross: float, bias: float) -> Unit:
    """A unit with scale errors, asymmetric cross coupling and bias of these standard deviations."""
    matrix = np.eye(3) + rng.normal(size=(3, 3)) * cross
    matrix[range(3), range(3)] = 1.0 + rng.normal(size=3) * scale
    return Unit(matrix, rng.normal(size=3) * bias)


def turned_deg(time_s: np.ndarray, turn_deg: float, begin_s: float, length_s: float = 5.0) -> np.ndarray:
    """Angle of a trapezoid: ramps of a fifth of the time."""
    t, ramp = np.clip(time_s - begin_s, 0.0, length_s), 0.2 * length_s
    peak = turn_deg / (length_s - ramp)
    late = turn_deg - 0.5 * peak * (length_s - t) ** 2 / ramp
    early = 0.5 * peak * t**2 / ramp
    return np.where(t < ramp, early, np.where(t < length_s - ramp, peak * (t - 0.5 * ramp), late))


def local_rate_deg_s(latitude_deg: float) -> np.ndarray:
    """East, North, Up."""
    return EARTH_DEG_S * np.array([0.0, np.cos(np.radians(latitude_deg)), np.sin(np.radians(latitude_deg))])


def body_to_local(pose: Pose, azimuth_deg: float) -> Rotation:
    """Intrinsic turns: azimuth and outer about Up, then middle, then inner, then the mounting."""
    mounting = np.zeros((3, 3))
    mounting[range(3), CYCLE[pose.mounting]] = 1.0
    angles = [90.0 - azimuth_deg + pose.outer_deg, pose.middle_deg, pose.inner_deg]
    return Rotation.from_euler("ZYX", angles, degrees=True) * Rotation.from_matrix(mounting)


def rotation(
    unit: Unit,
    axis: str,
    turn_deg: float,
    rng: np.random.Generator,
    *,
    length_s: float = 15.3,
    rate_Hz: float = 200.0,
    walk_deg_sqrt_h: float = 0.3,
    resolution: float = 0.005,
    pose: Pose | None = None,
    turned: str = "inner",
    site: tuple[float, float] = (34.2, 90.0),
    tilt_deg: np.ndarray | None = None,
) -> RotationRecord:
    """One record; the table turns about a body axis, ``tilt_deg`` (3,) is by how much it misses it."""
    edges = np.arange(round(length_s * rate_Hz) + 1) / rate_Hz
    arrow = np.eye(3)["xyz".index(axis)]
    if tilt_deg is not None:
        arrow = Rotation.from_rotvec(tilt_deg, degrees=True).apply(arrow)
    angle = turned_deg(edges, turn_deg, 0.3)
    rate = np.diff(angle)[:, None] * rate_Hz * arrow
    if pose is not None:
        middle = turned_deg(edges[:-1] + 0.5 / rate_Hz, turn_deg, 0.3)
        first = body_to_local(pose, site[1]).inv().apply(local_rate_deg_s(site[0]))
        rate = rate + Rotation.from_rotvec(-middle[:, None] * arrow, degrees=True).apply(first)
    output = (rate + unit.bias) @ unit.sensitivity.T
    output = output + rng.normal(size=output.shape) * walk_deg_sqrt_h / 60.0 * np.sqrt(rate_Hz)
    if resolution:
        output = np.round(output / resolution) * resolution
    counter = np.arange(len(output))
    return RotationRecord(axis, turn_deg, counter, edges[1:], output, pose, turned)


MOUNTS = {"earth_axis": ("inner", Pose(90.0, -34.2)), "vertical": ("outer", Pose(0.0, -90.0))}


def rotations(unit: Unit, rng: np.random.Generator, mount: str | None = None, **more: object) -> list[RotationRecord]:
    """Six records. ``mount``: without it no Earth's rate; "earth_axis", "vertical" (34.2 N, azimuth 90)."""
    records = []
    for axis in "xyz":
        tilt = more.get("tilt_deg")
        each = dict(more) | {"tilt_deg": rng.normal(size=3) * float(str(tilt)) if tilt is not None else None}
        if mount is not None:
            turned, pose = MOUNTS[mount]
            each |= {"turned": turned, "pose": Pose(pose.outer_deg, pose.middle_deg, 0.0, axis)}
        records += [rotation(unit, axis, sign * 1080.0, rng, **each) for sign in (1.0, -1.0)]  # type: ignore[arg-type]
    return records


def positions(
    unit: Unit,
    rng: np.random.Generator,
    *,
    seconds: float = 60.0,
    rate_Hz: float = 200.0,
    walk_mg: float = 0.1,
    resolution: float = 1e-3,
    tilt_deg: float = 0.0,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Six poses: samples (m, 3) in g of each, and the forces asked for (6, 3). Noise walk_mg per root hertz."""
    forces, poses = np.array(list(ARROWS.values()), float), []
    for force in forces:
        true = Rotation.from_rotvec(rng.normal(size=3) * tilt_deg, degrees=True).apply(force)
        noise = rng.normal(size=(round(seconds * rate_Hz), 3)) * walk_mg * 1e-3 * np.sqrt(rate_Hz)
        poses.append(np.round(((true + unit.bias) @ unit.sensitivity.T + noise) / resolution) * resolution)
    return poses, forces
