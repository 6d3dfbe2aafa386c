"""Sentences a reader of a ring-laser campaign must know: where a compensator does harm, what the numbers rest on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.compensation import COMPENSATORS, GLOBAL
from bench.systems.lock_in.estimates import Requirement
from bench.systems.lock_in.result import LaserResult, misfit
from bench.systems.lock_in.wording import label, say

_NEAR_90_DEG = 10.0
_SENSOR_OFF = 0.03  # of the dither amplitude; its sensor is good to 1 %
_MODEL_OFF = 0.03  # of the RMS jump; simulated lasers with one backscatter leave below 0.007
_MOST_UNUSED = 0.05  # of the turnarounds
_PROBABILITY = 1e-4  # of a false note per record and constant


def notes(results: Sequence[LaserResult], requirement: Requirement, judged: str) -> list[str]:
    """Return sentences in the order of their weight; ``judged`` is the method of the verdict."""
    return [
        *_harm(results),
        *_better(results, judged),
        *_condition(results),
        *_model(results),
        *_off(results),
        *_standing(requirement),
        *_losses(results),
        *_left_out(results),
    ]


def _harm(results: Sequence[LaserResult]) -> list[str]:
    notes = []
    for method in COMPENSATORS:
        worse = [laser for laser in results if laser.is_worse(method)]
        if worse:
            ratios = [ratio.value for ratio in (laser.ratio(method) for laser in worse) if ratio is not None]
            about = {"method": label(method), "names": say.listed(laser.name for laser in worse)}
            if len(ratios) > 1:
                notes.append(say("note.harm_span", **about, low=min(ratios), high=max(ratios)))
            else:
                notes.append(say("note.harm", **about, ratio=ratios[0]))
    return notes


def _better(results: Sequence[LaserResult], judged: str) -> list[str]:
    """Another compensator that leaves less random walk than the one judged, beyond their uncertainties."""
    notes = []
    for laser in results:
        mine = laser.ratio(judged)
        for method in COMPENSATORS:
            other = laser.ratio(method)
            if mine is None or other is None:
                continue
            if mine.value - other.value > coverage_factor() * float(np.hypot(mine.std, other.std)):
                about = {"name": laser.name, "other": label(method), "judged": label(judged)}
                notes.append(say("note.better", **about, ratio=other.value, of_judged=mine.value))
    return notes


def _condition(results: Sequence[LaserResult]) -> list[str]:
    condition = say("note.condition")
    phases = [laser.backscatter_deg.value for laser in results if laser.backscatter_deg is not None]
    if not phases:
        return [condition]
    off = float(np.max(np.abs(np.abs(phases) - 90.0)))
    if off <= _NEAR_90_DEG:
        return [say("note.condition_near", condition=condition, off=off)]
    span = sorted({f"{phase:.0f}" for phase in (min(phases), max(phases))}, key=float)
    if len(span) == 1:
        return [say("note.condition_found", condition=condition, phase=span[0])]
    return [say("note.condition_span", condition=condition, low=span[0], high=span[-1])]


def _model(results: Sequence[LaserResult]) -> list[str]:
    notes = []
    for laser in results:
        share = laser.systematic_share
        if share is not None and share > _MODEL_OFF:
            notes.append(say("note.model", name=laser.name, share=100 * share))
        moved = _moved(laser)
        if moved:
            notes.append(say("note.moved", name=laser.name, moved=moved))
    return notes


def _off(results: Sequence[LaserResult]) -> list[str]:
    """Outputs that random walk and quantisation do not describe, in one sentence."""
    off = []
    for laser in results:
        methods = say.listed(label(name) for name, walk in laser.walks.items() if misfit(walk) > 1.0)
        off += [say("off.output", name=laser.name, methods=methods)] if methods else []
    if not off:
        return []
    return [say("note.off", outputs=say.listed(off, "list.comma"))]


def _moved(laser: LaserResult) -> str:
    """Return which constants differ from block to block, in words; "" if none does."""
    moved = []
    for fit in laser.found.constants:
        blocks = (
            ("moved.rate", fit.block_kappa_rad_s, fit.block_kappa_std_rad_s),
            ("moved.phase", np.unwrap(fit.block_beta_rad), fit.block_beta_std_rad),
        )
        for key, value, std in blocks:
            chi2 = float(np.sum(((value - np.average(value, weights=std**-2.0)) / std) ** 2))
            if value.size > 1 and special.chdtrc(value.size - 1, chi2) < _PROBABILITY:
                moved.append(say(key))
    return say.listed(dict.fromkeys(moved), "list.and")


def _standing(requirement: Requirement) -> list[str]:
    return [
        say("note.alignment", error=requirement.error_deg),
        say("note.no_truth"),
    ]


def _losses(results: Sequence[LaserResult]) -> list[str]:
    notes = []
    for laser in results:
        events, stretches = laser.events, laser.found.stretches
        if events.lost_blocks or events.lost_edges or events.torn:
            lost = {"blocks": events.lost_blocks, "edges": events.lost_edges, "seconds": laser.found.seconds}
            if stretches == 1:
                notes.append(say("note.losses_one", name=laser.name, **lost))
            else:
                notes.append(say("note.losses", name=laser.name, **lost, stretches=stretches))
        if events.dark:
            notes.append(say("note.dark", name=laser.name, count=events.dark))
        used = max(laser.found.used.values(), default=0)
        if used < (1.0 - _MOST_UNUSED) * laser.found.turnarounds:
            notes.append(say("note.unused", name=laser.name, used=used, of=laser.found.turnarounds))
        notes += _dither(laser)
        refused = say.listed((label(name) for name in laser.missing if name != GLOBAL), "list.comma")
        if refused:
            notes.append(say("note.no_result", name=laser.name, methods=refused))
    return notes


def _dither(laser: LaserResult) -> list[str]:
    sensed, counted = laser.record.dither_deg_s, laser.counted_dither_deg_s
    if sensed is None:
        return [say("note.no_sensor", name=laser.name)]
    if abs(counted / sensed - 1.0) > _SENSOR_OFF:
        return [say("note.sensor_off", name=laser.name, sensed=sensed, counted=counted)]
    return []


def _left_out(results: Sequence[LaserResult]) -> list[str]:
    """Single bad readings that no result rests on."""
    notes = []
    for laser in results:
        odd_s, repeated = laser.found.odd_s, laser.events.repeated
        if odd_s and laser.found.odd_left_out:
            times = ", ".join(f"{time_s:.3f} s" for time_s in odd_s[:5])
            notes.append(say("note.odd", name=laser.name, count=len(odd_s), times=times))
        if repeated:
            notes.append(say("note.repeated", name=laser.name, count=repeated))
    return notes
