"""Motion of a table's axis as an exact function of time: pieces of constant acceleration, never samples.

Angles in degree, rates in deg/s, accelerations in deg/s2, times in nanoseconds of the bench clock. Right-handed: a
positive rate turns the axis counter-clockwise as seen from the tip of the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS


@dataclass(frozen=True)
class Piece:
    """From ``base_ns`` + ``start_s`` on: ``angle + rate t + acceleration t2 / 2``, until the next piece begins."""

    base_ns: int
    start_s: float
    angle_deg: float
    rate_deg_s: float
    acceleration_deg_s2: float

    @property
    def key_ns(self) -> int:
        """First whole nanosecond of the piece."""
        return self.base_ns + math.ceil(self.start_s * NS)


class AxisMotion:
    """All motion of one axis, past and planned. What is planned replaces whatever was planned for later.

    Args: angle_deg: where the axis stands at the beginning.
    """

    def __init__(self, angle_deg: float = 0.0) -> None:
        self._pieces = [Piece(0, 0.0, float(angle_deg), 0.0, 0.0)]
        self._table: tuple[Integers, Integers, Floats] | None = None

    def angle_deg(self, t_ns: Any) -> Floats:
        """Return angle at each time, not wrapped at a turn: degree, shape of ``t_ns``."""
        since_s, rows = self._at(t_ns)
        angle_deg: Floats = rows[..., 1] + since_s * (rows[..., 2] + 0.5 * rows[..., 3] * since_s)
        return angle_deg

    def rate_deg_s(self, t_ns: Any) -> Floats:
        """Return rate at each time: deg/s, shape of ``t_ns``."""
        since_s, rows = self._at(t_ns)
        rate_deg_s: Floats = rows[..., 2] + since_s * rows[..., 3]
        return rate_deg_s

    @property
    def rest_ns(self) -> int:
        """Begin of the last planned piece: from then on the rate is constant (zero but for a spin)."""
        return self._pieces[-1].key_ns

    def go_to(self, target_deg: float, rate_deg_s: float, acceleration_deg_s2: float, t_ns: int) -> None:
        """Plan the fastest way to rest at ``target_deg`` from the state at ``t_ns``: a trapezoid, or a triangle."""
        here_deg, speed = self._state(t_ns)
        limit, acceleration = abs(rate_deg_s), abs(acceleration_deg_s2)
        way_deg = target_deg - here_deg
        sense = math.copysign(1.0, way_deg - speed * abs(speed) / (2.0 * acceleration))
        peak = min(limit, math.sqrt(max(0.0, sense * acceleration * way_deg + speed * speed / 2.0)))
        first_s = abs(sense * peak - speed) / acceleration
        first_deg = (speed + sense * peak) / 2.0 * first_s
        last_s = peak / acceleration
        cruise_s = 0.0
        if peak > 0.0:
            cruise_s = max(0.0, (sense * (way_deg - first_deg) - peak * last_s / 2.0) / peak)
        into = math.copysign(acceleration, sense * peak - speed)
        self._plan(t_ns, here_deg, speed, [(first_s, into), (cruise_s, 0.0), (last_s, -sense * acceleration)])
        end = self._pieces[-1]
        self._pieces[-1] = Piece(end.base_ns, end.start_s, float(target_deg), 0.0, 0.0)  # exactly there

    def run_at(self, rate_deg_s: float, acceleration_deg_s2: float, t_ns: int) -> None:
        """Plan a change to a constant rate, 0 to come to rest, from the state at ``t_ns``."""
        here_deg, speed = self._state(t_ns)
        change = rate_deg_s - speed
        first_s = abs(change) / abs(acceleration_deg_s2)
        self._plan(t_ns, here_deg, speed, [(first_s, math.copysign(abs(acceleration_deg_s2), change))])
        end = self._pieces[-1]
        self._pieces[-1] = Piece(end.base_ns, end.start_s, end.angle_deg, float(rate_deg_s), 0.0)

    def _state(self, t_ns: int) -> tuple[float, float]:
        return float(self.angle_deg(t_ns)), float(self.rate_deg_s(t_ns))

    def _plan(self, t_ns: int, here_deg: float, speed: float, phases: list[tuple[float, float]]) -> None:
        """Append pieces of (duration s, acceleration deg/s2) behind ``t_ns``, and one of constant rate behind them."""
        self._table = None
        while len(self._pieces) > 1 and self._pieces[-1].key_ns >= t_ns:
            self._pieces.pop()
        start_s = 0.0
        for duration_s, acceleration in phases:
            if duration_s > 0.0:
                self._pieces.append(Piece(t_ns, start_s, here_deg, speed, acceleration))
                here_deg += duration_s * (speed + 0.5 * acceleration * duration_s)
                speed += acceleration * duration_s
                start_s += duration_s
        self._pieces.append(Piece(t_ns, start_s, here_deg, speed, 0.0))

    def _at(self, t_ns: Any) -> tuple[Floats, Floats]:
        """Return seconds since the piece began, and the piece's (start, angle, rate, acceleration), of each time."""
        if self._table is None:
            self._table = (
                np.array([piece.key_ns for piece in self._pieces], np.int64),
                np.array([piece.base_ns for piece in self._pieces], np.int64),
                np.array(
                    [(p.start_s, p.angle_deg, p.rate_deg_s, p.acceleration_deg_s2) for p in self._pieces], np.float64
                ),
            )
        keys, bases, rows = self._table
        times_ns = np.asarray(t_ns, np.int64)
        which = np.maximum(np.searchsorted(keys, times_ns, side="right") - 1, 0)
        chosen = rows[which]
        since_s: Floats = (times_ns - bases[which]) / NS - chosen[..., 0]
        return since_s, chosen
