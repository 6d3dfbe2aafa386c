"""A task of the study, done: flown and filtered, its end focused, or all of it without any error.

Aperture policy: position and velocity updates are held while the radar is on, attitude updates go on. It stands in for
the parametric error modelling of the paper, whose order and weights are not given. The echoes come from where the
antenna truly was; the image knows the navigation solution and the surveyed place of the target alone.

One manoeuvre of the study: flown, measured and filtered; statistics over the runs.

The flights come from the simulator by name, as the bench's simulated world does. Truth is needed to know the error of
an estimate, and is used for nothing else: the filter gets the samples alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from bench.analysis import Floats
from bench.maths.geodesy import heading_matrices
from bench.maths.strapdown import Track, navigate
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
    FineTrack,
    ImuSamples,
    STANDARD_GRAVITY_m_s2,
)
from bench.systems.time_sync.estimators.sar.image import Chip, image_chip
from bench.systems.time_sync.estimators.sar.pulses import Pulses, positions_at
from bench.systems.time_sync.estimators.sar.response import Response, SEARCH_m, impulse_response
from bench.systems.time_sync.study.study import (
    ERRORS,
    FLOWN,
    SIGMA_R,
    TIGHT,
    APERTURE_s,
    FlightResult,
    IdealResult,
    ImageResult,
    LONG_s,
    SETTLED_s,
    Task,
)

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
    path = simulated("flight.path").manoeuvre(task.manoeuvre)
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
    off = state_errors(run, true.p, true.v, heading_matrices(true.yaw), imu.accel_bias, imu.gyro_bias, offset_s)
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


_CHIP_m = 16.0  # half length: 30 ms at 250 m/s move the target by 8 m
IMAGED = TIGHT  # noise of the filters whose solutions are focused
SHOWN_RUN = 0
FIGURES = {  # of a response, by names of ``ImageResult``
    "azimuth_shift_m": "azimuth.shift_m", "range_shift_m": "range.shift_m",
    "azimuth_resolution_m": "azimuth.resolution_m", "range_resolution_m": "range.resolution_m",
    "pslr_dB": "azimuth.pslr_dB", "islr_dB": "azimuth.islr_dB", "peak": "peak",
}  # fmt: skip
_LAG, _BEYOND_LAG_m = 1.2, 8.0  # an image lags by some 9 % more than the offset does, and scatters by 0.8 m
_IMU_Hz = 200
LATITUDE_deg = 37.5


@dataclass(frozen=True)
class Scene:
    """View of the radar: pulses of one target and of several, and the surveyed places; ``true_m`` (n, 3)."""

    pulse_s: Floats
    true_m: Floats
    one: Pulses
    several: Pulses
    targets_m: Floats

    def search_m(self, offset_s: float) -> tuple[float, float]:
        """Half widths, along track and in range, of the place where a target is looked for: its lag and some more."""
        lag_m = abs(offset_s) * float(np.linalg.norm(self.true_m[-1] - self.true_m[0])) / np.ptp(self.pulse_s)
        return max(SEARCH_m[0], _LAG * lag_m + _BEYOND_LAG_m), SEARCH_m[1]

    @property
    def target_m(self) -> Floats:
        """The target in the middle, (3,)."""
        return np.asarray(self.targets_m[0])


def scene_of(path: Any, opens_s: float) -> Scene:
    """Echoes of an aperture that opens at ``opens_s``, from the true positions of the antenna."""
    sar = simulated("world")
    radar = sar.Radar()
    pulse_s = opens_s + np.arange(round(APERTURE_s * radar.prf_Hz)) / radar.prf_Hz
    true_m, first = path.state(pulse_s).p, path.state(np.array([opens_s]))
    targets_m = sar.scene(radar, first.p[0], first.v[0])
    echoes = [sar.echoes(radar, true_m, some, np.ones(len(some))) for some in (targets_m[:1], targets_m)]
    about = radar.near_range_m, radar.spacing_m, radar.wavelength_m, radar.bandwidth_Hz
    one, several = (Pulses(gates, *about) for gates in echoes)
    return Scene(pulse_s, true_m, one, several, targets_m)


def image_result(task: Task, flown: Flown) -> ImageResult:
    """Focus the middle target with every run of every group that is imaged."""
    scene = scene_of(flown.path, task.duration_s - APERTURE_s)
    fine = flown.run.fine
    assert fine is not None
    groups = tuple(group for group in task.groups if group.noise == IMAGED)
    responses: list[list[tuple[Response, float]]] = []
    several_m, chips = [], list[Chip]()
    for group in groups:
        at = task.groups.index(group)
        search_m = scene.search_m(group.offset_s)
        responses.append([_focused(scene, _track(scene, fine, at, run), search_m) for run in range(task.runs)])
        track_m = _track(scene, fine, at, SHOWN_RUN)
        several = [impulse_response(scene.several, track_m, target_m, search_m) for target_m in scene.targets_m]
        several_m.append([response.azimuth.shift_m for response in several])
        chips.append(image_chip(scene.one, track_m, scene.target_m, half_azimuth_m=_CHIP_m))
    return ImageResult(
        flight=flight_result(task, flown),
        groups=groups,
        predicted_m=np.array([[predicted_m for _, predicted_m in row] for row in responses]),
        several_m=np.array(several_m),
        responses=tuple(row[SHOWN_RUN][0] for row in responses),
        chips=tuple(chips),
        **{
            name: np.array([[attrgetter(path)(response) for response, _ in row] for row in responses], np.float64)
            for name, path in FIGURES.items()
        },
    )


def _track(scene: Scene, fine: FineTrack, group: int, run: int) -> Floats:
    """Return where navigation says the antenna was at the pulses, (n, 3)."""
    return positions_at(scene.pulse_s, fine.t_s, fine.p[:, group, run], fine.v[:, group, run])


def _focused(scene: Scene, track_m: Floats, search_m: tuple[float, float]) -> tuple[Response, float]:
    response = impulse_response(scene.one, track_m, scene.target_m, search_m)
    return response, predicted_shift_m(scene.pulse_s, track_m, scene.true_m, scene.target_m)


def predicted_shift_m(pulse_s: Floats, track_m: Floats, true_m: Floats, target_m: Floats) -> float:
    """Shift along the track that the errors of a navigation solution explain, m.

    Along-track error in the middle of the aperture, minus range over speed times the error of the velocity along the
    line of sight (from the antenna to the target); both from a straight line through the errors of the positions.
    """
    middle_s = pulse_s.mean()
    slope, middle = np.polyfit(pulse_s - middle_s, track_m - true_m, 1)
    path_m, sight_m = true_m[-1] - true_m[0], target_m - true_m.mean(axis=0)
    speed_m_s = np.linalg.norm(path_m) / (pulse_s[-1] - pulse_s[0])
    along, sight = path_m / np.linalg.norm(path_m), sight_m / np.linalg.norm(sight_m)
    return float(middle @ along - np.linalg.norm(sight_m) / speed_m_s * (slope @ sight))


def ideal_result(task: Task) -> IdealResult:
    """Exact increments of the 60-second manoeuvres navigated, and a target focused with true positions."""
    manoeuvre = simulated("flight.path").manoeuvre
    off = [_distances(manoeuvre(name), task.duration_s) for name in FLOWN]
    scene = scene_of(manoeuvre("sar"), LONG_s - APERTURE_s)
    return IdealResult(
        position_m=max(position_m for position_m, _ in off),
        velocity_m_s=max(velocity_m_s for _, velocity_m_s in off),
        response=impulse_response(scene.one, scene.true_m, scene.target_m),
    )


def _distances(path: Any, duration_s: float) -> tuple[float, float]:
    """Return greatest distance of position, m, and velocity, m/s, over the flight."""
    t_s = np.arange(round(duration_s * _IMU_Hz) + 1) / _IMU_Hz
    true = path.state(t_s)
    dv, dtheta = simulated("flight.imu").exact_increments(path, t_s, LATITUDE_deg)
    north = np.eye(3)  # where all of them begin to head
    track: Track = navigate(t_s[1:], dv, dtheta, true.p[0], true.v[0], north, LATITUDE_deg)
    return _greatest(track.p - true.p[1:]), _greatest(track.v - true.v[1:])


def _greatest(difference: Floats) -> float:
    return float(np.linalg.norm(difference, axis=1).max())


def run_task(task: Task) -> FlightResult | ImageResult | IdealResult:
    """Return everything of a task: it depends on nothing but the task, and leaves nothing behind."""
    if task.kind == "ideal":
        return ideal_result(task)
    flown = fly(task)
    return image_result(task, flown) if task.kind == "image" else flight_result(task, flown)
