"""North from an imported log: raw samples against the encoder, or readings of both lock-ins (docs/importing.md).

Samples carry the sense of rotation in the encoder; lock-in readings need it stated, and are taken as those of ideal
lock-ins and index pulses: a log has no calibration at a known azimuth.

What departs is looked for in parts of the log, each a set as those of a campaign.

Source: ``estimators.likelihood``, ``estimators.phasors``; the convention is in ``estimators.phasors``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimates,
    Evidence,
    Figure,
    Floats,
    Material,
    Searched,
    Table,
    curve,
    estimate,
    evidence_of,
    unseen_tables,
    value_and_uncertainty,
)
from bench.maths.arrays import rms
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.model.units import with_prefix
from bench.systems.north.departures import searches_of
from bench.systems.north.estimators.likelihood import LikelihoodNorth, likelihood_north
from bench.systems.north.estimators.phasors import (
    POSITIONS,
    eight_sample_north,
    half_width_deg,
    heading_deg,
    oriented,
    wrapped_deg,
)
from bench.systems.north.sets import LOG, NorthSet
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, Azimuths, Site, Solution
from bench.systems.north.wording import say, sense_name

METHODS = ("as_mapped",)
_HARMONICS = (2, 3, 4, 5)
_LARGEST_deg = 20.0  # half an interval of a direction beyond which nothing of north is known
_PARTS, _LEAST_SAMPLES = 60, 30  # of a log at most, of a part
_SENSES = {"counter_clockwise": 1, "clockwise": -1}


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return the heading of the sensing axis at encoder zero (or at index A), clockwise from north.

    Raises: FitError B-FIT-112 if the samples do not determine north, B-FIT-110 if readings
            of the lock-ins are not four index positions a set.
    """
    columns = {str(c["role"]): c for c in material.campaign.get("columns", ())}
    if {"output", "encoder"} <= set(columns):
        return _of_samples(material, columns)
    if {"lock_in_1", "lock_in_2", "index"} <= set(columns):
        return _of_readings(material, columns)
    raise FitError(
        "B-FIT-112",
        "the log holds neither samples against an encoder nor readings of two lock-ins",
        next_step="map the roles output and encoder, or lock_in_1, lock_in_2 and index (docs/importing.md)",
    )


def _of_samples(material: Material, columns: dict[str, Any]) -> Analysis:
    output, unit = material.series[columns["output"]["name"]], str(columns["output"]["unit"])
    theta_deg = material.series[columns["encoder"]["name"]]
    found = likelihood_north(output, theta_deg, harmonics=_HARMONICS)
    north_deg = float(heading_deg(found.phi_deg, 1))
    counted = {"n": found.samples, "dropped": found.dropped}
    place = {"kind": "gyro", "method": "likelihood"}
    amplitude_std = found.noise_V * np.sqrt(2.0 / found.samples)
    entries = [
        estimate("azimuth", "deg", north_deg, found.std_deg, place, dof=found.dof, **counted),
        estimate("amplitude", unit, found.amplitude, amplitude_std, place, **counted),
    ]
    notes = [say("log.turns", turns=found.turns), say("log.tilt")]
    if found.widened:
        notes.append(say("log.widened"))
    figure = _samples(output, theta_deg, found.amplitude, unit)
    open_north = _no_signal(half_width_deg(found.std_deg, found.dof))
    searches = [] if open_north else _searches(entries, material.series["t_s"], output, theta_deg, found)
    return _analysis(material, entries, open_north, searches, notes, [figure])


def _of_readings(material: Material, columns: dict[str, Any]) -> Analysis:
    readings = np.stack([material.series[columns[role]["name"]] for role in ("lock_in_1", "lock_in_2", "index")])
    sets = readings.shape[1] // POSITIONS
    one, other, index = readings[:, : sets * POSITIONS].reshape(3, sets, POSITIONS)
    if not sets or not np.array_equal(index, np.tile(np.arange(POSITIONS), (sets, 1))):
        raise FitError(
            "B-FIT-110",
            f"{readings.shape[1]} rows are not whole sets of the index positions 0, 1, 2, 3",
            next_step="give four rows a set, in this order; cut what is left of a set",
        )
    sense = _SENSES[str(material.campaign["turntable"])]
    found = eight_sample_north(*oriented(one, other, sense))
    mean = complex(np.mean(found.phasor))
    noise = rms(found.noise)
    std_deg, dof = float(np.rad2deg(noise / (2.0 * abs(mean) * np.sqrt(sets)))), 4.0 * sets
    north_deg = float(heading_deg(np.rad2deg(np.angle(mean)), sense))
    each_deg = wrapped_deg(heading_deg(found.phi_deg, sense) - north_deg)
    place = {"kind": "gyro", "method": "least_squares"}
    entries = [estimate("azimuth", "deg", north_deg, std_deg, place, n=sets, dof=dof)]
    figure = Figure(
        say("log.each_title"), "", say("axis.set"), "deg",
        [curve(say("axis.set"), np.arange(1.0, sets + 1.0), each_deg, "points")],
    )  # fmt: skip
    notes = [say("log.ideal", sets=sets, sense=sense_name(sense))]
    parts = np.array_split(np.arange(sets), min(sets, _PARTS))
    t_s = np.array([np.mean(material.series["t_s"][POSITIONS * own]) for own in parts])
    at_deg = heading_deg(np.rad2deg(np.angle([np.mean(found.phasor[own]) for own in parts])), sense)
    solution = _solution(
        t_s, LEAST_SQUARES, Azimuths(at_deg, std_deg * math.sqrt(len(parts)), dof), [None] * len(parts)
    )
    open_north = _no_signal(coverage_factor(dof) * std_deg)
    searches = [] if open_north else list(searches_of(solution, entries))
    return _analysis(material, entries, open_north, searches, notes, [figure])


