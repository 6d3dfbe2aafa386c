"""Sentences a reader of a ring-laser campaign must know: where a compensator does harm, what the numbers rest on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.compensation import COMPENSATORS, GLOBAL
from bench.systems.lock_in.estimates import Requirement
from bench.systems.lock_in.result import LaserResult, misfit
from bench.systems.lock_in.tables import LABELS

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
            span = f"{min(ratios):.2f} to {max(ratios):.2f}" if len(ratios) > 1 else f"{ratios[0]:.2f}"
            notes.append(
                f"Compensation by {LABELS[method]} makes the gyroscope WORSE: random walk times {span} at "
                f"{'; '.join(laser.name for laser in worse)}. Without it the output is better there."
            )
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
                notes.append(
                    f"{laser.name}: {LABELS[method]} leaves less random walk than {LABELS[judged]}: {other.value:.3f} "
                    f"against {mine.value:.3f} of that before."
                )
    return notes


def _condition(results: Sequence[LaserResult]) -> list[str]:
    text = (
        "The paper's reduction of the random walk to a half or a third by crossings next to the turnaround holds for a "
        "backscatter phase near ±90 deg; elsewhere the ripple of the beat's phase biases every extrapolation."
    )
    phases = [laser.backscatter_deg.value for laser in results if laser.backscatter_deg is not None]
    if not phases:
        return [text]
    off = float(np.max(np.abs(np.abs(phases) - 90.0)))
    if off <= _NEAR_90_DEG:
        return [f"{text} Here it is within {off:.1f} deg of that, so these ratios are not those of any other laser."]
    span = sorted({f"{phase:.0f}" for phase in (min(phases), max(phases))}, key=float)
    return [f"{text} Found here: {' to '.join(span)} deg."]


def _model(results: Sequence[LaserResult]) -> list[str]:
    notes = []
    for laser in results:
        share = laser.systematic_share
        if share is not None and share > _MODEL_OFF:
            notes.append(
                f"{laser.name}: {100 * share:.0f} % of the RMS jump is left behind the global fit as a function of the "
                "phase: the lock-in is not of one constant size and phase (second harmonic, drift), and the fit takes "
                "off less than its own uncertainty says."
            )
        moved = _moved(laser)
        if moved:
            notes.append(
                f"{laser.name}: {moved} between blocks of the record by more than the uncertainties explain; each "
                "block is compensated with its own constants."
            )
    return notes


def _off(results: Sequence[LaserResult]) -> list[str]:
    """Outputs that random walk and quantisation do not describe, in one sentence."""
    off = []
    for laser in results:
        methods = [LABELS[name] for name, walk in laser.walks.items() if misfit(walk) > 1.0]
        off += [f"{laser.name} ({'; '.join(methods)})"] if methods else []
    if not off:
        return []
    return [
        f"Random walk and quantisation do not describe the Allan deviation of {', '.join(off)}: the uncertainty is "
        "widened by as much as it is off. A period of the dither that stays in step with the clock of the tagger is "
        "one cause: the quantisation of the pick-off is then a slow beat and not noise."
    ]


def _moved(laser: LaserResult) -> str:
    """Return which constants differ from block to block, in words; "" if none does."""
    moved = []
    for fit in laser.found.constants:
        blocks = (
            ("the lock-in rate moves", fit.block_kappa_rad_s, fit.block_kappa_std_rad_s),
            ("the backscatter phase moves", np.unwrap(fit.block_beta_rad), fit.block_beta_std_rad),
        )
        for words, value, std in blocks:
            chi2 = float(np.sum(((value - np.average(value, weights=std**-2.0)) / std) ** 2))
            if value.size > 1 and special.chdtrc(value.size - 1, chi2) < _PROBABILITY:
                moved.append(words)
    return " and ".join(dict.fromkeys(moved))


def _standing(requirement: Requirement) -> list[str]:
    return [
        f"Alignment times are those of equation (2) to {requirement.error_deg:.5g} deg, one standard deviation, from "
        "random walk alone: bias, accelerometers and motion of the base come on top.",
        "There is no true angle in a record: ratios are of Allan deviations of the latched counts, and the reference "
        "of the figures is the global fit. It assumes the equation that simulated lasers obey, so its ratio on a "
        "simulated bench is a best case.",
        "Ratios are given as if both random walks were independent; a compensator that does little leaves them alike, "
        "so that their ratio is better known than stated.",
    ]


def _losses(results: Sequence[LaserResult]) -> list[str]:
    notes = []
    for laser in results:
        events, stretches = laser.events, laser.found.stretches
        if events.lost_blocks or events.lost_edges or events.torn:
            notes.append(
                f"{laser.name}: {events.lost_blocks} blocks lost, {events.lost_edges} edges dropped by the tagger; the "
                f"record was analysed in {'1 stretch' if stretches == 1 else f'{stretches} stretches'} of "
                f"{laser.found.seconds:.2f} s in all, nothing was bridged."
            )
        if events.dark:
            notes.append(
                f"{laser.name}: {events.dark} blocks of 10 ms without any edge: the laser was dark, or its beat did "
                "not reach the tagger. What comes behind is a stretch of its own; a laser that was started anew is "
                "cold."
            )
        used = max(laser.found.used.values(), default=0)
        if used < (1.0 - _MOST_UNUSED) * laser.found.turnarounds:
            notes.append(
                f"{laser.name}: only {used} of {laser.found.turnarounds} turnarounds could be compensated; the others "
                "stay as they are, so the ratios say little about the compensators."
            )
        sensed = laser.record.dither_deg_s
        if sensed is None:
            notes.append(
                f"{laser.name}: no housekeeping with the dither amplitude: the levels counted cannot be held against "
                "it."
            )
        elif abs(laser.counted_dither_deg_s / sensed - 1.0) > _SENSOR_OFF:
            notes.append(
                f"{laser.name}: the sensor says {sensed:.2f} deg/s of dither, the counted levels "
                f"{laser.counted_dither_deg_s:.2f}: the path length stated, or the sensor, is wrong."
            )
        refused = ", ".join(LABELS.get(name, name) for name in laser.missing if name != GLOBAL)
        if refused:
            notes.append(f"{laser.name}: no result by {refused}.")
    return notes


def _left_out(results: Sequence[LaserResult]) -> list[str]:
    """Single bad readings that no result rests on."""
    notes = []
    for laser in results:
        odd_s, repeated = laser.found.odd_s, laser.events.repeated
        if odd_s and laser.found.odd_left_out:
            times = ", ".join(f"{time_s:.3f} s" for time_s in odd_s[:5])
            notes.append(
                f"{laser.name}: left out, as the count is unlike all others round it: {len(odd_s)} half periods of the "
                f"dither (at {times})."
            )
        if repeated:
            notes.append(f"{laser.name}: left out, as they repeat an earlier one edge by edge: {repeated} blocks.")
    return notes
