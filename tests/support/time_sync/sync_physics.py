"""Two units on one vehicle, and where a wrong world departs from a right one.

A physics of its own, which shares no line with the product or its simulators: a vehicle above a plane that turns with
the Earth, increments by Simpson's rule, errors of both units as their makers state them, frames by their stamps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bench.analysis import Material
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow, Samples

Array = Any
LATITUDE, LONGITUDE = np.radians(37.5), np.radians(126.95)
LONG_s, TURN_s, RATE_deg_s, SPEED_m_s, HEIGHT_m = 20.0, (6.0, 14.0), 11.25, 100.0, 3000.0
IMU_s, EGI_s = 0.025, 0.08  # of their own clocks
EGI_LATENCY_s, IMU_LATENCY_s, JITTER_s, TAG_s = 8e-3, 0.8e-3, 3e-4, 1e-5
OFFSET_s, DRIFT, IMU_CLOCK = 13.7e-3, 3e-6, 8e-6
G_m_s2, EARTH_rad_s, RADIUS_m = 9.7803253359, 7.292115e-5, 6_371_000.0
CAMPAIGN: Mapping[str, Any] = {
    "analysis": "time_sync",
    "uut": {"model": "EGI-IMU", "serial": "PAIR-1"},
    "latency": {"egi_s": EGI_LATENCY_s, "imu_s": IMU_LATENCY_s, "std_s": 1e-3},
    "inertial": {"accel_bias_g": 200e-6, "velocity_walk_g_rtHz": 20e-6, "gyro_bias_deg_s": 1.0 / 3600.0,
                 "angle_walk_deg_rth": 0.07},
    "egi": {"velocity_m_s": 0.017, "level_deg": 0.0013, "heading_deg": 0.0144, "wander_s": 20.0,
            "heading_wander_s": 100.0},
}  # fmt: skip
POSITION_m = 0.3
SCALES = {"tick": (1e-7, 0.0, "s"), "delta_angle": (1e-9, 0.0, "rad"), "delta_velocity": (1e-8, 0.0, "m/s")}
FIRST_TICK = 3_500_098_765


@dataclass
class Solutions:
    """What an EGI is about to send: true time of validity (n,), position m, velocity m/s, heading, roll, pitch rad."""

    valid_s: Array
    position_m: Array
    velocity_m_s: Array
    tilt_rad: Array  # rotation vector in the plane that turns the true attitude into the stated one
    stamp_s: Array  # true time of arrival
    tick_s: Array  # of its own clock


@dataclass(frozen=True)
class World:
    """A right world. The methods are where a wrong one departs from it."""

    size: float = 0.0

    def age_s(self, t_s: Array) -> tuple[Array, Array, Array]:
        """How much older than its tag position, velocity and attitude of a solution are."""
        none = np.zeros_like(t_s)
        return none, none, none

    def sent(self, solutions: Solutions) -> None:
        """Change what the EGI sends."""

    def increments(self, dv: Array, dtheta: Array, t_s: Array) -> None:
        """Change what the inertial unit sends."""

    def lever_m(self) -> Array:
        """From the inertial unit to where the EGI's solution is, body axes."""
        return np.zeros(3)

    def errors(self) -> float:
        """How many times as large as stated the EGI's errors are."""
        return 1.0

    def egi_arrival_s(self, t_s: Array) -> Array:
        """Additional delay on the line."""
        return np.zeros_like(t_s)