def _no_signal(half_deg: float) -> list[Evidence]:
    """Return a refusal where the interval leaves north open."""
    if half_deg <= _LARGEST_deg:
        return []
    return [Evidence("no_signal", say("log.no_signal", half=half_deg, most=_LARGEST_deg), half_deg, 0.0, refuses=True)]


def _searches(
    entries: Estimates, t_s: Floats, output: Floats, theta_deg: Floats, found: LikelihoodNorth
) -> list[Searched]:
    """Return the searches of parts of whole turns; an offset that changes turns what is fitted to all of them."""
    series = np.stack([t_s, output, theta_deg])
    series = series[:, np.isfinite(series).all(axis=0)]
    t_s, _, theta_deg = series
    turned = np.maximum.accumulate(np.abs(np.unwrap(theta_deg, period=360.0) - theta_deg[0])) / 360.0
    whole = math.ceil(turned[-1] * max(1.0 / _PARTS, _LEAST_SAMPLES / t_s.size))
    cuts = np.searchsorted(turned, np.arange(whole, turned[-1], whole))
    parts = np.split(series, cuts, axis=1)[: max(int(turned[-1]) // whole, 1)]
    middle_s = np.array([part[0].mean() for part in parts])
    raw = [likelihood_north(*part[1:], harmonics=_HARMONICS) for part in parts]
    at_deg = heading_deg(np.array([one.phi_deg for one in raw]), 1)
    square_deg2 = float(np.mean([one.bound_deg**2 for one in raw]))
    if len(raw) > 1:  # from part to part, so that what is slower is no noise
        square_deg2 = max(square_deg2, float(np.mean(wrapped_deg(np.diff(at_deg)) ** 2)) / 2.0)
    azimuths = Azimuths(at_deg, math.sqrt(square_deg2), len(raw) / 1.5)  # neighbours share a part
    angle = np.deg2rad(theta_deg)
    columns = np.array([np.sin(angle), np.cos(angle), np.ones(angle.size)])
    hats = np.array([columns @ np.interp(t_s, middle_s, one) for one in np.eye(len(raw))])
    turn = np.exp(-1j * np.deg2rad(found.phi_deg)) * (np.linalg.solve(columns @ columns.T, hats.T)[:2].T @ [1.0, 1.0j])
    by_offset = np.array([np.rad2deg(turn.imag), found.amplitude * turn.real]) / 100.0
    return list(searches_of(_solution(middle_s, LIKELIHOOD, azimuths, raw), entries, by_offset))


def _solution(t_s: Floats, method: str, azimuths: Azimuths, raw: Sequence[LikelihoodNorth | None]) -> Solution:
    """Return parts of a log at ``t_s`` (n,) as sets of one azimuth that is sought, found by one method."""
    none = np.full(t_s.size, math.nan)
    sets = [NorthSet(LOG, "", 0.0, k, begin_s=t, end_s=t) for k, t in enumerate(t_s.tolist(), start=1)]
    by_method = dict.fromkeys((LEAST_SQUARES, LIKELIHOOD), Azimuths(none, math.nan, math.inf)) | {method: azimuths}
    return Solution(sets, Site(0.0, 0.0), none, none, np.isnan(none), none, none, raw, by_method=by_method)


def _analysis(
    material: Material,
    entries: Estimates,
    evidence: list[Evidence],
    searches: list[Searched],
    notes: list[str],
    figures: list[Figure],
) -> Analysis:
    rows: list[list[Any]] = []
    for entry in entries:
        value, expanded = entry.value, entry.expanded_uncertainty
        factor, unit = with_prefix(max(abs(value), expanded), entry.unit)
        cells = value_and_uncertainty(factor * value, factor * expanded)
        rows.append([say(f"quantity.{entry.quantity}"), unit, *cells])
    headers = say.heads("", "quantity", "unit", "value", "expanded")
    return Analysis(
        "north_log",
        METHODS[0],
        material.campaign["uut"],
        entries,
        evidence=[*evidence, *evidence_of(searches)],
        notes=notes,
        tables=[Table(say("result.title"), say("log.caption"), headers, rows, lead=True), *unseen_tables(searches)],
        figures=figures,
    )


def _samples(output: Floats, theta_deg: Floats, amplitude: float, unit: str) -> Figure:
    """Means of the output over parts of a turn of 5 deg."""
    factor, shown = with_prefix(amplitude, unit)
    part = np.floor(np.mod(theta_deg, 360.0) / 5.0)
    good = np.isfinite(output) & np.isfinite(part)
    place, count = np.unique(part[good].astype(np.int64), return_counts=True)
    means = np.bincount(part[good].astype(np.int64), factor * output[good])[place] / count
    parts = [curve(say("log.mean"), 5.0 * place + 2.5, means, "points")]
    return Figure(say("log.samples_title"), "", say("axis.table_angle"), say("axis.output_unit", unit=shown), parts)
