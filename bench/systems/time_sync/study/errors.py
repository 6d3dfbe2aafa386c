"""Effect on navigation of an offset that nobody compensates: Tables 5 to 7 of the paper, and the biases.

Offset as the augmented filter finds it, cases where it must not find any, and what it believes of itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench.analysis import Estimate, Estimates
from bench.maths.arrays import rms
from bench.systems.time_sync.study.study import (
    ANY,
    AUGMENTED,
    BASE,
    FLOWN,
    LOOSE,
    TIGHT,
    ACCELERATION_m_s2,
    FlightResult,
    Group,
    MANOEUVRE_s,
    RECOVERED_ms,
    Results,
    SETTLED_s,
    SHORT_s,
    SHOWN_ms,
    SPEED_m_s,
    VELOCITY_m_s,
    YAW_deg,
    measured,
    rms_std,
)

AXES, BODY = ("north", "east", "down"), ("forward", "right", "down")
_POSITION_WITHIN = {10.0: 0.05, 20.0: 0.03, 30.0: 0.02}  # of the root sum of squares
_POSITION_0_m, _YAW_0_deg = (0.2, 0.45), (0.009, 0.020)
_MEAN_m, _VELOCITY_WITHIN, _YAW_WITHIN, _SAME, _UNAFFECTED = 0.15, (0.75, 1.15), 0.10, 0.01, 0.02
_MEAN_ms, _RMS_ms, _LEFT, _NEES, _NEES_MOST = 0.5, 1.0, 0.9, (0.3, 3.0), 3.0
_SOON_s, _NEES_AT_s = MANOEUVRE_s[0] + 2.0, 100.0
SEEN_s = 22.0  # where the observability of the manoeuvres is compared


def error_estimates(results: Results, offsets_ms: Sequence[float]) -> Estimates:
    """All that the unaugmented filter leaves, judged where the paper or the equations say what is due."""
    makers: tuple[Callable[[Results, float], Estimates], ...] = (_position, _velocity, _yaw, _stationary, _biases)
    return [entry for make in makers for offset_ms in offsets_ms for entry in make(results, offset_ms)]


def over_time(flight: FlightResult, name: str, group: Group, axis: int, between_s: tuple[float, float]) -> float:
    """RMS of an error over the runs and a stretch of time."""
    rows = flight.rms[name][flight.during(*between_s), flight.at(group), axis]
    return rms(rows)


def greatest(flight: FlightResult, name: str, group: Group, axis: int) -> float:
    """Greatest RMS over the runs after the first seconds."""
    return float(flight.rms[name][flight.t_s > SETTLED_s, flight.at(group), axis].max())


def mean_error(flight: FlightResult, name: str, group: Group, between_s: tuple[float, float]) -> float:
    """Mean of an error along north over the runs and a stretch of time."""
    return float(flight.mean[name][flight.during(*between_s), flight.at(group), 0].mean())


def after_s(flight: FlightResult) -> tuple[float, float]:
    """Return everything but the first seconds."""
    return SETTLED_s, float(flight.t_s[-1])


def about(due: float, share: float) -> tuple[float, float]:
    """Return ends of a tolerance on both sides of what is due."""
    return (1 - share) * due, (1 + share) * due


def _position(results: Results, offset_ms: float) -> Estimates:
    """Table 5: RMS over runs and time; the offset adds its square, and its mean shows the sign.

    The 50 runs alone have a mean of some 0.04 m, which an offset of 10 ms turns into 4 % of the RMS: the due value is
    that of the same runs, and the ratio to sqrt(RMS0^2 + (v T_d)^2) stands beside it.
    """
    flight, group = results.flight("linear", augmented=False), Group(offset_ms)
    between_s, n = after_s(flight), flight.runs
    rms_m, rms_0_m = (over_time(flight, "position_m", one, 0, between_s) for one in (group, Group(0.0)))
    conditions = group.where("linear", axis="north")
    std_m = rms_std(rms_0_m, n)
    if offset_ms == 0.0:
        return [measured("position_rms", "m", rms_m, std_m, conditions, n=n, within=_POSITION_0_m)]
    lag_m = SPEED_m_s * offset_ms * 1e-3
    mean_0_m = mean_error(flight, "position_m", Group(0.0), between_s)
    due_m = float(np.sqrt(rms_0_m**2 - 2.0 * mean_0_m * lag_m + lag_m**2))  # of these runs, whose mean is not quite 0
    within = about(due_m, _POSITION_WITHIN.get(offset_ms, math.inf))
    mean_m = mean_error(flight, "position_m", group, between_s)
    mean_within = -lag_m - _MEAN_m, -lag_m + _MEAN_m
    return [
        measured("position_rms", "m", rms_m, std_m, conditions, n=n, within=within),
        measured("position_rms_ratio", "1", rms_m / float(np.hypot(rms_0_m, lag_m)), 0.0, conditions, n=n),
        measured("position_mean", "m", mean_m, float(rms_0_m / np.sqrt(n)), conditions, n=n, within=mean_within),
    ]


def _velocity(results: Results, offset_ms: float) -> Estimates:
    """Table 6: greatest RMS over runs, and the lag behind the acceleration."""
    flight, group = results.flight("acceleration", augmented=False), Group(offset_ms)
    rms_m_s = greatest(flight, "velocity_m_s", group, 0)
    conditions = group.where("acceleration", axis="north")
    std_m_s = rms_std(greatest(flight, "velocity_m_s", Group(0.0), 0), flight.runs)
    if offset_ms == 0.0:
        return [measured("velocity_rms_max", "m/s", rms_m_s, std_m_s, conditions, n=flight.runs)]
    low, high = (share * VELOCITY_m_s.get(offset_ms, math.inf) for share in _VELOCITY_WITHIN)
    step_m_s = -ACCELERATION_m_s2 * offset_ms * 1e-3
    lag = mean_error(flight, "velocity_m_s", group, MANOEUVRE_s) / step_m_s
    return [
        measured("velocity_rms_max", "m/s", rms_m_s, std_m_s, conditions, n=flight.runs, within=(low, high)),
        measured("velocity_lag", "1", lag, std_m_s / abs(step_m_s), conditions, n=flight.runs),
    ]


def _yaw(results: Results, offset_ms: float) -> Estimates:
    """Table 7: greatest RMS over runs."""
    flight, group = results.flight("turn", augmented=False), Group(offset_ms)
    rms_deg = greatest(flight, "attitude_deg", group, 2)
    std_deg = rms_std(greatest(flight, "attitude_deg", Group(0.0), 2), flight.runs)
    within = about(YAW_deg.get(offset_ms, math.inf), _YAW_WITHIN) if offset_ms else _YAW_0_deg
    conditions = group.where("turn", axis="down")
    return [measured("yaw_rms_max", "deg", rms_deg, std_deg, conditions, n=flight.runs, within=within)]


def _ratio(flight: FlightResult, name: str, group: Group, axis: int, at_s: tuple[float, float]) -> float:
    """RMS error with an offset over that without one, of the same runs."""
    without = over_time(flight, name, replace(group, offset_ms=0.0), axis, at_s)
    return over_time(flight, name, group, axis, at_s) / without


def _stationary(results: Results, offset_ms: float) -> Estimates:
    """Figure 3: who does not move does not notice."""
    if offset_ms == 0.0:
        return []
    flight, group = results.flight("stationary", augmented=False), Group(offset_ms)
    return [
        measured(
            "position_rms_ratio", "1", _ratio(flight, "position_m", group, axis, after_s(flight)), 0.0,
            group.where("stationary", axis=name), n=flight.runs, within=about(1.0, _SAME),
        )
        for axis, name in enumerate(AXES)
    ]  # fmt: skip


def _biases(results: Results, offset_ms: float) -> Estimates:
    """Figures 5 to 7: biases during the manoeuvre with tight noise, and those that the offset does not reach."""
    documents: Estimates = []
    for manoeuvre, untouched in UNTOUCHED.items():
        flight, group = results.flight(manoeuvre, augmented=False), Group(offset_ms, noise=TIGHT)
        for name, unit in (("accel_bias_ug", "ug"), ("gyro_bias_deg_h", "deg/h")):
            for axis, place in enumerate(BODY):
                rms = over_time(flight, name, group, axis, MANOEUVRE_s)
                conditions = group.where(manoeuvre, axis=place, noise=TIGHT)
                quantity = f"{name.rpartition('_bias')[0]}_bias_rms"
                documents.append(measured(quantity, unit, rms, rms_std(rms, flight.runs), conditions, n=flight.runs))
                if offset_ms and (name, axis) in untouched:
                    ratio, within = _ratio(flight, name, group, axis, MANOEUVRE_s), about(1.0, _UNAFFECTED)
                    documents.append(
                        measured(f"{quantity}_ratio", "1", ratio, 0.0, conditions, n=flight.runs, within=within)
                    )
    return documents


UNTOUCHED: dict[str, tuple[tuple[str, int], ...]] = {
    "acceleration": tuple(("gyro_bias_deg_h", axis) for axis in range(3)),
    "turn": (("accel_bias_ug", 2),),
}


def recovery_estimates(results: Results, offsets_ms: tuple[float, ...]) -> Estimates:
    """Recovered offsets by manoeuvre, consistency, observability."""
    return [
        *_found_in(results, "turn", (_SOON_s, MANOEUVRE_s[1], SHORT_s), judged=True),
        *_straight(results),
        *_found_in(results, "acceleration", (_SOON_s, SHORT_s), judged=False),
        *_long(results, offsets_ms),
        *_observability(results),
    ]


def near(flight: FlightResult, at_s: float) -> int:
    """Index of the epoch next to a time."""
    return int(np.argmin(np.abs(flight.t_s - at_s)))


def _remaining(flight: FlightResult, group: Group, manoeuvre: str, at_s: float, *, judged: bool) -> Estimates:
    """Return mean and RMS error of the offset at a time."""
    at, column = near(flight, at_s), flight.at(group)
    conditions = group.where(manoeuvre, noise=group.noise, at_s=at_s)
    mean_ms, rms_ms = 1e3 * flight.offset_mean_s[at, column], 1e3 * flight.offset_rms_s[at, column]
    std_ms = float(np.sqrt(max(rms_ms**2 - mean_ms**2, 0.0) / flight.runs))
    mean, most = ((-_MEAN_ms, _MEAN_ms), (-math.inf, _RMS_ms)) if judged else (ANY, ANY)
    n = flight.runs
    return [
        measured("offset_error_mean", "ms", float(mean_ms), std_ms, conditions, n=n, within=mean),
        measured("offset_error_rms", "ms", float(rms_ms), rms_std(float(rms_ms), n), conditions, n=n, within=most),
    ]


def _found_in(results: Results, manoeuvre: str, times_s: Sequence[float], *, judged: bool) -> Estimates:
    """Errors that are left of every offset at some times; the turn finds it, whatever it is."""
    flight = results.flight(manoeuvre, augmented=True)
    return [
        entry
        for offset_ms in RECOVERED_ms
        for at_s in times_s
        for entry in _remaining(flight, Group(offset_ms, augmented=True), manoeuvre, at_s, judged=judged)
    ]


def _straight(results: Results) -> Estimates:
    """Straight and level flight cannot tell an offset from a distance: a filter that converges has seen the truth."""
    flight = results.flight("linear", augmented=True)
    documents: Estimates = []
    for offset_ms in RECOVERED_ms:
        group = Group(offset_ms, augmented=True)
        column, conditions = flight.at(group), group.where("linear", noise=BASE, at_s=SHORT_s)
        rms_ms, nees = float(1e3 * flight.offset_rms_s[-1, column]), float(flight.offset_nees[-1, column])
        within = (_LEFT * abs(offset_ms), math.inf) if offset_ms else ANY
        std_ms, most = rms_std(rms_ms, flight.runs), (-math.inf, _NEES_MOST)
        documents.append(measured("offset_error_rms", "ms", rms_ms, std_ms, conditions, n=flight.runs, within=within))
        documents.append(measured("offset_nees", "1", nees, 0.0, conditions, n=flight.runs, within=most))
    return [*documents, _straight_consistency(flight)]


def _straight_consistency(flight: FlightResult) -> Estimate:
    """NEES over all offsets: a single one is as small as its offset is against the 30 ms at the begin, their mean not.

    Too small a mean is a filter that has seen the truth, or one that doubts more than it was told to.
    """
    columns = [flight.at(Group(offset_ms, augmented=True)) for offset_ms in RECOVERED_ms]
    nees, n = float(flight.offset_nees[-1, columns].mean()), flight.runs * len(columns)
    conditions = {"manoeuvre": "linear", "filter": AUGMENTED, "noise": BASE, "at_s": SHORT_s}
    return measured("offset_nees_over_offsets", "1", nees, 0.0, conditions, n=n, within=_NEES)


def _long(results: Results, offsets_ms: tuple[float, ...]) -> Estimates:
    """Return the flight with images: after its turn, and whether the filter knows how well it does."""
    documents: Estimates = []
    for offset_ms in offsets_ms:
        for noise in (LOOSE, TIGHT):
            group = Group(offset_ms, augmented=True, noise=noise)
            flight, column = results.long_flight(group)
            conditions = group.where("sar", noise=noise, at_s=_NEES_AT_s)
            documents += _remaining(flight, group, "sar", _NEES_AT_s, judged=noise == LOOSE)
            at, within = near(flight, _NEES_AT_s), _NEES if noise == LOOSE else ANY
            nees = float(flight.offset_nees[at, column])
            std = nees * float(np.sqrt(2.0 / flight.runs))
            documents.append(measured("offset_nees", "1", nees, std, conditions, n=flight.runs, within=within))
            for name, value, unit in (
                ("nis_ratio", float(flight.nis_ratio[column]), "1"),
                ("nis_outside", float(flight.nis_outside[column]), "1"),
                ("offset_sigma", float(1e3 * flight.offset_sigma_s[at, column]), "ms"),
            ):
                documents.append(measured(name, unit, value, 0.0, conditions, n=flight.runs))
    return documents


def _observability(results: Results) -> Estimates:
    """Figure 16, at a time instead of over the whole flight."""
    documents: Estimates = []
    for manoeuvre in FLOWN:
        flight = results.flight(manoeuvre, augmented=True)
        group = Group(SHOWN_ms, augmented=True)
        at, column = near(flight, SEEN_s), flight.at(group)
        conditions = group.where(manoeuvre, noise=BASE, at_s=SEEN_s)
        whole = rms(flight.eigenvalue[:, column])
        for quantity, value, where in (
            ("offset_eigenvalue", float(flight.eigenvalue[at, column]), conditions),
            ("offset_variance_ratio", float(flight.share[at, column]), conditions),
            ("offset_eigenvalue_rms", whole, {**conditions, "at_s": None}),
        ):
            documents.append(measured(quantity, "1", value, 0.0, where, n=flight.runs))
    return documents
