"""Wrong worlds of a time offset: what the model says of two units on one vehicle is not so, by a stated size."""

from __future__ import annotations

from typing import Any

import numpy as np
from doubt_classes import Seen, Switch
from sync_physics import DRIFT, IMU_CLOCK, TURNING, LONG_s, OFFSET_s, Recording, Solutions, World, in_body

from bench.analysis import build_results
from bench.systems.time_sync.analysis import analyse

Array = Any
SYSTEM = "time_sync"
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "doubt"}
JUDGED = ("time_offset", "time_offset_from_stamps", "time_offset_drift", "clock_rate")


class OldSolutions(World):
    """The EGI tags its solutions too late: a constant latency that nobody stated."""

    def age_s(self, t_s: Array) -> tuple[Array, Array, Array]:
        age = np.full_like(t_s, self.size)
        return age, age, age


class StatedLatency(World):
    """The EGI waits longer before it sends than its maker says."""

    def egi_arrival_s(self, t_s: Array) -> Array:
        return np.full_like(t_s, self.size)


class AgeSteps(World):
    """In the middle of the turn the EGI begins to send older solutions."""

    def age_s(self, t_s: Array) -> tuple[Array, Array, Array]:
        age = self.size * (t_s > 0.5 * LONG_s)
        return age, age, age


class AgeDrifts(World):
    """Solutions become older all the time, by ``size`` in a second."""

    def age_s(self, t_s: Array) -> tuple[Array, Array, Array]:
        age = self.size * (t_s - 0.5 * LONG_s)
        return age, age, age


class OldVelocity(World):
    """Velocity is smoothed in the EGI: older than position and attitude."""

    def age_s(self, t_s: Array) -> tuple[Array, Array, Array]:
        none = np.zeros_like(t_s)
        return none, np.full_like(t_s, self.size), none


class LeverArm(World):
    """The EGI sits off the inertial unit, forward and to the right."""

    def lever_m(self) -> Array:
        return self.size * np.array([1.0, 0.5, 0.0])


class Axes(World):
    """The axes of the EGI are turned against those of the inertial unit, about all three, in degrees."""

    def sent(self, solutions: Solutions) -> None:
        _, _, yaw = TURNING.motion(solutions.valid_s)
        body = np.radians(self.size) * np.array([1.0, 1.0, 1.0]) * np.ones((len(yaw), 1))
        solutions.tilt_rad += in_body(body, -yaw)


class GyroScale(World):
    def increments(self, dv: Array, dtheta: Array, t_s: Array) -> None:
        dtheta *= 1.0 + self.size


class AccelerometerScale(World):
    def increments(self, dv: Array, dtheta: Array, t_s: Array) -> None:
        dv *= 1.0 + self.size


class OneBadSolution(World):
    """One position is off, as a frame is that got past its check."""

    def sent(self, solutions: Solutions) -> None:
        solutions.position_m[120] += self.size


class BadBurst(World):
    """For half a second the EGI has lost its satellites, and says nothing about it."""

    def sent(self, solutions: Solutions) -> None:
        solutions.position_m[100:107] += self.size * np.array([1.0, -1.0, 0.0])


class FrozenSolutions(World):
    """The EGI sends the same solution again and again, for a part of the recording in the turn."""

    def sent(self, solutions: Solutions) -> None:
        first = len(solutions.valid_s) // 2
        frozen = slice(first, first + max(2, round(self.size * len(solutions.valid_s))))
        for values in (solutions.position_m, solutions.velocity_m_s, solutions.tilt_rad):
            values[frozen] = values[first]


class OneBadIncrement(World):
    def increments(self, dv: Array, dtheta: Array, t_s: Array) -> None:
        dv[350, 1] += self.size


class LineFills(World):
    """The line from the EGI is too slow: each frame waits longer than the one before, by ``size`` in a second."""

    def egi_arrival_s(self, t_s: Array) -> Array:
        return self.size * t_s


class LineSwitches(World):
    """In the middle the frames of the EGI begin to take another way."""

    def egi_arrival_s(self, t_s: Array) -> Array:
        return self.size * (t_s > 0.5 * LONG_s)


class LargerErrors(World):
    """The EGI is of a worse class than the sequence says."""

    def errors(self) -> float:
        return self.size


SWITCHES = (
    Switch("solutions_older_than_tags", OldSolutions, (1e-3, 5e-3, 3e-2), "latency_as_stated"),
    Switch("latency_not_as_stated", StatedLatency, (1e-3, 5e-3, 3e-2), "latency_as_stated"),
    Switch("age_steps", AgeSteps, (3e-4, 3e-3, 3e-2), "one_offset"),
    Switch("age_drifts", AgeDrifts, (1e-5, 1e-4, 1e-3), "one_offset"),
    Switch("velocity_older", OldVelocity, (1e-3, 1e-2, 1e-1), "one_age"),
    Switch("lever_arm", LeverArm, (0.1, 1.0, 10.0), "one_place"),
    Switch("axes_turned", Axes, (1e-3, 1e-2, 1e-1), "same_axes"),
    Switch("gyro_scale", GyroScale, (1e-5, 1e-4, 1e-3), "scales_of_inertial_unit"),
    Switch("accelerometer_scale", AccelerometerScale, (1e-4, 1e-3, 1e-2), "scales_of_inertial_unit"),
    Switch("one_bad_solution", OneBadSolution, (0.1, 10.0, 1e4)),
    Switch("bad_burst", BadBurst, (0.1, 3.0, 100.0)),
    Switch("frozen_solutions", FrozenSolutions, (0.001, 0.01, 0.1)),
    Switch("one_bad_increment", OneBadIncrement, (1e-3, 1e-1, 10.0)),
    Switch("line_fills", LineFills, (1e-6, 1e-4, 1e-2), "steady_delay"),
    Switch("line_switches", LineSwitches, (1e-4, 1e-3, 1e-2), "steady_delay"),
    Switch("larger_errors", LargerErrors, (1.3, 2.0, 5.0), "errors_as_stated"),
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one recording states and its truth; without a switch that of the same seed in a right world."""
    world = World() if switch is None else switch.world(size)
    analysis = analyse(Recording(seed, world, not noise_free).material())
    document = build_results("doubt", analysis, {"records": 1}, PROVENANCE)
    wanted = [entry for entry in document["estimates"] if entry["quantity"] in JUDGED]
    (fit,) = analysis.groups
    chi2, dof = fit["reduced_chi2"] * fit["dof"], fit["dof"]
    for entry in analysis.estimates:
        if entry["quantity"] == "stamps_difference":
            chi2, dof = chi2 + (entry["value"] / entry["std_uncertainty"]) ** 2, dof + 1
    return Seen(wanted, [truth_of(entry) for entry in wanted], chi2, dof, 6)


def truth_of(entry: Any) -> float:
    """Return what an estimate should be: clock of the EGI minus that of the inertial unit, and rates of clocks."""
    if entry["quantity"] == "time_offset_drift":
        return 1e6 * DRIFT / (1.0 - DRIFT)
    if entry["quantity"] == "clock_rate":
        return 1e6 * IMU_CLOCK if entry["conditions"]["link"] == "imu" else 1e6 * (IMU_CLOCK + DRIFT)
    return OFFSET_s
