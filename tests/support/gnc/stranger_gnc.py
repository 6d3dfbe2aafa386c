"""A GNC module on a three-axis table as a stranger records it; poses by the formula of docs/session-format.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from stranger_page import Session, documented_campaign, packed, shipped

EARTH_deg_s = np.degrees(7.292115e-5)
G_m_s2 = 9.80665
GYRO_S = np.array([[1.01, 3e-3, -2e-3], [-1e-3, 0.988, 4e-3], [2e-3, -3e-3, 1.006]])
ACCEL_S = np.array([[0.99, 2e-3, 3e-3], [-4e-3, 1.008, 1e-3], [1e-3, -2e-3, 1.01]])
GYRO_BIAS_deg_s = np.array([0.1, -0.07, 0.05])  # rate = K output - bias
ACCEL_BIAS_g = np.array([-0.01, 0.006, -0.012])  # acceleration = K output + bias
MAGNETIC = {"x": 0.05, "y": -0.03, "gain": 1.04, "angle_deg": 1.5, "radius": 0.3}  # gauss
STEPS_deg_s = (0.0, 0.004, -0.003, 0.006, 0.001, -0.005)  # of six windows
UPS = {
    "+x": (0.0, -90.0, 0.0), "-x": (0.0, 90.0, 0.0), "+y": (0.0, 0.0, 90.0), "-y": (0.0, 0.0, -90.0),
    "+z": (0.0, 0.0, 0.0), "-z": (0.0, 0.0, 180.0),
}  # fmt: skip
STREAM = np.dtype(
    [
        ("head", "u1", 6), ("length", "<u2"), ("counter", "<u4"), ("tick", "<u4"), ("count", "u1"), ("gyro", "<i4", 3),
        ("accel", "<i4", 3), ("mag", "<i4", 3), ("temperature", "<i2"),
    ]
)  # fmt: skip
Pose = tuple[float, float, float]


def _about(axis: int, angle_deg: Any) -> Any:
    """Right-handed turns, (n, 3, 3)."""
    angle = np.radians(np.atleast_1d(angle_deg))
    turn = np.zeros((angle.size, 3, 3))
    turn[:, axis, axis] = 1.0
    one, two = (axis + 1) % 3, (axis + 2) % 3
    turn[:, one, one] = turn[:, two, two] = np.cos(angle)
    turn[:, two, one], turn[:, one, two] = np.sin(angle), -np.sin(angle)
    return turn


class Table:
    """Records one after the other; the stream runs during records only."""

    def __init__(self, analysis: str, rate_Hz: int = 200) -> None:
        self.campaign = documented_campaign("imu_calibration") | {"analysis": analysis, "rate_Hz": rate_Hz}
        text = shipped("gnc_422").replace("rate: 200 Hz", f"rate: {rate_Hz} Hz")
        self.session = Session(self.campaign, {"rs422": text})
        self.rate_Hz, self.t_s, self.counter = rate_Hz, 1.0, 0
        self.rng, self.step_deg_s = np.random.default_rng(5), 0.0  # by which the bias of all gyros is another one

    def body(self, vector: Any, pose: Pose, mounting: str, inner_deg: Any = 0.0) -> Any:
        """A vector of the local axes as the body sees it, (n, 3), its inner axis turned on by some angles (n,)."""
        outer, middle, inner = pose
        base = _about(2, 90.0 - self.campaign["site"]["azimuth_deg"]) @ _about(2, outer) @ _about(1, middle)
        table = np.einsum("nij,i->nj", base @ _about(0, inner + np.asarray(inner_deg)), np.asarray(vector))
        return np.roll(table, "xyz".index(mounting), axis=1)

    def record(self, seconds: float, pose: Pose, mounting: str = "x", **conditions: Any) -> None:
        """At rest, or turned about its inner axis: 1 s of rest, 5 s of ``turn_deg``, rest."""
        n = round(seconds * self.rate_Hz)
        edges_deg = np.interp(np.arange(n + 1) / self.rate_Hz, [1.0, 6.0], [0.0, conditions.get("turn_deg", 0.0)])
        seen_deg = 0.5 * (edges_deg[1:] + edges_deg[:-1])
        latitude = np.radians(self.campaign["site"]["latitude_deg"])
        rate = self.body(EARTH_deg_s * np.array([0.0, np.cos(latitude), np.sin(latitude)]), pose, mounting, seen_deg)
        rate[:, "xyz".index(mounting)] += np.diff(edges_deg) * self.rate_Hz
        up_g = np.array([0.0, 0.0, self.campaign["site"]["gravity_m_s2"] / G_m_s2])
        angles = dict(zip(("outer_deg", "middle_deg", "inner_deg"), pose, strict=True))
        conditions = {"mounting": mounting, **angles, **conditions}
        self.recorded(rate, self.body(up_g, pose, mounting, seen_deg), np.zeros((n, 3)), conditions)

    def recorded(self, rate: Any, force: Any, field: Any, conditions: Mapping[str, Any]) -> None:
        """True inputs, deg/s, g and gauss, through the sensors, with white noise."""
        n, density = len(rate), self.rate_Hz**0.5
        gyro = (rate + GYRO_BIAS_deg_s + self.step_deg_s) @ GYRO_S.T + self.rng.normal(0.0, 5e-3 * density, (n, 3))
        accel = (force - ACCEL_BIAS_g) @ ACCEL_S.T + self.rng.normal(0.0, 5e-4 * density, (n, 3))
        body = np.zeros(n, STREAM)
        body["head"], body["length"], body["count"] = (1, 1, 16, 9, 2, 0x22), 47, 1
        body["counter"] = self.counter + np.arange(n)
        body["tick"] = (round(1e6 * self.t_s) + np.arange(n) * (1_000_000 // self.rate_Hz)) % (1 << 32)
        body["gyro"], body["accel"] = np.rint(gyro / 0.005), np.rint(accel / 1e-3)
        body["mag"], body["temperature"] = np.rint(field / 120e-6), 2500
        begin_s, chunk = self.t_s, max(20, self.rate_Hz // 10)
        frames = packed(b"\xeb\x90", body, "crc-16/ibm-3740")
        for at in range(0, n, chunk):
            self.session.frames("rs422", begin_s + (at + chunk) / self.rate_Hz, b"".join(frames[at : at + chunk]))
        end_s = begin_s + n / self.rate_Hz + 0.1
        self.session.record(self.counter, n, begin_s, end_s, **conditions)
        self.t_s, self.counter = end_s + 1.0, self.counter + n


def calibration_session() -> Session:
    """Six positions and six rotations, once."""
    table = Table("imu_calibration")
    for up, pose in UPS.items():
        table.record(10.0, pose, item="position", up=up)
    for axis in "xyz":
        for sign in (1, -1):
            about = {"item": "rotation", "axis": axis, "turn_deg": 1080.0 * sign, "turned": "inner"}
            table.record(9.0, (-20.0, -37.5, 0.0), axis, **about)
    return table.session


def short_bias_session() -> Session:
    """Some minutes at rest."""
    return _at_rest().session


def _at_rest() -> Table:
    table = Table("imu_bias", rate_Hz=10)
    table.record(180.0, (0.0, 0.0, 0.0), item="bias")
    return table


def bias_session() -> Session:
    """Some minutes at rest, a flip about x, an hour, six windows of ten minutes, at 10 samples a second."""
    table = _at_rest()
    for inner_deg in (0.0, 180.0):
        table.record(180.0, (0.0, 0.0, inner_deg), item="flip")
    table.record(3600.0, (0.0, 0.0, 0.0), item="stability")
    for table.step_deg_s in STEPS_deg_s:
        table.record(600.0, (0.0, 0.0, 0.0), item="repeatability")
        table.t_s += 700.0
    return table.session


def indicated_bias(table_rate: Any) -> Any:
    """What gyros at rest indicate beyond the Earth's rate: not compensated, so the scale errors of both are in it."""
    return (table_rate + GYRO_BIAS_deg_s) @ GYRO_S.T - table_rate


