"""Campaigns of a north finder as they are planned, by a physics of its own: one sine per turn, white noise, lock-ins as
the weighted mean that their filters take, a table that swings, a mark that is not quite where it should be.

Nothing here comes from the product's simulators, and no noise is estimated.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import factorial

import numpy as np
from doubt_north import record_row
from numpy.typing import NDArray

from bench.analysis import Estimates, Material, Planned, Reading
from bench.record import RecordRow
from bench.systems.north.analysis import north_estimates
from bench.systems.north.sets import north_sets
from bench.systems.north.solution import Solution, accuracies
from bench.systems.north.solve import site_of, solve

Float = NDArray[np.float64]
LIMIT_DEG = 1.0
EARTH_DEG_H = 15.041067  # 7.292115e-5 rad/s
INDEX_DEG = {"lock_in_1": 270.0, "lock_in_2": 0.0}
PLACEMENT_DEG = 0.1  # of an index mark, standard deviation
_VARIATION, _SLOW_Hz = 0.2, 0.0317  # of an amplitude that varies
_SWINGS, _MEMORY = 7, 16.0  # swings per turn; time constants after which 1e-4 of a step is left


class PlannedNorth:
    """Campaigns of a plan. ``planned``: of a table at one rate, whose lock-ins are configured alike."""

    def __init__(self, planned: Planned) -> None:
        self.planned = planned
        fog, site = planned.campaign["fog"], planned.campaign["site"]
        self.rate_Hz = float(planned.campaign["rate_Hz"])
        self.mark_deg, self.mark_std_deg = float(site["azimuth_deg"]), float(site["azimuth_std_deg"])
        earth_deg_h = EARTH_DEG_H * float(np.cos(np.deg2rad(site["latitude_deg"])))
        self.amplitude_V = fog["output_V_per_deg_h"] * earth_deg_h
        per_sample_deg_h = fog["angle_walk_deg_rth"] * 60.0 * self.rate_Hz**0.5  # deg/rt-h = 60 deg/h/rt-Hz
        self.noise_V = fog["output_V_per_deg_h"] * per_sample_deg_h
        self.swing_deg = fog["table_swing_deg"]
        (settings,) = {tuple(sorted(each.arguments.items())) for each in planned.readings if each.name == "configure"
                       and each.role.startswith("lock_in")}  # fmt: skip
        self.weights = weights(dict(settings), self.rate_Hz)

    def campaigns(self, count: int, seed: int) -> Iterator[tuple[Estimates, dict[str, float], set[str]]]:
        """Yield the estimates of one campaign after the other, what is true of it in degrees, and its false alarms."""
        rng = np.random.default_rng(seed)
        for _ in range(count):
            material, truth = self.campaign(rng)
            solution = solve(north_sets(material), site_of(material.campaign))
            estimates = north_estimates(solution, "least_squares", accuracies(solution, LIMIT_DEG), LIMIT_DEG)
            yield estimates, truth, alarms(solution)

    def campaign(self, rng: np.random.Generator) -> tuple[Material, dict[str, float]]:
        """Return what one campaign records, and what is true: mark, field, placements of the index marks b and a."""
        truth = {"mark": self.mark_deg + rng.normal(0.0, self.mark_std_deg), "field": rng.uniform(0.0, 360.0)}
        truth |= {role: rng.normal(0.0, PLACEMENT_DEG) for role in INDEX_DEG}
        rows: list[RecordRow] = []
        readings: list[Reading] = []
        started: tuple[object, ...] = ()
        for window in self.planned.windows:
            about = window.conditions
            if started != (started := (about["item"], about["place"], about["head_deg"], about.get("parameters"))):
                phase = rng.uniform(0.0, 2.0 * np.pi)  # of the swing at the index: another one after each start
            axis_deg = truth[about["place"]] + about["head_deg"]
            end_s = 1e-9 * window.t_end_ns
            t_s = end_s - (np.arange(self.weights.size)[::-1] + 0.5) / self.rate_Hz
            turned_deg = np.sign(about["rate_deg_s"]) * abs(about["rate_deg_s"]) * t_s
            swing_deg = np.sqrt(2.0) * self.swing_deg * np.sin(np.deg2rad(_SWINGS * turned_deg) + phase)
            theta_deg = turned_deg + swing_deg
            varies = _VARIATION * np.sin(2.0 * np.pi * _SLOW_Hz * t_s) if about.get("parameters") == "TVP" else 0.0
            u_V = self.amplitude_V * (1.0 + varies) * np.cos(np.deg2rad(axis_deg - theta_deg))
            u_V += rng.normal(0.0, self.noise_V, t_s.size)
            recorded = round((window.t_end_ns - window.t_start_ns) * 1e-9 * self.rate_Hz)
            rows.append(
                record_row(end_s - recorded / self.rate_Hz, rows, u_V[-recorded:], theta_deg[-recorded:], dict(about),
                           self.rate_Hz)
            )  # fmt: skip
            late_deg = np.sqrt(2.0) * self.swing_deg * np.sin(phase)
            for role, pulse_deg in INDEX_DEG.items():
                passed_deg = pulse_deg + truth[role] - late_deg  # a table that is ahead passes the mark early
                angle = np.deg2rad(turned_deg - passed_deg - 90.0 * (about["index"] - 1))
                x_V = float(self.weights @ (np.sqrt(2.0) * np.sin(angle) * u_V))
                readings.append(Reading(end_s, len(readings), role, "measure", {"x_V": x_V}, dict(about)))
        return Material(rows, self.planned.campaign, {}, readings=readings), truth


def alarms(solution: Solution) -> set[str]:
    """Return the methods whose noise, white here, is taken for something else."""
    coloured = any(waveform is not None and bool(waveform.widened) for waveform in solution.raw)
    taken = {
        "least_squares": solution.unsteady,
        "likelihood": coloured or bool(np.isfinite(solution.by_method["likelihood"].dof)),
        "quadrant": solution.by_method["quadrant"].calibration == 0.0,
    }
    return {method for method, alarm in taken.items() if alarm}


def weights(settings: dict[str, object], rate_Hz: float) -> Float:
    """Share of each sample in X at the end, (n,), the newest last: the poles' gamma density, behind a mean of 1 s."""
    time_constant_s, poles = float(str(settings["time_constant"])), int(str(settings["slope"])) // 6
    ages = (np.arange(round(_MEMORY * time_constant_s * rate_Hz)) + 0.5) / rate_Hz / time_constant_s
    density = ages ** (poles - 1) * np.exp(-ages) / factorial(poles - 1)
    if settings.get("synchronous") == "on":
        density = np.convolve(density, np.full(round(rate_Hz), 1.0 / round(rate_Hz)))
    return np.asarray(density[::-1] / density.sum())