@dataclass(frozen=True)
class Path:
    """Straight north, a right turn at one rate from the first to the second of ``turn_s``, straight."""

    turn_s: tuple[float, float] = TURN_s
    rate_deg_s: float = RATE_deg_s
    speed_m_s: float = SPEED_m_s

    def motion(self, t_s: Array) -> tuple[Array, Array, Array]:
        """Return position (n, 3), velocity (n, 3) and heading (n,)."""
        begin, end = self.turn_s
        rate = np.radians(self.rate_deg_s)
        turned = np.clip(t_s, begin, end) - begin
        yaw = rate * turned
        before, after = np.minimum(t_s, begin), np.maximum(t_s - end, 0.0)
        last = rate * (end - begin)
        north = self.speed_m_s * (before + np.sin(yaw) / rate + after * np.cos(last))
        east = self.speed_m_s * ((1.0 - np.cos(yaw)) / rate + after * np.sin(last))
        velocity = self.speed_m_s * np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(t_s)], axis=1)
        return np.stack([north, east, np.full_like(t_s, -HEIGHT_m)], axis=1), velocity, yaw

    def turning(self, t_s: Array) -> Array:
        """Return the rate of the turn (n, 3), rad/s."""
        inside = (t_s > self.turn_s[0]) & (t_s < self.turn_s[1])
        return np.where(inside, np.radians(self.rate_deg_s), 0.0)[:, None] * np.array([0.0, 0.0, 1.0])

    def felt(self, t_s: Array) -> tuple[Array, Array]:
        """Return specific force (n, 3) m/s2 and rate (n, 3) rad/s along the body's axes."""
        position, velocity, yaw = self.motion(t_s)
        earth = EARTH_rad_s * np.array([np.cos(LATITUDE), 0.0, -np.sin(LATITUDE)])
        sine2 = np.sin(LATITUDE) ** 2
        g0 = G_m_s2 * (1.0 + 0.00193185265241 * sine2) / np.sqrt(1.0 - 0.00669437999013 * sine2)
        gravity = g0 * np.array([0.0, 0.0, 1.0]) + g0 / RADIUS_m * position * np.array([-1.0, -1.0, 2.0])
        acceleration = np.cross(self.turning(t_s), velocity)
        force = acceleration - gravity + 2.0 * np.cross(earth, velocity)
        return in_body(force, yaw), in_body(earth + self.turning(t_s), yaw)

    def integrals(self, edges_s: Array) -> tuple[Array, Array]:
        """Return what the body feels, integrated between consecutive times (n + 1,) by Simpson's rule: (n, 3) twice."""
        cut = np.union1d(edges_s, [at for at in self.turn_s if edges_s[0] < at < edges_s[-1]])
        inside = 1e-9
        parts = [self.felt(at) for at in (cut[:-1] + inside, 0.5 * (cut[:-1] + cut[1:]), cut[1:] - inside)]
        steps = np.diff(cut)[:, None] / 6.0
        begins = np.searchsorted(cut, edges_s[:-1])
        return tuple(  # type: ignore[return-value]
            np.add.reduceat(steps * (first + 4.0 * middle + last), begins, axis=0)
            for first, middle, last in zip(*parts, strict=True)
        )


TURNING = Path()
STRAIGHT = Path(turn_s=(0.0, 0.0))


