"""The study without any error: how far the strapdown leaves the flight, and the response of a perfectly known track."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis import Floats
from bench.maths.strapdown import Track, navigate
from bench.systems.time_sync.estimators.sar.response import impulse_response
from bench.systems.time_sync.study.flight import simulated
from bench.systems.time_sync.study.image import scene_of
from bench.systems.time_sync.study.results import Cut, IdealResult
from bench.systems.time_sync.study.study import ERRORLESS, APERTURE_s, LONG_s, Task

_IMU_Hz = 200
FLOWN = ("linear", "acceleration", "turn")
LATITUDE_deg = 37.5


def ideal_result(task: Task) -> IdealResult:
    """Exact increments of the 60-second manoeuvres navigated, and a target focused with true positions."""
    paths = simulated("flight.path").MANOEUVRES
    off = [_distances(paths[name], task.duration_s) for name in FLOWN]
    scene = scene_of(paths["sar"], LONG_s - APERTURE_s)
    found = impulse_response(scene.one, scene.true_m, scene.target_m)
    cuts = (("azimuth", found.azimuth_cut), ("range", found.range_cut))
    return IdealResult(
        position_m=max(position_m for position_m, _ in off),
        velocity_m_s=max(velocity_m_s for _, velocity_m_s in off),
        resolution_m=found.azimuth_resolution_m,
        range_resolution_m=found.range_resolution_m,
        pslr_dB=found.pslr_dB,
        islr_dB=found.islr_dB,
        cuts=tuple(Cut(name, 0.0, ERRORLESS, cut.offset_m, cut.value) for name, cut in cuts),
    )


def _distances(path: Any, duration_s: float) -> tuple[float, float]:
    """Return greatest distance of position, m, and velocity, m/s, over the flight."""
    t_s = np.arange(round(duration_s * _IMU_Hz) + 1) / _IMU_Hz
    true = path.state(t_s)
    dv, dtheta = simulated("flight.imu").exact_increments(path, t_s, LATITUDE_deg)
    north = np.eye(3)  # where all of them begin to head
    found: Track = navigate(t_s[1:], dv, dtheta, true.p[0], true.v[0], north, LATITUDE_deg)
    return _greatest(found.p - true.p[1:]), _greatest(found.v - true.v[1:])


def _greatest(difference: Floats) -> float:
    return float(np.linalg.norm(difference, axis=1).max())
