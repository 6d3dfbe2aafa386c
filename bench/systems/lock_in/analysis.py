"""Lock-in compensation of dithered ring lasers: random walk and alignment time before and after, by five methods.

Source: paper 004 on the alignment time of inertial navigation and lock-in compensation of ring laser gyroscopes,
equations (1) to (11) as restored in docs/method-ring-laser.md. Only ticks, levels and housekeeping of the records
are read.

Notes tell where a compensator does harm and what the numbers rest on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Analysis, Material, Table, no_result, unseen_tables, with_uncertainty, worded_table
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.lock_in.compensation import COMPENSATORS, GLOBAL, RAW
from bench.systems.lock_in.estimators.steadiness import bias_alignment_error_deg
from bench.systems.lock_in.evidence import evidence
from bench.systems.lock_in.figures import campaign_figures, turnaround_figures
from bench.systems.lock_in.records import flagged, laser_records, none_usable, not_recorded
from bench.systems.lock_in.result import (
    ARCSEC,
    NATO_MIL_DEG,
    LaserResult,
    Measured,
    Requirement,
    alignment_s,
    exponent_estimates,
    laser_result,
    misfit,
    record_estimates,
    requirement_of,
    squared,
    walk_dof,
    walk_std_deg_rth,
)
from bench.systems.lock_in.wording import label, say

_NEAR_90_DEG = 10.0
_SENSOR_OFF = 0.03  # of the dither amplitude; its sensor is good to 1 %
_MOST_UNUSED = 0.05  # of the turnarounds


def tables(results: Sequence[LaserResult], requirement: Requirement, method: str) -> list[Table]:
    """Return all tables, those that are read first in front."""
    return [
        _comparison(results, method),
        _alignment(results, requirement, method),
        _constants(results),
        _walks(results),
        _material(results),
    ]


def _table(
    results: Sequence[LaserResult], name: str, heads: Sequence[str], rows: Sequence[Sequence[Sequence[Any]]],
    *more: str, lead: bool = False, **fields: Any,
) -> Table:  # fmt: skip
    """Return a table with the columns that say which record a row is of; ``rows``: those of each record."""
    settings = [laser.record.phase_setting_deg for laser in results]
    several = any(setting is not None for setting in settings)
    whole = []
    for laser, phase, lines in zip(results, settings, rows, strict=True):
        place = [f"{100 * laser.record.path_length_m:g}", f"{laser.clock_Hz / 1e6:g}"]
        place += [] if not several else ["–" if phase is None else f"{phase:g}"]
        whole += [[*place, *line] for line in lines]
    places = ["path", "clock", *(["phase_set"] if several else [])]
    return worded_table(say, name, [*places, *heads], whole, more, lead=lead, **fields)


def _comparison(results: Sequence[LaserResult], method: str) -> Table:
    rows = []
    for laser in results:
        phase = laser.backscatter_deg
        seen = "–" if phase is None else f"{phase.value:.1f}"
        rows.append([[seen, *(_ratio(laser, name) for name in COMPENSATORS)]])
    names = map(label, COMPENSATORS)
    return _table(results, "comparison", ["found"], rows, *names, lead=True, method=label(method))


def _ratio(laser: LaserResult, method: str) -> str:
    ratio = laser.ratio(method)
    shown = _bounded(ratio)
    return say("cell.worse", ratio=shown) if ratio is not None and laser.is_worse(method) else shown


def _text(measured: Measured | None, factor: float = 1.0) -> str:
    if measured is None:
        return say("cell.no_result")
    return with_uncertainty(factor * measured.value, factor * measured.expanded)


def _bounded(measured: Measured | None, factor: float = 1.0) -> str:
    """As ``_text``; of a value that cannot be told from 0, what it does not exceed."""
    if measured is None or measured.value > measured.expanded:
        return _text(measured, factor)
    return _below(factor * (measured.value + measured.expanded))


def _below(limit: float) -> str:
    return f"< {float(f'{limit:.2g}'):g}"


def _alignment(results: Sequence[LaserResult], requirement: Requirement, method: str) -> Table:
    rows = []
    for laser in results:
        raw, after, ratio = laser.walks.get(RAW), laser.walks.get(method), laser.ratio(method)
        times = [None if walk is None else alignment_s(walk, requirement) for walk in (raw, after)]
        factor = None if ratio is None else squared(ratio)
        rows.append([[*(_bounded(value) for value in (*times, factor)), _by_bias(laser, method, requirement)]])
    return _table(
        results,
        "alignment",
        ["before", "after", "factor", "by_bias"],
        rows,
        lead=True,
        error=requirement.error_deg,
        mil=requirement.error_deg / NATO_MIL_DEG,
        latitude=requirement.latitude_deg,
        method=label(method),
    )


def _by_bias(laser: LaserResult, method: str, requirement: Requirement) -> str:
    """Return the alignment error by the bias instability of an output, NATO mil, or its upper limit."""
    bias = laser.biases.get(method)
    if bias is None:
        return say("cell.no_result")
    of_one = bias_alignment_error_deg(1.0, requirement.latitude_deg) / NATO_MIL_DEG
    if not bias.significant:
        return _below(of_one * bias.upper_limit)
    return _text(Measured(bias.coefficient, bias.std_uncertainty), of_one)


def _constants(results: Sequence[LaserResult]) -> Table:
    rows = []
    for laser in results:
        share, sensed = laser.systematic_share, laser.record.dither_deg_s
        cells = [_text(laser.lock_in_deg_s, 1e3), _text(laser.backscatter_deg)]
        cells += ["–" if sensed is None else f"{sensed:.2f}", f"{laser.counted_dither_deg_s:.2f}"]
        rows.append([[*cells, "–" if share is None else f"{100 * share:.1f}"]])
    heads = ["lock_in_rate", "backscatter", "dither_sensed", "dither_counted", "left"]
    return _table(results, "constants", heads, rows)


def _walks(results: Sequence[LaserResult]) -> Table:
    rows = [[_walk_row(laser, method) for method in (RAW, *COMPENSATORS) if method in laser.walks] for laser in results]
    return _table(results, "walks", ["output", "random_walk", "quantisation", "theory", "chi2"], rows)


def _walk_row(laser: LaserResult, method: str) -> list[str]:
    walk = laser.walks[method]
    cells = [_bounded(Measured(walk.n_deg_rth, walk_std_deg_rth(walk), walk_dof(walk)), 1e3)]
    cells.append(_text(Measured(walk.q_deg, walk.q_std_deg), 1e3 * ARCSEC) if walk.q_deg > 0.0 else "–")
    expected = laser.expected_deg_rth if method == RAW else None
    theory = "" if expected is None else f"{1e3 * expected:#.3g}"
    return [label(method), *cells, theory, f"{walk.chi2:.1f} / {walk.dof}"]


def _material(results: Sequence[LaserResult]) -> Table:
    rows = []
    for laser in results:
        sums, events = laser.found, laser.events
        unused = (say(f"unused.{name}", count=count) for name, count in sorted(sums.counts.items()) if count)
        why = say.listed(unused, "list.comma")
        cells = [f"{sums.seconds:.2f}", sums.edges, sums.turnarounds, sums.grazing, why or "0"]
        lost = [sums.stretches, events.lost_blocks, events.lost_edges, sums.missing]
        rows.append([[*cells, *lost]])
    heads = [
        "time",
        "edges",
        "turnarounds",
        "grazing",
        "not_used",
        "stretches",
        "blocks_lost",
        "dropped",
        "missing_inside",
    ]
    return _table(results, "material", heads, rows)


def notes(results: Sequence[LaserResult], requirement: Requirement, judged: str) -> list[str]:
    """Return sentences in the order of their weight; ``judged`` is the method of the verdict."""
    return [
        *_harm(results),
        *_better(results, judged),
        *_condition(results),
        *_off(results),
        say("note.alignment", error=requirement.error_deg),
        say("note.no_truth"),
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


def _off(results: Sequence[LaserResult]) -> list[str]:
    """Outputs that random walk and quantisation do not describe, in one sentence."""
    off = []
    for laser in results:
        methods = say.listed(label(name) for name, walk in laser.walks.items() if misfit(walk) > 1.0)
        off += [say("off.output", name=laser.name, methods=methods)] if methods else []
    if not off:
        return []
    return [say("note.off", outputs=say.listed(off, "list.comma"))]


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


METHODS = COMPENSATORS


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return every compensator over every record; ``method`` says whose alignment time is judged.

    Raises: FitError B-RLG-001 to -007; a record that cannot be analysed is missing, unless
            none can.
    """
    requirement = requirement_of(material.campaign)
    records = laser_records(material)
    missing, bad = not_recorded(records), flagged(records)
    results: list[LaserResult] = []
    refused: list[FitError] = []
    missing += [say("missing.flagged", number=number, flags=flags) for number, flags in bad.items()]
    for record in records:  # one at a time: the edges of a record take hundreds of megabytes while it is analysed
        if record.number in bad:
            continue
        try:
            results.append(laser_result(record))
        except FitError as error:
            refused.append(error)
            missing.append(say("missing.record", number=record.number, why=error.message, code=error.code))
    if not results:
        raise refused[0] if refused else none_usable(bad)
    return analysis_of("rlg_lock_in", material, results, missing, requirement, method)


def analysis_of(
    campaign: str,
    material: Material,
    results: Sequence[LaserResult],
    missing: list[str],
    requirement: Requirement,
    method: str,
) -> Analysis:
    """Return estimates, evidence, tables and figures of lasers; ``missing``: what has no result already."""
    estimates = [entry for laser in results for entry in record_estimates(laser, requirement, method)]
    told = [entry.conditions for entry in estimates if entry.quantity == "angle_random_walk"]
    no_walk = say("missing.no_walk")
    missing = missing + [
        say("missing.method", name=laser.name, method=label(method), why=laser.missing.get(method, no_walk))
        for laser in results
        if laser.place | {"method": method} not in told
    ]
    heard, searches = evidence(results)
    return Analysis(
        campaign,
        method,
        material.campaign["uut"],
        [*estimates, *exponent_estimates(results, method)],
        evidence=heard,
        notes=[*no_result(missing), *notes(results, requirement, method)],
        missing=missing,
        figures=[*campaign_figures(results, requirement, method), *turnaround_figures(results)],
        tables=[*tables(results, requirement, method), *unseen_tables(searches)],
    )
