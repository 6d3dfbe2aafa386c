"""Clocks of both ports by when their frames were received: the check of the filter that knows nothing of motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.port_clocks import PortClock, StampsDifference, clock_difference, port_clock
from bench.systems.time_sync.estimators.stamp_grid import grid_s
from bench.systems.time_sync.limits import Latency
from bench.systems.time_sync.records import Recording, Stream

Array = NDArray[np.float64]
NS = 1e-9
_NEAR_s = 0.05  # an offset that the filter finds by itself
_COARSE_s = 0.01  # steps of what is taken out of the tags before it


@dataclass(frozen=True)
class Clocks:
    """Both ports and their difference, EGI minus inertial unit.

    ``coarse_s``: whole part of the offset, taken out of the EGI's tags beforehand, exact.   ``difference``: of what is
    left.   ``latency``: as stated, None if nobody does.   ``line_s``: that the frames take on the line, EGI minus
    inertial unit.   ``place_s``: time of the unit of each frame of both ports, for figures.
    """

    imu: PortClock
    egi: PortClock
    coarse_s: float
    difference: StampsDifference
    latency: Latency | None
    line_s: float
    imu_s: Array
    egi_s: Array

    @property
    def offset_s(self) -> float | None:
        """Offset of the EGI's clock in the middle of the recording, None without stated latencies."""
        return None if self.latency is None else self.coarse_s + self.difference.offset_s


def clocks_of(taken: Recording, middle_s: float, latency: Latency | None, line_s: Mapping[str, float]) -> Clocks:
    """Line of least delay of either port, and the difference at ``middle_s``.

    Raises: FitError B-SYNC-009 for too few frames.
    """
    origin_ns = int(taken.imu.received_ns[0])
    step_s = grid_s(np.concatenate((taken.imu.received_ns, taken.egi.received_ns)))
    coarse_s = _coarse_s(taken, origin_ns)
    imu_s, egi_s = taken.imu.tick_s, taken.egi.tick_s - coarse_s
    imu = port_clock(imu_s, taken.imu.counter, _received_s(taken.imu, origin_ns), step_s)
    egi = port_clock(egi_s, taken.egi.counter, _received_s(taken.egi, origin_ns), step_s)
    on_line_s = line_s.get("egi", 0.0) - line_s.get("imu", 0.0)
    stated_s, std_s = on_line_s, 0.0
    if latency is not None:
        stated_s, std_s = on_line_s + latency.egi_s - latency.imu_s, math.sqrt(2.0) * latency.std_s
    difference = clock_difference(egi, imu, middle_s, stated_s, std_s)
    return Clocks(imu, egi, coarse_s, difference, latency, on_line_s, imu_s, egi_s)


def _received_s(stream: Stream, origin_ns: int) -> Array:
    return np.asarray((stream.received_ns - origin_ns) * NS)


def _coarse_s(taken: Recording, origin_ns: int) -> float:
    """Clocks may have begun at any time: what both delays are apart, in whole steps, if it is more than a little."""
    apart_s = float(
        np.median(taken.egi.tick_s - _received_s(taken.egi, origin_ns))
        - np.median(taken.imu.tick_s - _received_s(taken.imu, origin_ns))
    )
    return round(apart_s / _COARSE_s) * _COARSE_s if abs(apart_s) > _NEAR_s else 0.0
