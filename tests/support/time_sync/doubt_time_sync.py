"""Wrong worlds of a time offset: what the model says of two units on one vehicle is not so, by a stated size."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from coverage_blocks import in_right_world
from doubt_classes import PROVENANCE, Seen, Switch, changed
from sync_physics import DRIFT, IMU_CLOCK, TURNING, LONG_s, OFFSET_s, Recording, Solutions, World, in_body

from bench.analysis import build_results, estimates_of
from bench.systems.time_sync.analysis import analyse

Array = Any
SYSTEM = "time_sync"
JUDGED = ("time_offset", "time_offset_from_stamps", "time_offset_drift", "clock_rate")


wrong = partial(changed, World)


def ages(of: Callable[[World, Array], Array]) -> type[World]:
    """Solutions are older than their tags, all of them alike."""
    return wrong(age_s=lambda w, t_s: (of(w, t_s),) * 3)


def old_velocity(w: World, t_s: Array) -> tuple[Array, Array, Array]:
    """It is smoothed in the EGI: older than position and attitude."""
    return 0.0 * t_s, np.full_like(t_s, w.size), 0.0 * t_s


def turned_axes(w: World, solutions: Solutions) -> None:
    """The axes of the EGI are turned against those of the inertial unit, about all three, in degrees."""
    _, _, yaw = TURNING.motion(solutions.valid_s)
    solutions.tilt_rad += in_body(np.radians(w.size) * np.ones((len(yaw), 3)), -yaw)


def scaled(dv_too: bool) -> Any:
    def increments(w: World, dv: Array, dtheta: Array, _: Array) -> None:
        changed = dv if dv_too else dtheta
        changed *= 1.0 + w.size

    return increments


def one_bad_solution(w: World, solutions: Solutions) -> None:
    """One position is off, as a frame is that got past its check."""
    solutions.position_m[120] += w.size


def bad_burst(w: World, solutions: Solutions) -> None:
    """For half a second the EGI has lost its satellites, and says nothing about it."""
    solutions.position_m[100:107] += w.size * np.array([1.0, -1.0, 0.0])


def frozen(w: World, solutions: Solutions) -> None:
    """The EGI sends the same solution again and again, for a part of the recording in the turn."""
    first = len(solutions.valid_s) // 2
    held = slice(first, first + max(2, round(w.size * len(solutions.valid_s))))
    for values in (solutions.position_m, solutions.velocity_m_s, solutions.tilt_rad):
        values[held] = values[first]


def one_bad_increment(w: World, dv: Array, dtheta: Array, t_s: Array) -> None:
    dv[350, 1] += w.size


MIDDLE_s = 0.5 * LONG_s
SWITCHES = (
    Switch(
        "solutions_older_than_tags",
        ages(lambda w, t_s: np.full_like(t_s, w.size)),
        (1e-3, 5e-3, 3e-2),
        "latency_as_stated",
    ),  # a constant latency that nobody stated
    Switch(
        "latency_not_as_stated",
        wrong(egi_arrival_s=lambda w, t_s: np.full_like(t_s, w.size)),
        (1e-3, 5e-3, 3e-2),
        "latency_as_stated",
    ),
    Switch("age_steps", ages(lambda w, t_s: w.size * (t_s > MIDDLE_s)), (3e-4, 3e-3, 3e-2), "one_offset"),
    Switch("age_drifts", ages(lambda w, t_s: w.size * (t_s - MIDDLE_s)), (1e-5, 1e-4, 1e-3), "one_offset"),
    Switch("velocity_older", wrong(age_s=old_velocity), (1e-3, 1e-2, 1e-1)),
    # the EGI sits off the inertial unit, forward and to the right
    Switch("lever_arm", wrong(lever_m=lambda w: w.size * np.array([1.0, 0.5, 0.0])), (0.1, 1.0, 10.0)),
    Switch("axes_turned", wrong(sent=turned_axes), (1e-3, 1e-2, 1e-1)),
    Switch("gyro_scale", wrong(increments=scaled(False)), (1e-5, 1e-4, 1e-3)),
    Switch("accelerometer_scale", wrong(increments=scaled(True)), (1e-4, 1e-3, 1e-2)),
    Switch("one_bad_solution", wrong(sent=one_bad_solution), (0.1, 10.0, 1e4)),
    Switch("bad_burst", wrong(sent=bad_burst), (0.1, 3.0, 100.0)),
    Switch("frozen_solutions", wrong(sent=frozen), (0.001, 0.01, 0.1)),
    Switch("one_bad_increment", wrong(increments=one_bad_increment), (1e-3, 1e-1, 10.0)),
    # the line is too slow, each frame waits longer than the one before; in the middle frames take another way
    Switch("line_fills", wrong(egi_arrival_s=lambda w, t_s: w.size * t_s), (1e-6, 1e-4, 1e-2), "steady_delay"),
    Switch(
        "line_switches",
        wrong(egi_arrival_s=lambda w, t_s: w.size * (t_s > MIDDLE_s)),
        (1e-4, 1e-3, 1e-2),
        "steady_delay",
    ),
    Switch("larger_errors", wrong(errors=lambda w: w.size), (1.3, 2.0, 5.0), "errors_as_stated"),  # of a worse class
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one recording states and its truth; without a switch that of the same seed in a right world."""
    world = World() if switch is None else switch.world(size)
    analysis = analyse(Recording(seed, world, not noise_free).material())
    document = build_results("doubt", analysis, {"records": 1}, PROVENANCE)
    wanted = [entry for entry in estimates_of(document) if entry.quantity in JUDGED]
    (fit,) = analysis.groups
    chi2 = fit["reduced_chi2"] * fit["dof"]
    return Seen(wanted, [truth_of(entry) for entry in wanted], chi2, 6)


def truth_of(entry: Any) -> float:
    """Return what an estimate should be: clock of the EGI minus that of the inertial unit, and rates of clocks."""
    if entry.quantity == "time_offset_drift":
        return 1e6 * DRIFT / (1.0 - DRIFT)
    if entry.quantity == "clock_rate":
        return 1e6 * IMU_CLOCK if entry.conditions["link"] == "imu" else 1e6 * (IMU_CLOCK + DRIFT)
    return OFFSET_s


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth."""
    right = seen(seed, None, 0.0)
    return in_right_world(right.entries, right.truths)
