"""Records of a simulated inertial unit for tests of the analyses: attitude by numpy alone, white noise, a few errors.

Nothing here comes from bench.fit. Sensor form N = S (input + b) for gyros, N = S f + b for accelerometers, in LSB.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.analysis import Material
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow, Samples

RATE_Hz = 200.0
SITE = {"latitude_deg": 37.5, "gravity_m_s2": 9.7969, "azimuth_deg": 70.0}
IMU = {
    "gyro_range_deg_s": 400.0, "gyro_resolution_deg_s": 0.005, "accel_range_g": 50.0, "accel_resolution_g": 1e-3,
    "mag_range_gauss": 6.0, "mag_resolution_gauss": 120e-6,
}  # fmt: skip
SCALES = {
    "gyro": (0.005, 0.0, "deg/s"), "accel": (1e-3, 0.0, "g"), "mag": (120e-6, 0.0, "gauss"),
    "temperature": (0.01, 0.0, "degC"), "tick": (1.0, 0.0, "us"),
}  # fmt: skip
EARTH_DEG_S = np.rad2deg(7.292115e-5)
POSES = {  # mounting x: outer, middle, inner
    "+x": (0.0, -90.0, 0.0), "-x": (0.0, 90.0, 0.0), "+y": (0.0, 0.0, 90.0), "-y": (0.0, 0.0, -90.0),
    "+z": (0.0, 0.0, 0.0), "-z": (0.0, 0.0, 180.0),
}  # fmt: skip


@dataclass(frozen=True)
class Unit:
    """Errors of one unit: ``gyro_S``, ``accel_S`` (3, 3), biases in deg/s and g, noise densities per root hertz."""

    gyro_S: Any = field(
        default_factory=lambda: np.array([[1.01, 3e-3, -2e-3], [-1e-3, 0.988, 4e-3], [2e-3, -3e-3, 1.006]])
    )
    accel_S: Any = field(
        default_factory=lambda: np.array([[0.99, 2e-3, 3e-3], [-4e-3, 1.008, 1e-3], [1e-3, -2e-3, 1.01]])
    )
    gyro_bias_deg_s: Any = field(default_factory=lambda: np.array([0.1, -0.07, 0.05]))
    accel_bias_g: Any = field(default_factory=lambda: np.array([0.01, -0.006, 0.012]))
    arw_deg_s_rtHz: float = 0.3 / 60.0
    vrw_g_rtHz: float = 1e-4


def turned(axis: int, angle_deg: float) -> Any:
    """Right-handed rotation matrix about axis 0, 1 or 2."""
    a, (one, two) = np.deg2rad(angle_deg), ((axis + 1) % 3, (axis + 2) % 3)
    matrix = np.eye(3)
    matrix[[one, two], [one, two]] = np.cos(a)
    matrix[one, two], matrix[two, one] = -np.sin(a), np.sin(a)
    return matrix


BODY_TO_INNER = {"x": np.eye(3), "y": np.eye(3)[[1, 2, 0]], "z": np.eye(3)[[2, 0, 1]]}


def to_local(outer: float, middle: float, inner: float, mounting: str) -> Any:
    """Body to East, North, Up."""
    turns = turned(2, 90.0 - SITE["azimuth_deg"]) @ turned(2, outer) @ turned(1, middle) @ turned(0, inner)
    return turns @ BODY_TO_INNER[mounting]


def seen_while_turned(local: Any, outer: float, middle: float, inner_deg: Any, mounting: str) -> Any:
    """A local vector in the body, (n, 3), at angles (n,) of the inner axis."""
    x, y, z = to_local(outer, middle, 0.0, "x").T @ local
    cosine, sine = np.cos(np.deg2rad(inner_deg)), np.sin(np.deg2rad(inner_deg))
    inner = np.stack([np.full_like(cosine, x), cosine * y + sine * z, cosine * z - sine * y], axis=1)
    return inner @ BODY_TO_INNER[mounting]


class Rig:
    """Makes records one after the other; ``t_s`` is the bench clock."""

    def __init__(self, seed: int, unit: Unit | None = None, rate_Hz: float = RATE_Hz) -> None:
        self.rng, self.unit, self.t_s, self.counter = np.random.default_rng(seed), unit or Unit(), 100.0, 0
        self.rate_Hz = rate_Hz
        self.rows: list[RecordRow] = []

    def rest(self, seconds: float, pose: tuple[float, float, float], mounting: str = "x", **conditions: Any) -> None:
        """A record at rest."""
        n = round(seconds * self.rate_Hz)
        body = to_local(*pose, mounting).T
        earth = body @ earth_rate()
        force = body @ np.array([0.0, 0.0, SITE["gravity_m_s2"] / 9.80665])
        self._add(np.tile(earth, (n, 1)), np.tile(force, (n, 1)), pose, mounting, conditions)

    def turn(self, axis: str, turn_deg: float, seconds: float, middle: float, outer: float, **conditions: Any) -> None:
        """Three turns about the inner axis within 5 s, after 1 s of rest."""
        n = round(seconds * self.rate_Hz)
        edges = np.arange(n + 1) / self.rate_Hz
        angle = np.interp(edges, [1.0, 6.0], [0.0, turn_deg])
        rates = np.zeros((n, 3))
        rates[:, "xyz".index(axis)] = np.diff(angle) * self.rate_Hz
        middle_angle = (angle[1:] + angle[:-1]) / 2.0
        rates += seen_while_turned(earth_rate(), outer, middle, middle_angle, axis)
        about = {"axis": axis, "turn_deg": turn_deg, "turned": "inner", "direction": int(np.sign(turn_deg))}
        self._add(rates, np.zeros((n, 3)), (outer, middle, 0.0), axis, {"item": "rotation", **about, **conditions})

    def spin(self, seconds: float, rate_deg_s: float, field_gauss: float, **conditions: Any) -> None:
        """The field across z seen from a unit that turns about z."""
        n = round(seconds * self.rate_Hz)
        angle = np.deg2rad(rate_deg_s * np.arange(n) / self.rate_Hz)
        x, y = field_gauss * np.cos(angle), -field_gauss * np.sin(angle)
        alpha = np.deg2rad(1.5)
        seen = np.stack([0.05 + x * np.cos(alpha) + y * np.sin(alpha), -0.03 + y / 1.04, 0.2 + 0.0 * x], axis=1)
        seen += self.rng.normal(0.0, 5e-4, seen.shape)
        zeros = np.zeros((n, 3))
        about = {"item": "magnetometer", "rate_deg_s": rate_deg_s, **conditions}
        self._add(zeros, zeros, (90.0, 0.0, 0.0), "z", about, mag=np.rint(seen / 120e-6))

    def _add(
        self, rate: Any, force: Any, pose: tuple[float, float, float], mounting: str, conditions: Mapping[str, Any],
        mag: Any = None,
    ) -> None:  # fmt: skip
        n, unit = len(rate), self.unit
        gyro = (rate + unit.gyro_bias_deg_s) @ unit.gyro_S.T
        gyro = gyro + self.rng.normal(0.0, unit.arw_deg_s_rtHz * self.rate_Hz**0.5, gyro.shape)
        accel = force @ unit.accel_S.T + unit.accel_bias_g
        accel = accel + self.rng.normal(0.0, unit.vrw_g_rtHz * self.rate_Hz**0.5, accel.shape)
        tick = (np.arange(n) * round(1e6 / self.rate_Hz) + round(self.t_s * 1e6)) % (1 << 32)
        columns = {
            "gyro": np.rint(gyro / 0.005).astype(np.int32), "accel": np.rint(accel / 1e-3).astype(np.int32),
            "mag": np.zeros((n, 3), np.int16) if mag is None else mag.astype(np.int16),
            "temperature": np.full(n, 2500, np.int16), "tick": tick.astype(np.uint32),
        }  # fmt: skip
        t_ns = ((self.t_s + np.arange(n) / self.rate_Hz) * 1e9).astype(np.int64)
        about = {"mounting": mounting, "outer_deg": pose[0], "middle_deg": pose[1], "inner_deg": pose[2], **conditions}
        self.rows.append(record_of(len(self.rows) + 1, self.counter, t_ns, columns, about))
        self.t_s += n / self.rate_Hz + 5.0
        self.counter += n + 1000

    def material(self, analysis: str, **more: Any) -> Material:
        """What an analysis sees."""
        campaign = {"analysis": analysis, "uut": {"model": "GNC", "serial": "GNC-07"}, "site": SITE, "imu": IMU}
        fields = {name: more.pop(name) for name in ("exchanges", "layouts") if name in more}
        return Material(rows=self.rows, campaign=campaign | more, standards={}, **fields)


def record_of(
    number: int, first: int, t_ns: Any, columns: Mapping[str, Any], about: Mapping[str, Any],
    scales: Mapping[str, tuple[float, float, str]] = SCALES,
) -> RecordRow:  # fmt: skip
    """A record without gaps; ``first``: its first counter, ``t_ns``: times of its samples, ``about``: conditions."""
    n = len(t_ns)
    window = RecordWindow(number, "rs422", first, n, int(t_ns[0]), int(t_ns[-1]), dict(about))
    samples = Samples(dict(columns), first + np.arange(n, dtype=np.int64), t_ns, dict(scales))
    return RecordRow(window, {}, n, 0, 0, Quality.GOOD, samples=samples)


def earth_rate() -> Any:
    """East, North, Up, deg/s."""
    latitude = np.deg2rad(SITE["latitude_deg"])
    return EARTH_DEG_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def calibration(rig: Rig, sets: int = 1, *, middle: float = -37.5, outer: float = -20.0, rest_s: float = 20.0) -> Rig:
    """Six positions and six rotations, as often as asked for. The default pose is along the Earth's axis."""
    for _ in range(sets):
        for up, pose in POSES.items():
            rig.rest(rest_s, pose, item="position", up=up)
        for axis in "xyz":
            for sign in (1, -1):
                rig.turn(axis, sign * 1080.0, 16.3, middle, outer)
    return rig


def values(estimates: Sequence[Mapping[str, Any]], quantity: str, *names: str) -> Any:
    """Values of a quantity by its conditions: (3,) by axis, or (3, 3) by row and column (0 where there is none)."""
    found = np.zeros((3, 3) if names else 3)
    for one in estimates:
        if one.quantity == quantity:
            place = tuple("xyz".index(one.conditions[name]) for name in names or ("axis",))
            found[place if names else place[0]] = one.value
    return found
