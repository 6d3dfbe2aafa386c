"""North from an imported log: raw samples against the encoder, or readings of both lock-ins (docs/importing.md).

Samples carry the sense of rotation in the encoder; lock-in readings need it stated, and are taken as those of ideal
lock-ins and index pulses: a log has no calibration at a known azimuth.

What departs from one signal, one offset and noise is looked for in means over parts of the turn and of the log; noise
is that from turn to turn, and the offset may walk.

Source: ``estimators.likelihood``, ``estimators.eight_samples``; the convention is in ``estimators.phasors``;
docs/decisions/0052-departures.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimates,
    Evidence,
    Figure,
    Floats,
    Labels,
    Material,
    Residuals,
    Table,
    check_method,
    curve,
    departures_of,
    estimate,
    evidence_of,
    search,
    value_and_uncertainty,
)
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.model.units import with_prefix
from bench.systems.north.estimators.eight_samples import eight_sample_north
from bench.systems.north.estimators.likelihood import LikelihoodNorth, likelihood_north
from bench.systems.north.estimators.phasors import POSITIONS, heading_deg, oriented, wrapped_deg
from bench.systems.north.wording import say, sense_name

METHODS: tuple[str, ...] = ("as_mapped",)
_HARMONICS = (2, 3, 4, 5)
_LARGEST_deg = 20.0  # half an interval of a direction beyond which nothing of north is known
_PARTS, _SECTORS = 24, 16  # of the log, of the turn: means over them are what departures are looked for in
_SENSES = {"counter_clockwise": 1, "clockwise": -1}


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return the heading of the sensing axis at encoder zero (or at index A), clockwise from north.

    Raises: FitError B-FIT-004 (unknown method), B-FIT-112 if the samples do not determine north, B-FIT-110 if readings
            of the lock-ins are not four index positions a set.
    """
    check_method(method, METHODS)
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
    north_deg, std_deg, dof = float(heading_deg(found.phi_deg, 1)), float(found.std_deg), float(found.dof)
    counted = {"n": int(found.samples), "dropped": int(found.dropped)}
    place = {"kind": "gyro", "method": "likelihood"}
    amplitude_std = float(found.noise_V) * np.sqrt(2.0 / counted["n"])
    entries = [
        estimate("azimuth", "deg", north_deg, std_deg, place, dof=dof, **counted),
        estimate("amplitude", unit, float(found.amplitude), amplitude_std, place, **counted),
    ]
    notes = [
        say("log.turns", turns=int(found.turns)),
        say("log.tilt"),
    ]
    if bool(found.widened):
        notes.append(say("log.widened"))
    figure = _samples(output, theta_deg, float(found.amplitude), unit)
    evidence = _doubt(float(found.half_width_deg()))
    evidence = evidence or _departed(entries, material.series["t_s"], output, theta_deg, found, unit)
    return _analysis(material, entries, evidence, notes, [figure])


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
    noise = float(np.sqrt(np.mean(np.square(found.noise))))
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
    return _analysis(material, entries, _doubt(coverage_factor(dof) * std_deg), notes, [figure])


def _doubt(half_deg: float) -> list[Evidence]:
    """Return a refusal where the interval leaves north open."""
    if half_deg <= _LARGEST_deg:
        return []
    return [Evidence("no_signal", say("log.no_signal", half=half_deg, most=_LARGEST_deg), half_deg, 0.0, refuses=True)]


def _departed(
    entries: Estimates, t_s: Floats, output: Floats, theta_deg: Floats, found: LikelihoodNorth, unit: str
) -> list[Evidence]:
    """Return what departs in means of the output over sectors of the turn and parts of the log."""
    good = np.isfinite(output) & np.isfinite(theta_deg)
    t_s, output, angle = t_s[good], output[good], np.deg2rad(np.mod(theta_deg[good], 360.0))
    turned = np.abs(np.unwrap(angle) - angle[0]) / (2.0 * np.pi)
    part = np.floor(turned * min(1.0, _PARTS / max(np.ceil(turned.max()), 1.0)))
    sector = np.floor(angle * _SECTORS / (2.0 * np.pi))
    cell = np.unique(part * _SECTORS + sector, return_inverse=True)[1]
    count = np.bincount(cell)

    def mean(column: Floats) -> Floats:
        return np.asarray(np.bincount(cell, column) / count)

    orders = [function(order * angle) for order in (1, *_HARMONICS) for function in (np.sin, np.cos)]
    columns = np.column_stack([mean(column) for column in (*orders, np.ones(angle.size))])
    size, phi, noise = float(found.amplitude), np.deg2rad(float(found.phi_deg)), float(found.noise_V)
    if bool(found.widened):  # from turn to turn, so that what is slower is none of it
        slope, turn = np.cos(angle + phi), turned.astype(np.int64)
        square = np.bincount(turn, slope**2)
        score = np.bincount(turn, (output - found.offset_V) * slope) / np.sqrt(np.maximum(square, 1.0))
        apart = np.diff(score[square > 0.5 * square.max()])
        noise = max(noise, float(np.sqrt(np.mean(apart**2) / 2.0)))
    weight = np.sqrt(count)[:, None] / noise
    design, number = weight * columns, mean(part).astype(np.int64)
    along, across = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    expanded = np.array([float(entry.expanded_uncertainty) for entry in entries])
    rows = Residuals(
        readings=np.zeros(count.size),  # nothing is in proportion to a reading
        white=weight[:, 0] * mean(output),
        design=design,
        scatter=weight * (number[:, None] >= np.unique(number)[1:]) * size,
        whiten=lambda effect: weight * effect,
        operator=np.array([np.rad2deg(across) / size, along]) @ (np.linalg.pinv(design)[:2] * weight[:, 0]),
        expanded=expanded,
        noise=expanded,
        on_curve=np.zeros(2, bool),
        noise_dof=float(found.dof),
    )
    labels = Labels(
        kinds={"sector": mean(sector) * (360.0 / _SECTORS)},
        hours=mean(t_s) / 3600.0,
        visit=number,
        carriers={
            "output": (unit, np.ones(count.size)),
            "amplitude": ("%", 0.01 * size * columns[:, :2] @ along),
            "azimuth": ("deg", np.deg2rad(size) * columns[:, :2] @ across),
        },
    )

    def words(label: str, value: Any) -> str:
        return say(f"departs.of.{label}" if value is None else f"departs.{label}", value=value)

    return evidence_of(search(rows, departures_of(labels)), entries, words)


def _analysis(
    material: Material, entries: Estimates, evidence: list[Evidence], notes: list[str], figures: list[Figure]
) -> Analysis:
    rows: list[list[Any]] = []
    for entry in entries:
        value, expanded = entry.value, entry.expanded_uncertainty
        factor, unit = with_prefix(max(abs(value), expanded), entry.unit)
        cells = value_and_uncertainty(factor * value, factor * expanded)
        rows.append([say(f"quantity.{entry.quantity}"), unit, *cells])
    headers = say.heads("", "quantity", "unit", "value", "expanded")
    return Analysis(
        campaign="north_log",
        method=METHODS[0],
        uut=material.campaign["uut"],
        estimates=entries,
        evidence=evidence,
        notes=notes,
        tables=[Table(say("result.title"), say("log.caption"), headers, rows, lead=True)],
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
