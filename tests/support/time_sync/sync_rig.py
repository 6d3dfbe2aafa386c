"""A simulated time-offset bench for tests, without a controller: power, flight, frames by an own reader."""

import struct
import zlib
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.strapdown import small_rotation
from bench.model.clock import VirtualClock
from bench.systems.time_sync.estimators.kalman.setup import EgiSpread, FilterSetup, ImuSamples
from sim_instruments.worlds.simulation import open_world
from sim_instruments.worlds.time_sync.flight.egi import EgiErrors, EgiRuns, egi_error_runs
from sim_instruments.worlds.time_sync.flight.imu import ImuRuns, imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

BAUDS = {"egi": 460_800, "imu": 460_800, "radar": 10_000_000}
# sync, fields behind it, and names of the columns they make
LAYOUTS = {
    "egi": (b"\x45\x47", struct.Struct("<IQ9dfHH"), 14),
    "imu": (b"\x49\x4d", struct.Struct("<IQ6ihH"), 10),
    "radar": (b"\x53\x52", struct.Struct("<IQdfd128hH"), 134),
}
QUIET = {"noise": "off", "tag_noise_s": "0", "jitter_s": "0"}
RAMP_DEG_S2 = 400.0


class Rig:
    """A bench with its ports open; everything that arrives is kept by port, with the time it was read."""

    def __init__(self, seed=1, listen=("egi", "imu", "radar"), **options):
        self.clock = VirtualClock()
        text = {name: str(value) for name, value in options.items()}
        self.world = open_world("time_sync", clock=self.clock, seed=seed, station={"instruments": {}}, options=text)
        self.unit = self.world.unit
        self.received = {name: [] for name in BAUDS}
        for name in listen:
            self.listen(name)

    def listen(self, name):
        self.unit.connect(name, BAUDS[name], self.world.faults.link(name))

    def power(self, on=True):
        self.unit.set_power(on, self.clock.now_ns(), 15.0 if on else 0.0)

    def poll(self, period_s=0.001):
        return self.clock.every(period_s, self.read)

    def read(self):
        for name in BAUDS:
            if self.unit.waiting(name):
                self.received[name].append((self.clock.now_ns(), self.unit.read(name, 10**8)))

    def turn(self, rate_deg_s):
        """Yaw rate of the vehicle: that of the table about up, the other way round."""
        self.world.motion[0].run_at(-rate_deg_s, RAMP_DEG_S2, self.clock.now_ns())

    def bytes_of(self, name):
        self.read()
        return b"".join(chunk for _, chunk in self.received[name])

    def rows(self, name):
        return frames(name, self.bytes_of(name))

    def tick_s(self, name):
        return 1e-7 * self.rows(name)[:, 1]


def flying(speed=100.0, seed=1, boot_s=4.0, **options):
    """A rig whose vehicle has just begun to fly."""
    rig = Rig(seed, **options)
    rig.power()
    rig.clock.sleep(boot_s)
    rig.world.operate("speed", speed)
    return rig


def turning(rate_deg_s=4.5, before_s=10.0, turn_s=10.0, after_s=5.0, **options):
    """A rig whose vehicle has flown straight, turned, and flown straight."""
    rig = flying(**options)
    rig.clock.sleep(before_s)
    rig.turn(rate_deg_s)
    rig.clock.sleep(turn_s)
    rig.turn(0.0)
    rig.clock.sleep(after_s)
    return rig


def frames(name, received):
    """Rows of the fields as numbers of the wire; every byte belongs to a sound frame, but for the last one's."""
    sync, layout, columns = LAYOUTS[name]
    length = len(sync) + layout.size + 4
    rows = []
    for at in range(0, len(received) - length + 1, length):
        frame = received[at : at + length]
        assert frame.startswith(sync), at
        assert struct.unpack("<I", frame[-4:])[0] == zlib.crc32(frame[2:-4])
        rows.append(layout.unpack(frame[2:-4]))
    return np.array(rows, float).reshape(-1, columns)


Array = NDArray[np.float64]

LEVEL_UNTIL_S, TURN_UNTIL_S, END_S = 2.0, 4.0, 6.0
SEED = 20
EGI_s = 0.02
BASE = (1.0, 0.2, 0.01)  # measurement noise: position m, velocity m/s, attitude deg


