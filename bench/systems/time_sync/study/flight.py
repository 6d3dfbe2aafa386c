"""One manoeuvre of the study: flown, measured and filtered; statistics over the runs.

The flights come from the simulator by name, as the bench's simulated world does. Truth is needed to know the error of
an estimate, and is used for nothing else: the filter gets the samples alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Floats
from bench.model.installed import load, offer_of
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.innovation import (
    nees_of_offset,
    nis_summary,
    observability,
    state_errors,
)
from bench.systems.time_sync.estimators.kalman.setup import (
    OFFSET,
    FilterRun,
    FilterSetup,
    ImuSamples,
    STANDARD_GRAVITY_m_s2,
)
from bench.systems.time_sync.study.study import ERRORS, SIGMA_R, APERTURE_s, FlightResult, SETTLED_s, Task

WORLD = "time_sync"  # by name: the bench never imports its simulators
_TO_ug, _TO_deg_h = 1e6 / STANDARD_GRAVITY_m_s2, float(np.rad2deg(3600.0))
_KEPT_Hz = {True: 2.0, False: 10.0}  # epochs of a long and of a short flight
_EGI_Hz, _LONG_s = 50.0, 100.0
_FINE_BEFORE_s = 0.1


@dataclass(frozen=True)
class Flown:
    """A flight with all that was made of it; ``path`` and ``imu`` are the simulator's."""

    path: Any
    imu: Any
    run: FilterRun


def simulated(module: str) -> Any:
    """Return a module of the simulator."""
    offer = offer_of("worlds", WORLD)
    assert offer is not None
    return load(f"{offer.package}.{module}")


def fly(task: Task) -> Flown:
    """Simulate the units of all runs, and filter every group of a task.

    The errors of a run are the same for all offsets and filters, and in every task; they differ between runs.
    """
    path = simulated("flight.path").MANOEUVRES[task.manoeuvre]
    units = simulated("flight.egi")
    errors = units.egi_error_runs(path, task.duration_s, task.runs, task.seed)
    noise_s = units.clock_noise(task.seed, len(errors.t_s), task.runs)
    offsets_s = np.array([group.offset_s for group in task.groups])
    egi = units.EgiRuns(path, errors, offsets_s, noise_s)
    imu = simulated("flight.imu").imu_runs(path, task.duration_s, task.runs, task.seed)
    samples = ImuSamples(imu.t_s, imu.dv, imu.dtheta, np.zeros(len(imu.t_s), np.bool_))
    return Flown(path, imu, run_filter(samples, egi, setup_of(task)))


def setup_of(task: Task) -> FilterSetup:
    """Filters of a task; with images position and velocity are held while the radar is on."""
    opens_s = task.duration_s - APERTURE_s if task.kind == "image" else np.inf
    return FilterSetup(
        augmented=tuple(group.augmented for group in task.groups),
        sigma_r=tuple(SIGMA_R[group.noise] for group in task.groups),
        position_sigma_m=task.position_sigma_m,
        keep_every=round(_EGI_Hz / _KEPT_Hz[task.duration_s > _LONG_s]),
        fine_from_s=opens_s - _FINE_BEFORE_s,
        hold_position_from_s=opens_s,
    )


def flight_result(task: Task, flown: Flown) -> FlightResult:
    """Statistics over the runs at the kept epochs."""
    run, imu = flown.run, flown.imu
    true = flown.path.state(run.t_s)
    offset_s = np.array([group.offset_s for group in task.groups])
    off = state_errors(run, true.p, true.v, headings(true.yaw), imu.accel_bias, imu.gyro_bias, offset_s)
    scales = (1.0, 1.0, float(np.rad2deg(1.0)), _TO_ug, _TO_deg_h)
    errors = {
        name: off[..., 3 * k : 3 * k + 3] * scale for k, (name, scale) in enumerate(zip(ERRORS, scales, strict=True))
    }
    offset_error_s = off[..., OFFSET]
    summary = nis_summary(run, SETTLED_s)
    seen = observability(run.covariance, run.first_covariance)
    return FlightResult(
        groups=task.groups,
        runs=task.runs,
        t_s=run.t_s,
        mean={name: error.mean(axis=2) for name, error in errors.items()},
        rms={name: _rms(error) for name, error in errors.items()},
        offset_mean_s=offset_error_s.mean(axis=2),
        offset_rms_s=_rms(offset_error_s),
        offset_sigma_s=run.sigma[..., OFFSET],
        offset_nees=nees_of_offset(offset_error_s, run.covariance).mean(axis=2),
        nis_ratio=summary.ratio[:, 0],
        nis_outside=summary.outside[:, 0],
        eigenvalue=seen.associated,
        share=seen.offset_variance,
    )


def _rms(error: Floats) -> Floats:
    """Over the runs, axis 2."""
    return np.asarray(np.sqrt(np.mean(error**2, axis=2)))


def headings(yaw: Floats) -> Floats:
    """Attitudes (m, 3, 3), body to t, of level vehicles with headings (m,), rad."""
    out = np.zeros((len(yaw), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(yaw)
    out[:, 1, 0], out[:, 0, 1], out[:, 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    return out
