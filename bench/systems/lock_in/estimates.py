"""Estimates of a ring laser before and after compensation, and what is required of an alignment with it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Estimates, estimate, stated_limits
from bench.model.errors import FitError
from bench.systems.lock_in.compensation import COMPENSATORS, RAW
from bench.systems.lock_in.declaration import DECLARATION
from bench.systems.lock_in.estimators.bias import bias_alignment_error_deg
from bench.systems.lock_in.estimators.random_walk import RandomWalk, alignment_time_s, path_exponent
from bench.systems.lock_in.result import LaserResult, Measured, squared, walk_dof, walk_std_deg_rth

NATO_MIL_DEG = 360.0 / 6400.0
ARW_UNIT, ARCSEC = "deg/h^0.5", 3600.0


@dataclass(frozen=True)
class Requirement:
    """``error_deg``: largest azimuth error of the alignment.   ``time_s``: that it may take, None if nobody says.

    ``latitude_deg``: of the site, which the time depends on.
    """

    error_deg: float
    time_s: float | None
    latitude_deg: float


def requirement_of(campaign: Mapping[str, Any]) -> Requirement:
    """Read ``limits`` and ``site`` of the campaign; without a limit the error is one NATO mil (360 deg / 6400).

    Raises: FitError B-RLG-004 (a limit that no ring laser has, or in a wrong unit), B-RLG-005 (no latitude).
    """
    declared = DECLARATION.analysis("rlg_lock_in")
    stated = stated_limits(campaign, declared.limits, "B-RLG-004", "an alignment with a ring laser has no such limit")
    try:
        latitude_deg = float((campaign.get("site") or {})["latitude_deg"])
    except KeyError as error:
        raise FitError(
            "B-RLG-005",
            "the campaign does not state 'latitude_deg' of the site, which the alignment time depends on",
            where="manifest: campaign.site",
            next_step="give 'latitude' in the section 'site' of the sequence",
        ) from error
    return Requirement(stated.get("alignment_error", NATO_MIL_DEG), stated.get("alignment_time"), latitude_deg)


def record_estimates(laser: LaserResult, requirement: Requirement, judged: str) -> Estimates:
    """Of one record; the alignment time by the method ``judged`` carries the verdict, if the campaign limits it."""
    place = laser.record.place(laser.clock_Hz)
    entries = _constants(laser, place)
    for method in (RAW, *COMPENSATORS):
        walk = laser.walks.get(method)
        if walk is not None:
            limit_s = requirement.time_s if method == judged else None
            entries += _of_method(laser, method, walk, requirement, limit_s)
            entries += _bias(laser, method, requirement)
    return entries


def _bias(laser: LaserResult, method: str, requirement: Requirement) -> Estimates:
    """Return bias instability and the alignment error by it, where the record shows any."""
    bias = laser.biases.get(method)
    if bias is None or not bias.shown:
        return []
    place, n = laser.record.place(laser.clock_Hz) | {"method": method}, laser.found.turnarounds
    error_deg, std_deg = (
        bias_alignment_error_deg(size, requirement.latitude_deg) for size in (bias.value_deg_h, bias.std_deg_h)
    )
    return [
        estimate("bias_instability", "deg/h", bias.value_deg_h, bias.std_deg_h, place, n=n),
        estimate("bias_alignment_error", "deg", error_deg, std_deg, place, n=n),
    ]


def _of_method(
    laser: LaserResult, method: str, walk: RandomWalk, requirement: Requirement, limit_s: float | None
) -> Estimates:
    place = laser.record.place(laser.clock_Hz) | {"method": method}
    used = laser.found.turnarounds if method == RAW else laser.found.used[method]
    counted = {"n": used, "dropped": laser.found.turnarounds - used}
    time, dof = alignment_s(walk, requirement), walk_dof(walk)
    entries = [
        estimate("angle_random_walk", ARW_UNIT, walk.n_deg_rth, walk_std_deg_rth(walk), place, dof=dof, **counted),
        estimate("quantisation_noise", "arcsec", ARCSEC * walk.q_deg, ARCSEC * walk.q_std_deg, place, **counted),
        estimate("alignment_time", "s", time.value, time.std, place, limit=limit_s, dof=time.dof, **counted),
    ]
    ratio = None if method == RAW else laser.ratio(method)
    if ratio is not None:
        time_ratio = squared(ratio)
        for name, size in (("random_walk_ratio", ratio), ("alignment_time_ratio", time_ratio)):
            entries.append(estimate(name, "1", size.value, size.std, place, dof=size.dof, **counted))
    return [entry for entry in entries if math.isfinite(entry["value"]) and math.isfinite(entry["std_uncertainty"])]


def alignment_s(walk: RandomWalk, requirement: Requirement) -> Measured:
    """Time until the random walk lets the azimuth be known to the required error: it goes with the walk's square."""
    square = squared(Measured(walk.n_deg_rth, walk_std_deg_rth(walk)))
    of_one_s = alignment_time_s(1.0, requirement.latitude_deg, requirement.error_deg)
    return Measured(of_one_s * square.value, of_one_s * square.std, square.dof)


def _constants(laser: LaserResult, place: dict[str, Any]) -> Estimates:
    entries = []
    counted = {
        "n": laser.found.turnarounds,
        "dropped": laser.found.turnarounds - max(laser.found.used.values(), default=0),
    }
    rate, phase = laser.lock_in_deg_s, laser.backscatter_deg
    if rate is not None:
        entries.append(estimate("lock_in_rate", "deg/s", rate.value, rate.std, place, **counted))
    if phase is not None:
        entries.append(estimate("backscatter_phase", "deg", phase.value, phase.std, place, **counted))
    return entries


def exponent_estimates(results: Sequence[LaserResult], judged: str) -> Estimates:
    """How the random walk goes with the path length, by clock, before compensation (theory: -2.5) and behind it."""
    entries = []
    for clock_Hz in dict.fromkeys(laser.clock_Hz for laser in results):
        for method in (RAW, judged):
            seen = [laser for laser in results if laser.clock_Hz == clock_Hz and _is_seen(laser.walks.get(method))]
            if len({laser.record.path_length_m for laser in seen}) < 2:
                continue
            walks = [laser.walks[method] for laser in seen]
            try:
                exponent, std = path_exponent(
                    np.array([laser.record.path_length_m for laser in seen]),
                    np.array([walk.n_deg_rth for walk in walks]),
                    np.array([walk_std_deg_rth(walk) for walk in walks]),
                )
            except FitError:  # the walks of each path are there all the same
                continue
            place = {"clock_Hz": clock_Hz, "method": method}
            entries.append(estimate("path_length_exponent", "1", exponent, std, place, n=len(seen)))
    return entries


def _is_seen(walk: RandomWalk | None) -> bool:
    return walk is not None and walk.n_deg_rth > 0.0 and math.isfinite(walk.n_std_deg_rth)
