"""Estimates of a time offset before its first hour: the filters, on what perfect units would send on a planned motion.

Their covariances rest on the motion and on what is declared of both units, and on no sample. Where the scatter of
receive stamps is not declared, only the stated latencies count of them.
"""

from __future__ import annotations

import math

import numpy as np

from bench.analysis import PROMPT, Planned, Prediction
from bench.maths.arrays import Floats
from bench.maths.geodesy import TangentFrame, heading_matrices
from bench.maths.strapdown import earth_rate, gradient, normal_gravity
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.systems.time_sync.estimates import SyncResult, sync_estimates
from bench.systems.time_sync.estimators.kalman.innovation import observability
from bench.systems.time_sync.estimators.kalman.setup import EgiSamples, FilterSetup, ImuSamples
from bench.systems.time_sync.estimators.port_clocks import PortClock, StampNoise, clock_difference, expected_clock
from bench.systems.time_sync.filtering import METHODS, SEEN, filtered
from bench.systems.time_sync.limits import demands_of, densities_of, latency_of, spread_of
from bench.systems.time_sync.records import EGI, ITEM, RADAR, Clocks
from bench.systems.time_sync.samples import Prepared
from bench.systems.time_sync.wording import filter_name, say

_LINK, _TURN = "imu", ("turntable", "turn")
_DECLARED = ("inertial", "egi")


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a recording will give; the values are those of perfect units.

    Raises: FitError B-SYNC-003, -005, -006 as ``analysis.analyse``.
    """
    undeclared = [name for name in _DECLARED if name not in planned.campaign]
    if EGI in planned.campaign and "position_m" not in planned.campaign[EGI]:
        undeclared.append("egi: position")
    if undeclared:
        return Prediction([], [say("predicted.not_declared", sections=", ".join(undeclared))])
    if not _windows(planned):
        return Prediction([], [say("predicted.no_record")])
    result = _result(planned)
    unseen = {name: offset.normalised for name, offset in result.found.offsets.items() if not offset.seen}
    missing = [
        say("predicted.not_observable", method=filter_name(name), share=share, most=SEEN)
        for name, share in unseen.items()
    ]
    missing += [say("predicted.no_image")] if RADAR in planned.rates_Hz else []
    estimates = [
        entry
        for entry in sync_estimates(result)
        if entry.std_uncertainty > 0.0
        and not (entry.quantity == "time_offset" and entry.conditions["method"] in unseen)
    ]
    missing += [] if "stamps" in planned.campaign else [say("predicted.no_stamps")]
    return Prediction(estimates, missing)


def _result(planned: Planned) -> SyncResult:
    """Return what the analysis would find in samples without errors."""
    campaign = planned.campaign
    ready = planned_samples(planned)
    clocks = _clocks(planned, ready)
    spread = spread_of(campaign, float(campaign[EGI]["position_m"]))
    calls = [reading.t_s - _begin_s(planned) for reading in planned.readings if reading.arguments.get(RADAR) == "on"]
    found = filtered(ready, clocks, densities_of(campaign), spread, min(calls, default=math.inf))
    seen = observability(found.run.covariance, found.run.first_covariance)
    return SyncResult("", ready, clocks, found, seen, None, demands_of(campaign), METHODS[0])


def _clocks(planned: Planned, ready: Prepared) -> Clocks:
    """Return two clocks that agree; without declared scatter of stamps that of the latencies is all that is left."""
    latency, stamps = latency_of(planned.campaign), planned.campaign.get("stamps")
    noise = None if stamps is None else StampNoise(**stamps)
    ports = [
        PortClock(ready.middle_s, 0.0, 0.0, np.zeros((2, 2)), 0.0, 0.0, 0.0, 0.0, np.zeros(t_s.size))
        if noise is None
        else expected_clock(t_s, noise, planned.steps_s.get(link, 0.0))
        for link, t_s in ((_LINK, ready.imu.t_s), (EGI, ready.egi.t_s))
    ]
    std_s = 0.0 if latency is None else math.sqrt(2.0) * latency.std_s
    difference = clock_difference(ports[1], ports[0], ready.middle_s, 0.0, std_s)
    return Clocks(ports[0], ports[1], 0.0, difference, latency, 0.0, ready.imu.t_s, ready.egi.t_s)


def _windows(planned: Planned) -> list[RecordWindow]:
    return [window for window in planned.windows if window.conditions.get("item") == ITEM]


def _begin_s(planned: Planned) -> float:
    """Return the begin of the recording, from which the time of the units counts."""
    return _windows(planned)[0].t_start_ns / NS


def planned_samples(planned: Planned) -> Prepared:
    """Return increments and solutions of perfect units on the planned motion, in the tangent frame at its begin."""
    windows = _windows(planned)
    begin_s = _begin_s(planned)
    latitude_deg = float((planned.campaign.get("site") or {}).get("latitude_deg", FilterSetup((), ()).latitude_deg))
    step_s = 1.0 / planned.rates_Hz[_LINK]
    t_s = np.arange(0.0, windows[-1].t_end_ns / NS - begin_s + 0.5 * step_s, step_s)
    speed_m_s, along_m_s2, yaw_rate = _motion(planned, begin_s + 0.5 * (t_s[1:] + t_s[:-1]), step_s)
    yaw = _integral(yaw_rate, step_s)
    middle_yaw = 0.5 * (yaw[1:] + yaw[:-1])
    a = _along(middle_yaw, along_m_s2) + _along(middle_yaw + 0.5 * np.pi, speed_m_s * yaw_rate)
    v = _integral(a, step_s) + _along(yaw[:1], speed_m_s[:1])
    p = _integral(0.5 * (v[1:] + v[:-1]), step_s)
    gravity = np.array([0.0, 0.0, normal_gravity(latitude_deg)]) + gradient(latitude_deg) * p[1:]
    turn = earth_rate(latitude_deg)
    force = a - gravity + 2.0 * np.cross(turn, 0.5 * (v[1:] + v[:-1]))
    C = heading_matrices(middle_yaw)
    rate = turn @ C
    rate[:, 2] += yaw_rate
    imu = ImuSamples(
        t_s[1:],
        np.einsum("nji,nj->ni", C, force)[:, None] * step_s,
        rate[:, None] * step_s,
        np.zeros(t_s.size - 1, np.bool_),
    )
    at_s = np.arange(t_s[1], t_s[-1], 1.0 / planned.rates_Hz[EGI])
    place, speed = (np.stack([np.interp(at_s, t_s, axis) for axis in values.T], axis=1) for values in (p, v))
    egi = EgiSamples(at_s, place, speed, heading_matrices(np.interp(at_s, t_s, yaw)), TangentFrame(latitude_deg, 0.0),
                     float(planned.campaign[EGI]["position_m"]))  # fmt: skip
    return Prepared(imu, egi, 0, 0, 0, 0)


def _motion(planned: Planned, t_s: Floats, step_s: float) -> tuple[Floats, Floats, Floats]:
    """Return speed (m/s), acceleration along the track (m/s^2) and yaw rate (rad/s, to the right), (n,) each, at t_s.

    A person sets speed and acceleration by prompts; the table turns clockwise by a negative angle.
    """
    speed_m_s, along_m_s2, yaw_rate = (np.zeros(t_s.size) for _ in range(3))
    for reading in planned.readings:
        since, arguments = t_s >= reading.t_s, reading.arguments
        if reading.name == PROMPT and "speed" in arguments:
            speed_m_s[:] = float(arguments["speed"])
        if reading.name == PROMPT and "acceleration" in arguments:
            along_m_s2[since] = float(arguments["acceleration"])
        if (reading.role, reading.name) == _TURN:
            angle, rate = math.radians(float(arguments["angle"])), math.radians(float(arguments["rate"]))
            yaw_rate[since & (t_s < reading.t_s + abs(angle) / rate)] = -math.copysign(rate, angle)
    return speed_m_s + np.cumsum(along_m_s2) * step_s, along_m_s2, yaw_rate


def _integral(values: Floats, step_s: float) -> Floats:
    """Return the integral of means over steps, (n, ...), at all n + 1 ends, from zero on."""
    return np.concatenate((np.zeros_like(values[:1]), np.cumsum(values, axis=0) * step_s))


def _along(yaw: Floats, size: Floats) -> Floats:
    """Return level vectors of these sizes in the direction of a yaw, (n, 3)."""
    return np.asarray(size[:, None] * np.stack((np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)), axis=1))