def turning_path() -> FlightPath:
    """100 m/s north, 18 degrees to the right from 2 s to 4 s."""
    return FlightPath(((0.0, 0.0, 0.0), (LEVEL_UNTIL_S, 0.0, 9.0), (TURN_UNTIL_S, 0.0, 0.0)), speed_m_s=100.0)


@dataclass(frozen=True)
class Flight:
    """``path`` with the sensors' runs on it."""

    path: FlightPath
    unit: ImuRuns
    errors: EgiErrors

    @property
    def imu(self) -> ImuSamples:
        return ImuSamples(self.unit.t_s, self.unit.dv, self.unit.dtheta, np.zeros(self.unit.t_s.size, bool))

    def egi(self, offsets_s: tuple[float, ...]) -> EgiRuns:
        return EgiRuns(self.path, self.errors, np.array(offsets_s))


def level_matrices(yaw: Array) -> Array:
    """Body to t of level bodies, (..., 3, 3)."""
    out = np.zeros((*yaw.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(yaw)
    out[..., 1, 0], out[..., 0, 1], out[..., 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    return out


@cache
def flight(runs: int = 8, seed: int = SEED, end_s: float = END_S) -> Flight:
    """The turning flight."""
    path = turning_path()
    return Flight(path, imu_runs(path, end_s, runs, seed), egi_error_runs(path, end_s, runs, seed))


class LaneEgi:
    """EGI with errors (n, R, 9) and an offset of its own on each lane, the same for all groups.

    Errors: position m, velocity m/s, rotation rad.   ``offsets_s``: (R,).
    """

    def __init__(self, path: FlightPath, t_s: Array, errors: Array, offsets_s: Array, groups: int = 1) -> None:
        self.t_s, self._path, self._errors, self._offsets_s, self._groups = t_s, path, errors, offsets_s, groups

    def block(self, k0: int, k1: int) -> tuple[Array, ...]:
        true = self._path.state((self.t_s[k0:k1, None] - self._offsets_s).ravel())
        shape, errors = (-1, self._offsets_s.size, 3), self._errors[k0:k1]
        tilt = np.moveaxis(small_rotation(np.moveaxis(errors[..., 6:], -1, 0)), (0, 1), (-2, -1))
        level = level_matrices(true.yaw.reshape(errors.shape[:2]))
        values = (true.p.reshape(shape) + errors[..., :3], true.v.reshape(shape) + errors[..., 3:6], tilt @ level)
        return tuple(np.repeat(each[:, None], self._groups, axis=1) for each in values)


def white_egi(path: FlightPath, sigmas: tuple[float, float, float], offsets_s: Array, seed: int) -> LaneEgi:
    """White errors; ``sigmas``: position m, velocity m/s, attitude deg."""
    t_s = np.arange(0.0213, END_S, 0.02)
    sizes = np.repeat([*sigmas[:2], np.deg2rad(sigmas[2])], 3)
    return LaneEgi(path, t_s, np.random.default_rng(seed).normal(size=(t_s.size, offsets_s.size, 9)) * sizes, offsets_s)


def wandering_egi(path: FlightPath, end_s: float, spread: EgiSpread, offsets_s: Array, rng: Any) -> LaneEgi:
    """Solutions whose errors wander, for both groups."""
    t_s, runs = np.arange(0.2, end_s - 0.2, EGI_s), offsets_s.size
    sizes = np.array([spread.position_m] * 3 + [spread.velocity_m_s] * 3
                     + [*np.radians([spread.level_deg, spread.level_deg, spread.heading_deg])])  # fmt: skip
    kept = np.exp(-EGI_s / np.array([spread.wander_s] * 6 + [np.inf, np.inf, spread.heading_wander_s]))
    errors = rng.standard_normal((t_s.size, runs, 9))
    for k in range(1, t_s.size):
        errors[k] = kept * errors[k - 1] + np.sqrt(1.0 - kept**2) * errors[k]
    return LaneEgi(path, t_s, errors * sizes, offsets_s, 2)


def setup(groups: int, sigma_r: tuple[float, float, float], *, augmented: bool = True, **changes: float) -> FilterSetup:
    """The same filter for all groups."""
    return replace(FilterSetup((augmented,) * groups, (sigma_r,) * groups), **changes)  # type: ignore[arg-type]
