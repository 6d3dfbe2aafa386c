"""Estimates of a ring laser: random walk, alignment time and the constants of the lock-in, before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Estimates, estimate
from bench.model.errors import FitError
from bench.systems.lock_in.compensation import COMPENSATORS, RAW
from bench.systems.lock_in.estimators.random_walk import RandomWalk, alignment_time_s, path_exponent
from bench.systems.lock_in.limits import Requirement
from bench.systems.lock_in.result import LaserResult, Measured, squared, walk_std_deg_rth

ARW_UNIT, ARCSEC = "deg/h^0.5", 3600.0


def record_estimates(one: LaserResult, requirement: Requirement, judged: str) -> Estimates:
    """Of one record; the alignment time by the method ``judged`` carries the verdict, if the campaign limits it."""
    place = one.record.place(one.clock_Hz)
    found = _constants(one, place)
    for method in (RAW, *COMPENSATORS):
        walk = one.walks.get(method)
        if walk is not None:
            limit_s = requirement.time_s if method == judged else None
            found += _of_method(one, method, walk, requirement, limit_s)
    return found


def _of_method(
    one: LaserResult, method: str, walk: RandomWalk, requirement: Requirement, limit_s: float | None
) -> Estimates:
    place = one.record.place(one.clock_Hz) | {"method": method}
    used = one.found.turnarounds if method == RAW else one.found.used[method]
    counted = {"n": used, "dropped": one.found.turnarounds - used}
    time = alignment_s(walk, requirement)
    found = [
        estimate("angle_random_walk", ARW_UNIT, walk.n_deg_rth, walk_std_deg_rth(walk), place, **counted),
        estimate("quantisation_noise", "arcsec", ARCSEC * walk.q_deg, ARCSEC * walk.q_std_deg, place, **counted),
        estimate("alignment_time", "s", time.value, time.std, place, limit=limit_s, **counted),
    ]
    ratio = None if method == RAW else one.ratio(method)
    if ratio is not None:
        time_ratio = squared(ratio)
        found.append(estimate("random_walk_ratio", "1", ratio.value, ratio.std, place, **counted))
        found.append(estimate("alignment_time_ratio", "1", time_ratio.value, time_ratio.std, place, **counted))
    return [entry for entry in found if math.isfinite(entry["value"]) and math.isfinite(entry["std_uncertainty"])]


def alignment_s(walk: RandomWalk, requirement: Requirement) -> Measured:
    """Time until the random walk lets the azimuth be known to the required error: it goes with the walk's square."""
    square = squared(Measured(walk.n_deg_rth, walk_std_deg_rth(walk)))
    of_one_s = alignment_time_s(1.0, requirement.latitude_deg, requirement.error_deg)
    return Measured(of_one_s * square.value, of_one_s * square.std)


def _constants(one: LaserResult, place: dict[str, Any]) -> Estimates:
    found = []
    counted = {"n": one.found.turnarounds, "dropped": one.found.turnarounds - max(one.found.used.values(), default=0)}
    rate, phase = one.lock_in_deg_s, one.backscatter_deg
    if rate is not None:
        found.append(estimate("lock_in_rate", "deg/s", rate.value, rate.std, place, **counted))
    if phase is not None:
        found.append(estimate("backscatter_phase", "deg", phase.value, phase.std, place, **counted))
    return found


def exponent_estimates(results: Sequence[LaserResult], judged: str) -> Estimates:
    """How the random walk goes with the path length, by clock, before compensation (theory: -2.5) and behind it."""
    found = []
    for clock_Hz in dict.fromkeys(one.clock_Hz for one in results):
        for method in (RAW, judged):
            seen = [one for one in results if one.clock_Hz == clock_Hz and _is_seen(one.walks.get(method))]
            if len({one.record.path_length_m for one in seen}) < 2:
                continue
            walks = [one.walks[method] for one in seen]
            try:
                exponent, std = path_exponent(
                    np.array([one.record.path_length_m for one in seen]),
                    np.array([walk.n_deg_rth for walk in walks]),
                    np.array([walk_std_deg_rth(walk) for walk in walks]),
                )
            except FitError:  # the walks of each path are there all the same
                continue
            place = {"clock_Hz": clock_Hz, "method": method}
            found.append(estimate("path_length_exponent", "1", exponent, std, place, n=len(seen)))
    return found


def _is_seen(walk: RandomWalk | None) -> bool:
    return walk is not None and walk.n_deg_rth > 0.0 and math.isfinite(walk.n_std_deg_rth)


def paths_of(results: Sequence[LaserResult]) -> list[float]:
    """Return path lengths in metres, rising."""
    return sorted({one.record.path_length_m for one in results})


def value_of(estimates: Estimates, quantity: str, **place: Any) -> dict[str, Any] | None:
    """Return the first estimate of a quantity under these conditions."""
    for one in estimates:
        if one["quantity"] == quantity and all(one["conditions"].get(key) == value for key, value in place.items()):
            return one
    return None
