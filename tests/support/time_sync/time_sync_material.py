"""Recordings of an EGI and an IMU for tests of their analysis: the direct simulation as frames, without a world.

The way onto the ellipsoid is written here (Bowring), not taken from bench.systems or from the simulated units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bench.analysis import Material
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow, Samples
from sim_instruments.worlds.time_sync.flight.egi import egi_error_runs
from sim_instruments.worlds.time_sync.flight.imu import ImuErrors, exact_increments
from sim_instruments.worlds.time_sync.flight.path import MANOEUVRES, FlightPath

Array = Any
LATITUDE_DEG, LONGITUDE_DEG = 37.5, 126.95
IMU_SCALES = {
    "tick": (1e-7, 0.0, "s"), "delta_angle": (1e-9, 0.0, "rad"), "delta_velocity": (1e-8, 0.0, "m/s"),
    "temperature": (0.01, 0.0, "degC"), "status": (1.0, 0.0, ""),
}  # fmt: skip
EGI_SCALES = {
    "tick": (1e-7, 0.0, "s"), "latitude": (1.0, 0.0, "deg"), "longitude": (1.0, 0.0, "deg"), "height": (1.0, 0.0, "m"),
    "velocity": (1.0, 0.0, "m/s"), "attitude": (1.0, 0.0, "deg"), "position_sigma": (1.0, 0.0, "m"),
    "mode": (1.0, 0.0, ""), "status": (1.0, 0.0, ""),
}  # fmt: skip
_A_m, _F = 6_378_137.0, 1.0 / 298.257223563


def campaign(**sections: Any) -> dict[str, Any]:
    """Sections that the sequence would state."""
    stated: dict[str, Any] = {
        "analysis": "time_sync",
        "uut": {"model": "EGI-IMU", "serial": "PAIR-1"},
        "latency": {"egi_s": 0.008, "imu_s": 0.0008, "std_s": 1e-3},
    }
    return stated | sections


def geodetic(tangent_m: Array) -> tuple[Array, Array, Array, Array]:
    """Latitude, longitude (deg), height (m) of points (n, 3) of the tangent frame, and (n, 3, 3) from it to level."""
    e2 = _F * (2.0 - _F)
    latitude0, longitude0 = np.radians(LATITUDE_DEG), np.radians(LONGITUDE_DEG)
    to_earth = axes(latitude0, longitude0).T
    normal_m = _A_m / np.sqrt(1.0 - e2 * np.sin(latitude0) ** 2)
    out_m = normal_m * np.cos(latitude0)
    origin_m = np.array(
        [out_m * np.cos(longitude0), out_m * np.sin(longitude0), normal_m * (1 - e2) * np.sin(latitude0)]
    )
    x, y, z = (origin_m + tangent_m @ to_earth.T).T
    out = np.hypot(x, y)
    reduced = np.arctan2(z, out * (1.0 - _F))
    for _ in range(3):
        b_m = _A_m * (1.0 - _F)
        latitude = np.arctan2(z + e2 / (1.0 - e2) * b_m * np.sin(reduced) ** 3, out - e2 * _A_m * np.cos(reduced) ** 3)
        reduced = np.arctan2((1.0 - _F) * np.sin(latitude), np.cos(latitude))
    longitude = np.arctan2(y, x)
    height_m = out * np.cos(latitude) + z * np.sin(latitude) - _A_m * np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    level = np.stack([axes(one, other) @ to_earth for one, other in zip(latitude, longitude, strict=True)])
    return np.degrees(latitude), np.degrees(longitude), height_m, level


def axes(latitude: float, longitude: float) -> Array:
    """Rows north, east, down in Earth-fixed axes, by turns about z and y."""
    turn = Rotation.from_euler("ZY", [longitude, -latitude - 0.5 * np.pi]).as_matrix()
    return turn.T


@dataclass(frozen=True)
class Pair:
    """Both units, their clocks and their links. ``offset_s``: EGI minus IMU clock in the middle of the recording."""

    manoeuvre: str = "turn"
    duration_s: float = 60.0
    seed: int = 1
    offset_s: float = 0.0137
    drift_ppm: float = 3.0
    imu_ppm: float = 8.0
    noise: bool = True
    tag_noise_s: float = 1e-5
    jitter_s: float = 3e-4
    poll_ns: int = 1_000_000
    first_tick: int = 3_500_098_765
    egi_epoch_s: float = 0.0  # by which the clock of the EGI is ahead besides
    loss: float = 0.0
    records: int = 3
    path: FlightPath | None = None

    def rows(self) -> list[RecordRow]:
        """The records, chained, with both links."""
        imu, egi = self.imu(), self.egi()
        edges = np.linspace(imu.counter[0], imu.counter[-1] + 1, self.records + 1).astype(int)
        rows = []
        for number, (first, stop) in enumerate(pairwise(edges)):
            mine = (imu.counter >= first) & (imu.counter < stop)
            samples = _part(imu, mine)
            t_ns = samples.t_ns
            beside = _part(egi, (egi.t_ns > t_ns[0] - 200_000_000 * (number > 0)) & (egi.t_ns <= t_ns[-1]))
            conditions = {"item": "time_sync", "manoeuvre": self.manoeuvre, "phase": f"part {number + 1}"}
            window = RecordWindow(
                number + 1, "imu", int(first), int(stop - first), int(t_ns[0]), int(t_ns[-1]), conditions
            )
            rows.append(RecordRow(
                window, {}, len(samples), int(stop - first) - len(samples), 0, Quality.GOOD, samples=samples,
                beside={"egi": beside},
            ))  # fmt: skip
        return rows

    def material(self, **sections: Any) -> Material:
        """As the analysis takes it."""
        return Material(rows=self.rows(), campaign=campaign(**sections), standards={})

    @property
    def flight(self) -> FlightPath:
        """True path."""
        return self.path or MANOEUVRES[self.manoeuvre]

    def imu(self) -> Samples:
        """Samples by the clock of the IMU, every 5 ms."""
        own_s = np.arange(round(self.duration_s * 200) + 1) * 0.005
        t_s = own_s / (1.0 + 1e-6 * self.imu_ppm)
        dv, dtheta = exact_increments(self.flight, t_s)
        if self.noise:
            errors = ImuErrors(self.seed, 0)
            noise = errors.noise(0, len(dv))
            dv = dv + errors.accel_bias * 0.005 + noise[:, :3]
            dtheta = dtheta + errors.gyro_bias * 0.005 + noise[:, 3:]
        rng = np.random.default_rng([self.seed, 1])
        columns = {
            "tick": self._ticks(own_s[1:], rng),
            "delta_angle": np.rint(dtheta / 1e-9).astype(np.int32),
            "delta_velocity": np.rint(dv / 1e-8).astype(np.int32),
            "temperature": np.full(len(dv), 2500, np.int16),
            "status": np.zeros(len(dv), np.uint16),
        }
        counter = 70_000 + np.arange(len(dv))
        return self._arrived(Samples(columns, counter, self._stamps(t_s[1:], 0.0008, rng), IMU_SCALES), rng)

    def egi(self) -> Samples:
        """Samples by the clock of the EGI, every 20 ms."""
        drift, middle_s = 1e-6 * self.drift_ppm, 0.5 * self.duration_s
        own_s = 0.1137 + np.arange(round((self.duration_s - 0.2) * 50)) * 0.02
        of_imu_s = (own_s - self.offset_s + drift * middle_s) / (1.0 + drift)
        t_s = of_imu_s / (1.0 + 1e-6 * self.imu_ppm)
        true = self.flight.state(t_s)
        turn = Rotation.from_euler("Z", true.yaw[:, None]).as_matrix()
        p, v = true.p.copy(), true.v.copy()
        if self.noise:
            errors = egi_error_runs(self.flight, self.duration_s, 1, self.seed)
            n = len(t_s)
            p += errors.dp[:n, 0]
            v += errors.dv[:n, 0]
            turn = Rotation.from_rotvec(errors.dphi[:n, 0]).as_matrix() @ turn
        latitude, longitude, height_m, level = geodetic(p)
        rng = np.random.default_rng([self.seed, 2])
        columns: dict[str, Array] = {
            "tick": self._ticks(own_s + self.egi_epoch_s, rng),
            "latitude": latitude, "longitude": longitude, "height": height_m,
            "velocity": np.einsum("nij,nj->ni", level, v),
            "attitude": Rotation.from_matrix(level @ turn).as_euler("ZYX", degrees=True)[:, ::-1],
            "position_sigma": np.full(len(t_s), 0.3, np.float32),
            "mode": np.full(len(t_s), 3, np.uint16), "status": np.zeros(len(t_s), np.uint16),
        }  # fmt: skip
        counter = 17_500 + np.arange(len(t_s))
        return self._arrived(Samples(columns, counter, self._stamps(t_s, 0.008, rng), EGI_SCALES), rng)

    def _ticks(self, own_s: Array, rng: np.random.Generator) -> Array:
        ticks = np.rint((own_s + self.tag_noise_s * rng.standard_normal(own_s.size)) * 1e7).astype(np.int64)
        return ticks.astype(np.uint64) + np.uint64(self.first_tick)

    def _stamps(self, t_s: Array, latency_s: float, rng: np.random.Generator) -> Array:
        arrived_s = t_s + latency_s + (rng.exponential(self.jitter_s, t_s.size) if self.jitter_s else 0.0)
        ns = np.rint(np.maximum.accumulate(arrived_s) * 1e9).astype(np.int64) + 300_000_000_000
        return -(-ns // self.poll_ns) * self.poll_ns if self.poll_ns else ns

    def _arrived(self, samples: Samples, rng: np.random.Generator) -> Samples:
        keep = rng.random(len(samples)) >= self.loss
        keep[[0, -1]] = True
        return _part(samples, keep)


def _part(samples: Samples, keep: Array) -> Samples:
    columns = {name: column[keep] for name, column in samples.columns.items()}
    return replace(samples, columns=columns, counter=samples.counter[keep], t_ns=samples.t_ns[keep])