def earth_at_rest() -> Any:
    """(3,) Earth's rate in the body with all axes of the table at zero, deg/s."""
    table = Table("imu_bias")
    latitude = np.radians(table.campaign["site"]["latitude_deg"])
    local = EARTH_deg_s * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    return table.body(local, (0.0, 0.0, 0.0), "x")[0]


def magnetometer_session() -> Session:
    """Ten turns about body z, which points up."""
    table, rate_deg_s = Table("magnetometer", rate_Hz=50), 36.0
    angle = np.radians(rate_deg_s * np.arange(5000) / 50.0)
    x, y = MAGNETIC["radius"] * np.cos(angle), -MAGNETIC["radius"] * np.sin(angle)
    tilt = np.radians(MAGNETIC["angle_deg"])
    seen = [MAGNETIC["x"] + x * np.cos(tilt) + y * np.sin(tilt), MAGNETIC["y"] + y / MAGNETIC["gain"], 0.2 + 0.0 * x]
    field = np.stack(seen, axis=1) + table.rng.normal(0.0, 5e-4, (angle.size, 3))
    pose = {"mounting": "z", "outer_deg": 90.0, "middle_deg": 0.0, "inner_deg": 0.0}
    nothing = np.zeros((angle.size, 3))
    table.recorded(nothing, nothing, field, {"item": "magnetometer", "rate_deg_s": rate_deg_s, **pose})
    return table.session
