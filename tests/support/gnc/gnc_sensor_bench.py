"""A table for the sensor tests, written for them: axes that move as plain formulas say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from bench.model.clock import NS
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.gnc.imu import GncImu, ImuOptions

IDEAL = ImuOptions(errors=False, noise=False)
QUIET = ImuOptions(noise=False)
# v_table = M v_body, from the words "body axis along the inner axis, the other two follow cyclically"
MOUNTINGS = {
    "x": np.eye(3),
    "y": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], float),
    "z": np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float),
}


@dataclass
class Formula:
    """An axis whose angle is a function of seconds."""

    angle: Callable[[np.ndarray], np.ndarray]
    step_s: float = 1e-5

    def angle_deg(self, t_ns: np.ndarray) -> np.ndarray:
        return self.angle(np.asarray(t_ns) / NS)

    def rate_deg_s(self, t_ns: np.ndarray) -> np.ndarray:
        t_s = np.asarray(t_ns) / NS
        return (self.angle(t_s + self.step_s) - self.angle(t_s - self.step_s)) / (2 * self.step_s)


def at(angle_deg: float) -> Formula:
    return Formula(lambda t_s: np.full(np.shape(t_s), float(angle_deg)))


def turning(rate_deg_s: float) -> Formula:
    return Formula(lambda t_s: rate_deg_s * t_s)


def trapezoid(start_s: float, turn_deg: float, rate_deg_s: float, acceleration_deg_s2: float) -> Formula:
    """From rest to rest by ``turn_deg``, rate and acceleration without sign."""
    ramp_s = rate_deg_s / acceleration_deg_s2
    cruise_s = abs(turn_deg) / rate_deg_s - ramp_s
    assert cruise_s > 0

    def angle(t_s: np.ndarray) -> np.ndarray:
        up = np.clip(t_s - start_s, 0.0, ramp_s)
        flat = np.clip(t_s - start_s - ramp_s, 0.0, cruise_s)
        down = np.clip(t_s - start_s - ramp_s - cruise_s, 0.0, ramp_s)
        way = acceleration_deg_s2 * (up**2 / 2 + ramp_s * down - down**2 / 2) + rate_deg_s * flat
        return np.copysign(way, turn_deg)

    return Formula(angle)


@dataclass
class Table:
    """Surroundings of a module on a table; angles or motions are (outer, middle, inner)."""

    motion: tuple[Formula, Formula, Formula] = field(default_factory=lambda: (at(0), at(0), at(0)))
    mounting: str = "x"
    table: str = "non_magnetic"


def posed(outer: float, middle: float, inner: float, mounting: str = "x") -> Table:
    return Table((at(outer), at(middle), at(inner)), mounting)


def module(table: Table, options: ImuOptions = IDEAL, serial: str = "GNC-01", site: Site | None = None) -> GncImu:
    return GncImu(11, serial, options, surroundings=table, site=site or Site())


def times_ns(seconds: float, first_s: float = 0.0, rate_hz: float = 200.0) -> np.ndarray:
    """Time stamps of contiguous samples, the first interval of which begins at ``first_s``."""
    return round(first_s * NS) + np.arange(1, round(seconds * rate_hz) + 1, dtype=np.int64) * round(NS / rate_hz)


def body_to_local(table: Table, t_ns: np.ndarray, site: Site) -> Rotation:
    """Attitude by scipy alone: v_n = Rz(90 - azimuth) Rz(outer) Ry(middle) Rx(inner) M v_b."""
    outer, middle, inner = (axis.angle_deg(t_ns) for axis in table.motion)
    angles = np.stack((outer + 90.0 - site.azimuth_deg, middle, inner), axis=-1)
    return Rotation.from_euler("ZYX", angles, degrees=True) * Rotation.from_matrix(MOUNTINGS[table.mounting])
