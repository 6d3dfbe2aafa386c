"""What a recording says against its model: one motion of both units, a constant offset, errors as they are stated.

All solutions of the EGI are held against the unaided integration of the inertial unit, with the errors that the makers
state; what remains must be as large as these, and no rival may take much of it: an offset that steps or drifts, parts
of a solution that are of different age, a lever arm, axes that are turned against each other, scales of the inertial
unit. The receive stamps are a second opinion of the offset, and each half of them one of the other half.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import stats

from bench.analysis import Evidence
from bench.maths.arrays import Floats
from bench.maths.tests import SMALLEST, of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.estimators.differences import Differences, Guess, Noise, Solved, differences
from bench.systems.time_sync.estimators.kalman.setup import EgiSpread, ImuDensities
from bench.systems.time_sync.estimators.port_clocks import LEAST_FRAMES, MOST, PortClock, port_clock
from bench.systems.time_sync.estimators.rivals import OneMotion, Rival, one_motion
from bench.systems.time_sync.filtering import GROUPS, METHODS, OFFSET_STD_s
from bench.systems.time_sync.records import Recording, Stream
from bench.systems.time_sync.wording import say

OFFSETS = ("time_offset", "time_offset_uncertainty")
OF_FILTER = (*OFFSETS, "accel_bias", "gyro_bias", "image_shift")
OF_STAMPS = ("time_offset_from_stamps", "time_offset_drift", "clock_rate", "receive_jitter")
_PLAUSIBLE_s = 4.0 * OFFSET_STD_s  # of what is left for the filter: more is not what it was told to look for
_PARTS = 8  # of a recording, in which the delays of a port must be alike
DRIFTS = "offset_drifts"


@dataclass(frozen=True)
class Held:
    """Solutions held against the inertial unit: ``at_s`` (b,) of the blocks; ``offset_s`` by their fit, ``fit``."""

    at_s: Floats
    guess_s: float
    shift_s: float
    fit: OneMotion

    def offset_s(self, correction_s: float) -> float:
        """Return the offset that a correction of the guess makes."""
        return self.shift_s + self.guess_s + correction_s


def held(result: SyncResult, densities: ImuDensities, spread: EgiSpread) -> Held:
    """Fit all differences of a recording at once, about what the chosen filter found."""
    found, clocks = result.found, result.clocks
    run, group, egi = found.run, GROUPS.index(result.method), found.egi
    guess = Guess(float(run.offset_s[-1, group, 0]), run.accel_bias[-1, group, 0], run.gyro_bias[-1, group, 0])
    noise = Noise(densities, spread, clocks.difference.drift_std, clocks.egi.tag_noise_s)
    solved = Solved(egi.t_s, egi.p, egi.v, egi.C, egi.frame.latitude_deg)
    seen: Differences = differences(result.ready.imu, solved, guess, noise)
    accel, gyro = densities.bias_sigmas
    prior_std = np.array([*(accel,) * 3, *(gyro,) * 3, OFFSET_STD_s])
    prior = np.concatenate((guess.accel_bias, guess.gyro_bias, [-guess.offset_s]))
    return Held(seen.at_s, guess.offset_s, found.shift_s, one_motion(seen, prior_std, prior))


def evidence(result: SyncResult, seen: Held, taken: Recording) -> list[Evidence]:
    """Return what every check says, those that found nothing included."""
    return [
        *_not_observable(result),
        *_plausible(result),
        *_stuck(result),
        _misfit(result, seen),
        *(found for rival in seen.fit.rivals for found in _rival(result, seen, rival)),
        *_against_stamps(result),
        *_steady_clocks(result, taken),
    ]


def _move(result: SyncResult, offset_s: float) -> float:
    """Return how far the offset is from those of the filters, in their expanded uncertainties; the larger one."""
    moves = []
    for name in METHODS:
        offset = result.found.offsets[name]
        moves.append(abs(offset_s - offset.offset_s) / (coverage_factor() * offset.std_s))
    return max(moves)


def _not_observable(result: SyncResult) -> Iterator[Evidence]:
    """Yield the offsets that the motion did not show: what the filter says there is what was assumed beforehand."""
    for name in METHODS:
        offset = result.found.offsets[name]
        if not offset.seen:
            yield Evidence(
                "not_observable",
                say("evidence.not_observable", share=offset.normalised, std=1e3 * OFFSET_STD_s),
                offset.normalised, 0.0, quantities=("time_offset",), refuses=True, conditions={"method": name},
            )  # fmt: skip


def _plausible(result: SyncResult) -> Iterator[Evidence]:
    for name in METHODS:
        offset = result.found.offsets[name]
        left_s = offset.offset_s - result.found.shift_s
        if abs(left_s) > _PLAUSIBLE_s:
            yield Evidence(
                "implausible_offset",
                say("evidence.implausible", offset=1e3 * left_s, bound=1e3 * _PLAUSIBLE_s),
                1e3 * left_s, 0.0, quantities=OF_FILTER, refuses=True,
                conditions={"method": name},
            )  # fmt: skip


def _stuck(result: SyncResult) -> Iterator[Evidence]:
    stuck = result.ready.stuck_egi
    if stuck > max(1.0, MOST * result.found.samples):
        yield Evidence(
            "stuck_solutions",
            say("evidence.stuck", count=stuck),
            float(stuck), 0.0, quantities=OF_FILTER,
        )  # fmt: skip


def _misfit(result: SyncResult, seen: Held) -> Evidence:
    """Return whether residuals are as large as the stated errors; larger ones widen the interval by as much."""
    fit = seen.fit
    ratio = fit.chi2 / fit.dof
    move = max(_move(result, seen.offset_s(fit.offset_s)), math.sqrt(ratio) - 1.0)
    sentence = say("evidence.misfit", chi2=ratio)
    return Evidence("misfit", sentence, ratio, fit.probability, move, OF_FILTER)


def _rival(result: SyncResult, seen: Held, rival: Rival) -> Iterator[Evidence]:
    offset_s, probability = seen.offset_s(rival.offset_s), rival.probability
    sentence = say("evidence.rival", what=say(f"rival.{rival.name}"), offset=1e3 * offset_s)
    move = max(_move(result, offset_s), abs(rival.offset_s - seen.fit.offset_s) / _smallest(result))
    yield Evidence(rival.name, sentence, 1e3 * offset_s, probability, move, OF_FILTER)
    if rival.name == DRIFTS:
        of_drift = abs(float(rival.size[0])) / (coverage_factor() * result.clocks.difference.drift_std)
        yield Evidence(rival.name, sentence, 1e6 * float(rival.size[0]), probability, of_drift, OF_STAMPS)


def _smallest(result: SyncResult) -> float:
    """Return the smaller expanded uncertainty of both filters, s."""
    offsets = [result.found.offsets[name] for name in METHODS]
    return min(coverage_factor() * offset.std_s for offset in offsets)


def _against_stamps(result: SyncResult) -> Iterator[Evidence]:
    """Yield whether filters and receive stamps agree; each has its own way to be wrong."""
    clocks = result.clocks
    if clocks.offset_s is None:
        return
    for name in METHODS:
        offset = result.found.offsets[name]
        if not offset.seen:
            continue
        apart_s, std_s = offset.offset_s - clocks.offset_s, math.hypot(offset.std_s, clocks.difference.std_s)
        sentence = say("evidence.stamps", apart=1e3 * apart_s, due=1e3 * coverage_factor() * std_s)
        probability = t_both(apart_s / std_s)
        interval_s = coverage_factor() * offset.std_s
        yield Evidence("stamps_disagree", sentence, 1e3 * apart_s, probability, abs(apart_s) / interval_s, OFFSETS,
                       {"method": name})  # fmt: skip
        of_stamps = abs(apart_s) / (coverage_factor() * clocks.difference.std_s)
        if name == result.method:
            yield Evidence("stamps_disagree", sentence, 1e3 * apart_s, probability, of_stamps, OF_STAMPS[:1])


def _steady_clocks(result: SyncResult, taken: Recording) -> Iterator[Evidence]:
    """Yield whether the least delay of a port stays on its line, and what the numbers of the stamps make of it."""
    clocks = result.clocks
    lever_s = max(abs(result.found.offsets[name].lever_s) for name in METHODS)
    for name, port, stream, at_s in (
        ("imu", clocks.imu, taken.imu, clocks.imu_s), ("egi", clocks.egi, taken.egi, clocks.egi_s),
    ):  # fmt: skip
        apart_s, probability = _halves(port, stream, at_s) if port.grid_s > 0.0 else _spread(port)
        apart_rate = 2.0 * apart_s / float(np.ptp(at_s))
        sentence = say("evidence.delays", link=name, apart=1e3 * apart_s)
        of_stamps = max(apart_rate / port.rate_std, apart_s / port.std_s(port.at_s)) / coverage_factor()
        of_offset = lever_s * apart_rate / _smallest(result)
        for quantities, move in ((OF_STAMPS, of_stamps), (OFFSETS, of_offset)):
            yield Evidence("delays_unsteady", sentence, 1e3 * apart_s, probability, move, quantities)


def _halves(port: PortClock, stream: Stream, at_s: Floats) -> tuple[float, float]:
    """Return by how much the lines of both halves are apart where they meet, s, and the probability of it."""
    middle = at_s.size // 2
    if middle < LEAST_FRAMES:
        return 0.0, 1.0
    received_s = 1e-9 * (stream.received_ns - stream.received_ns[0])
    early, late = (
        port_clock(at_s[part], stream.counter[part], received_s[part], port.grid_s)
        for part in (slice(None, middle), slice(middle, None))
    )
    meet_s = float(at_s[middle])
    apart_s = abs(late.least_s(meet_s) - early.least_s(meet_s))
    by_level = apart_s / math.hypot(late.std_s(meet_s), early.std_s(meet_s))
    by_rate = abs(late.rate - early.rate) / math.hypot(late.rate_std, early.rate_std)
    return apart_s, of_many(t_both(max(by_level, by_rate)), 2)


def _spread(port: PortClock) -> tuple[float, float]:
    """Return by how much the least delays of parts are apart, s, and the probability of parts as unlike.

    Source: Kruskal and Wallis, J. Am. Stat. Assoc. 47 (1952).
    """
    parts = np.array_split(port.above_s, _PARTS)
    least_s = [float(part.min()) for part in parts]
    return max(least_s) - min(least_s), max(float(stats.kruskal(*parts).pvalue), SMALLEST)
