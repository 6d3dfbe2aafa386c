"""Lock-in compensation of dithered ring lasers: random walk and alignment time before and after, by five methods.

Source: paper 004 on the alignment time of inertial navigation and lock-in compensation of ring laser gyroscopes,
equations (1) to (11) as restored in docs/ring-laser.md. Only ticks, levels and housekeeping of the records are read.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.analysis import Analysis, Material, no_result, unseen_tables
from bench.model.errors import FitError
from bench.systems.lock_in.compensation import COMPENSATORS
from bench.systems.lock_in.evidence import evidence
from bench.systems.lock_in.figures import campaign_figures, turnaround_figures
from bench.systems.lock_in.records import flagged, laser_records, none_usable, not_recorded
from bench.systems.lock_in.report import notes, tables
from bench.systems.lock_in.result import (
    LaserResult,
    Requirement,
    exponent_estimates,
    laser_result,
    record_estimates,
    requirement_of,
)
from bench.systems.lock_in.wording import label, say

METHODS: tuple[str, ...] = COMPENSATORS


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
        if laser.record.place(laser.clock_Hz) | {"method": method} not in told
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