def in_body(vector: Array, yaw: Array) -> Array:
    """Return vectors (n, 3) of the plane along the axes of a body with headings (n,); by the negative ones back."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    forward, right = cosine * vector[:, 0] + sine * vector[:, 1], cosine * vector[:, 1] - sine * vector[:, 0]
    return np.stack([forward, right, vector[:, 2]], axis=1)


def wander(rng: np.random.Generator, count: int, time_s: float, step_s: float = EGI_s) -> Array:
    """Return errors of unit variance that are alike for some time, (count, 3)."""
    kept = np.exp(-step_s / time_s)
    white = rng.standard_normal((count, 3))
    out = np.empty_like(white)
    out[0] = white[0]
    for k in range(1, count):
        out[k] = kept * out[k - 1] + np.sqrt(1.0 - kept**2) * white[k]
    return out


@dataclass(frozen=True)
class Recording:
    """One drive of both units: ``seed`` draws, ``world`` what is wrong, ``noise`` False without errors of any unit,
    but delays of the line.

    ``offset_s``: EGI minus IMU clock in the middle.   ``epoch_s``: by which the clock of the EGI is ahead besides.
    ``poll_ns``: step of the receive stamps.   ``loss``: share of frames that are lost.
    """

    seed: int
    world: World = field(default_factory=World)
    noise: bool = True
    path: Path = TURNING
    long_s: float = LONG_s
    imu_s: float = IMU_s
    egi_s: float = EGI_s
    offset_s: float = OFFSET_s
    drift: float = DRIFT
    imu_clock: float = IMU_CLOCK
    first_tick: int = FIRST_TICK
    epoch_s: float = 0.0
    poll_ns: int = 1
    loss: float = 0.0
    records: int = 1

    def material(self, **sections: Any) -> Material:
        """As the analysis takes it; ``sections``: what the sequence states otherwise."""
        imu, egi, rows = self._imu()[0], self._egi(), []
        edges = np.linspace(imu.counter[0], imu.counter[-1] + 1, self.records + 1).astype(int)
        for number, (first, stop) in enumerate(pairwise(edges.tolist()), 1):
            samples = part(imu, (imu.counter >= first) & (imu.counter < stop))
            begin_ns, end_ns = int(samples.t_ns[0]), int(samples.t_ns[-1])
            early = (number > 1) & (egi.t_ns <= begin_ns - 200_000_000)
            beside = part(egi, ~early & ((egi.t_ns <= end_ns) | (number == self.records)))
            conditions = {"item": "time_sync", "manoeuvre": "turn", "phase": "all"}
            window = RecordWindow(number, "imu", first, stop - first, begin_ns, end_ns, conditions)
            lost = stop - first - len(samples)
            beside = {"egi": beside}
            rows.append(RecordRow(window, {}, len(samples), lost, 0, Quality.GOOD, samples=samples, beside=beside))
        return Material(rows, dict(CAMPAIGN) | sections, {})

    @property
    def biases(self) -> tuple[Array, Array]:
        """Drawn biases of accelerometers, m/s2, and of gyros, rad/s."""
        return self._imu()[1]

    def _imu(self) -> tuple[Samples, tuple[Array, Array]]:
        own_s = np.arange(round(self.long_s / self.imu_s) + 1) * self.imu_s
        t_s = own_s / (1.0 + self.imu_clock)
        dv, dtheta = self.path.integrals(t_s)
        rng, biases = np.random.default_rng([self.seed, 1]), []
        for column, walk, bias in (
            (dv, 20e-6 * 9.80665, 200e-6 * 9.80665),
            (dtheta, np.radians(0.07) / 60.0, np.radians(1.0) / 3600.0),
        ):
            biases.append(bias * rng.standard_normal(3))
            errors = self.imu_s * biases[-1] + walk * np.sqrt(self.imu_s) * rng.standard_normal(column.shape)
            column += self.noise * errors
        self.world.increments(dv, dtheta, t_s[1:])
        columns = {
            "tick": self._ticks(own_s[1:], rng),
            "delta_angle": np.rint(dtheta / 1e-9).astype(np.int32),
            "delta_velocity": np.rint(dv / 1e-8).astype(np.int32),
            "status": np.zeros(len(dv), np.uint16),
        }
        return self._arrived(columns, 70_000, t_s[1:] + IMU_LATENCY_s, rng), (biases[0], biases[1])

    def _egi(self) -> Samples:
        own_s = 0.1137 + np.arange(round((self.long_s - 0.2) / self.egi_s)) * self.egi_s
        of_imu_s = own_s - self.offset_s - self.drift * (own_s - 0.5 * self.long_s)
        t_s = of_imu_s / (1.0 + self.imu_clock)
        ages = self.world.age_s(t_s)
        position, velocity, yaw = (self.path.motion(t_s - age)[part] for part, age in enumerate(ages))
        lever = in_body(self.world.lever_m() * np.ones((len(t_s), 1)), -yaw)
        position = position + lever
        velocity = velocity + np.cross(self.path.turning(t_s), lever)
        rng = np.random.default_rng([self.seed, 2])
        size = self.noise * self.world.errors()
        position += size * POSITION_m * wander(rng, len(t_s), 20.0, self.egi_s)
        velocity += size * 0.017 * wander(rng, len(t_s), 20.0, self.egi_s)
        tilt = np.radians([0.0013, 0.0013, 0.0]) * rng.standard_normal(3) * np.ones((len(t_s), 1))
        tilt[:, 2] = np.radians(0.0144) * wander(rng, len(t_s), 100.0, self.egi_s)[:, 2]
        stamp_s = t_s + EGI_LATENCY_s + self.world.egi_arrival_s(t_s)
        sent = Solutions(t_s, position, velocity, size * tilt, stamp_s, own_s + self.epoch_s)
        self.world.sent(sent)
        return self._solutions(sent, yaw, rng)

    def _solutions(self, sent: Solutions, yaw: Array, rng: np.random.Generator) -> Samples:
        latitude, longitude, height_m, to_level = on_the_ellipsoid(sent.position_m)
        turn = Rotation.from_rotvec(sent.tilt_rad) * Rotation.from_euler("Z", yaw[:, None])
        attitude = (Rotation.from_matrix(to_level) * turn).as_euler("ZYX", degrees=True)[:, ::-1]
        columns = {
            "tick": self._ticks(sent.tick_s, rng),
            "latitude": np.degrees(latitude), "longitude": np.degrees(longitude), "height": height_m,
            "velocity": np.einsum("nij,nj->ni", to_level, sent.velocity_m_s), "attitude": attitude,
            "position_sigma": np.full(len(yaw), POSITION_m), "mode": np.full(len(yaw), 3, np.uint16),
            "status": np.zeros(len(yaw), np.uint16),
        }  # fmt: skip
        return self._arrived(columns, 17_500, sent.stamp_s, rng)

    def _ticks(self, own_s: Array, rng: np.random.Generator) -> Array:
        noise_s = self.noise * TAG_s * rng.standard_normal(own_s.size)
        return np.rint((own_s + noise_s) * 1e7).astype(np.uint64) + np.uint64(self.first_tick)

    def _arrived(self, columns: dict[str, Array], first: int, due_s: Array, rng: np.random.Generator) -> Samples:
        late_s = rng.exponential(JITTER_s, due_s.size)
        ns = np.rint((np.maximum.accumulate(due_s + late_s) + 300.0) * 1e9).astype(np.int64)
        ns = -(-ns // self.poll_ns) * self.poll_ns
        kept = rng.random(due_s.size) >= self.loss
        kept[[0, -1]] = True
        scales = {name: SCALES.get(name, (1.0, 0.0, "")) for name in columns}
        return part(Samples(columns, first + np.arange(due_s.size), ns, scales), kept)


def part(samples: Samples, kept: Array) -> Samples:
    """Return some of the samples of a link."""
    columns = {name: column[kept] for name, column in samples.columns.items()}
    return replace(samples, columns=columns, counter=samples.counter[kept], t_ns=samples.t_ns[kept])


def on_the_ellipsoid(plane_m: Array) -> tuple[Array, Array, Array, Array]:
    """Return latitude, longitude (rad), height (m) of points (n, 3) of the plane, and (n, 3, 3) from it to level axes.

    Newton's steps on the ellipsoid's own equations, begun at the origin.
    """
    a, e2 = 6_378_137.0, 2.0 / 298.257223563 - 1.0 / 298.257223563**2
    out = _to_earth(np.full(1, LATITUDE), np.full(1, LONGITUDE))[0].T
    x = _earth_fixed(np.full(1, LATITUDE), np.full(1, LONGITUDE), np.zeros(1), a, e2) + plane_m @ out.T
    longitude = np.arctan2(x[:, 1], x[:, 0])
    ring = np.hypot(x[:, 0], x[:, 1])
    latitude = np.full(len(x), LATITUDE)
    for _ in range(6):
        normal = a / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(x[:, 2] + e2 * normal * np.sin(latitude), ring)
    normal = a / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height = ring / np.cos(latitude) - normal
    return latitude, longitude, height, _to_earth(latitude, longitude) @ out


def _earth_fixed(latitude: Array, longitude: Array, height: Array, a: float, e2: float) -> Array:
    normal = a / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    ring = (normal + height) * np.cos(latitude)
    up = (normal * (1.0 - e2) + height) * np.sin(latitude)
    return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), up], axis=-1)


def _to_earth(latitude: Array, longitude: Array) -> Array:
    """Return rows north, east, down in Earth-fixed axes, (n, 3, 3)."""
    sine, cosine, zero = np.sin(latitude), np.cos(latitude), np.zeros_like(latitude)
    north = np.stack([-sine * np.cos(longitude), -sine * np.sin(longitude), cosine], axis=-1)
    east = np.stack([-np.sin(longitude), np.cos(longitude), zero], axis=-1)
    return np.stack([north, east, np.cross(north, east)], axis=1)
