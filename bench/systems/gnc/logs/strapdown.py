"""Drift of an inertial unit from an imported log: strapdown over and between rests that are found in it.

Source: in ``estimators``: ``static_intervals`` (rests), ``rest_drift`` (over rests, classes of sensors),
``between_rests``.

Estimates, tables, figures and notes of the drift of an inertial unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimates,
    Figure,
    Floats,
    Material,
    Table,
    curve,
    estimate,
    no_result,
    number,
    with_uncertainty,
    worded_table,
)
from bench.maths.stamps import SampleStamps, sample_stamps
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.estimators.between_rests import (
    BetweenRests,
    TurnScale,
    drift_between_rests,
    fit_between_rests,
    turn_scale,
)
from bench.systems.gnc.estimators.multi_position import fit_multi_position
from bench.systems.gnc.estimators.rest_drift import (
    CLASSES,
    HORIZONS_s,
    LATITUDE_deg,
    RandomWalk,
    RestDrift,
    class_of,
    drift_at_rest,
    random_walk,
    worst_class,
)
from bench.systems.gnc.estimators.static_intervals import MULTIPLE, StaticIntervals, STEADY_deg_s, find_rests
from bench.systems.gnc.logs.log import ImuLog, imu_log, stuck_sensors, wide_sizes
from bench.systems.gnc.rows import STANDARD_GRAVITY_M_S2
from bench.systems.gnc.wording import quantity_word, refused, say

_WALK = math.degrees(1.0) * 60.0  # rad/sqrt(s) in deg/sqrt(h)
_CLASS_OF = {"gyro_drift": "gyro_deg_h", "angle_random_walk": "walk_deg_rt_h", "accelerometer_drift": "accel_mg"}
INDICATED, CALIBRATED = "indicated", "calibrated"
METHODS = (INDICATED, CALIBRATED)
COUNTS = "1"
_SCALE_OFF = 0.25  # turns that are off by more are a wrong rate or unit, no scale-factor error
_SURE = 5.0  # standard uncertainties


@dataclass(frozen=True)
class Found:
    """All that was found in a log; ``counts``: its numbers have no unit, ``missing``: what it does not tell."""

    method: str
    counts: bool
    stamps: SampleStamps
    rests: StaticIntervals
    walk: RandomWalk
    drifts: list[RestDrift]
    between: BetweenRests | None
    scale: TurnScale | None
    missing: tuple[str, ...]


def estimates_of(result: Found) -> Estimates:
    """Drift for each horizon, rates of drift with the class they fit, errors from rest to rest."""
    entries = [entry for drift in result.drifts for entry in _at_rest(drift)]
    entries += _rates(result)
    if result.between is not None:
        entries += _between(result.between)
    if result.scale is not None and not result.counts:
        place = {"kind": "gyro"}
        entries.append(
            estimate("turn_scale", "1", result.scale.scale, result.scale.std, place, n=result.scale.turns,
                     dof=2 * result.scale.turns - 1)
        )  # fmt: skip
    return entries


def _at_rest(drift: RestDrift) -> Estimates:
    rows = (
        ("rest_drift_attitude", "deg", drift.attitude_rms_deg, "gyro"),
        ("rest_drift_velocity", "m/s", drift.velocity_rms_m_s, "accelerometer"),
        ("rest_drift_horizontal", "m", drift.horizontal_rms_m, "accelerometer"),
    )
    place = {"horizon_s": round(drift.horizon_s, 3)}
    return [
        estimate(name, unit, value, drift.std(value), {"kind": kind} | place, n=drift.windows, dof=drift.windows)
        for name, unit, value, kind in rows
    ]


def _rates(result: Found) -> Estimates:
    """Return what the longest horizon says per unit of time, and the angle random walk, each with its class."""
    rows: list[tuple[str, str, float, float, str, dict[str, Any], int]] = []
    if result.drifts:
        drift = result.drifts[-1]
        place = {"horizon_s": round(drift.horizon_s, 3)}
        gyro = drift.attitude_rms_deg / drift.horizon_s * 3600.0
        accel = drift.velocity_rms_m_s / drift.horizon_s / STANDARD_GRAVITY_M_S2 * 1e3
        rows.append(("gyro_drift", "deg/h", gyro, drift.std(gyro), "gyro", place, drift.windows))
        rows.append(("accelerometer_drift", "mg", accel, drift.std(accel), "accelerometer", place, drift.windows))
    walk = result.walk
    if walk.differences:
        rows.append(
            ("angle_random_walk", "deg/sqrt(h)", _WALK * walk.value, _WALK * walk.std, "gyro", {}, walk.differences)
        )
    return [
        estimate(
            name, unit, value, std, {"kind": kind, "sensor_class": class_of(_CLASS_OF[name], value)} | more, n=n, dof=n
        )
        for name, unit, value, std, kind, more, n in rows
    ]


def _between(between: BetweenRests) -> Estimates:
    count = len(between.rest)
    place = {"motion_s": round(float(between.motion_s.mean()), 3), "bias_s": round(float(between.bias_s.mean()), 3)}
    rows = (
        ("level_error", "deg", between.level_rms_deg, "gyro"),
        ("velocity_error", "m/s", between.velocity_rms_m_s, "accelerometer"),
    )
    return [
        estimate(name, unit, value, value / math.sqrt(2.0 * count), {"kind": kind} | place, n=count, dof=count)
        for name, unit, value, kind in rows
    ]


def notes_of(result: Found) -> list[str]:
    """Return what a reader has to know about rests, time and method."""
    lengths = (result.rests.end - result.rests.begin) / result.stamps.rate_Hz
    notes = [
        say(
            "drift.rests",
            count=len(lengths),
            shortest=float(lengths.min()),
            longest=float(lengths.max()),
            times=MULTIPLE,
        ),
        say("drift.over_rests"),
        _class_note(result),
    ]
    if result.drifts and len(result.drifts) < len(HORIZONS_s):
        longer = ", ".join(f"{horizon_s:g}" for horizon_s in HORIZONS_s[len(result.drifts) :])
        notes.append(say("drift.longer", horizons=longer))
    if result.between is not None:
        notes.append(say("drift.between_rests"))
    if result.method == "calibrated":
        notes.append(say("drift.calibrated"))
    elif result.between is not None:
        notes.append(say("drift.indicated"))
    return [*no_result(result.missing), *notes, *_stamp_notes(result.stamps)]


def _class_note(result: Found) -> str:
    names = [str(rate.conditions["sensor_class"]) for rate in _rates(result)]
    if not names:
        return say("drift.no_class")
    return say("drift.class", worst=_class_name(worst_class(names)), classes=say.listed([*map(_class_name, names)]))


def _class_name(name: str) -> str:
    return say(f"class.{name.replace(' ', '_')}")


def _stamp_notes(stamps: SampleStamps) -> list[str]:
    if stamps.bursty:
        share, worst_s = 100 * stamps.crowded, stamps.worst_s
        return [say("drift.bursts", share=share, worst=worst_s, rate=stamps.rate_Hz)]
    notes = [say("drift.counted", rate=stamps.rate_Hz, worst=1e3 * stamps.worst_s)]
    if len(stamps.breaks):
        notes.append(say("drift.gaps", missing=stamps.missing, gaps=len(stamps.breaks)))
    return notes


def tables_of(result: Found) -> list[Table]:
    """Drift over rests, class of the sensors, and errors from rest to rest."""
    tables = [_rest_table(result.drifts)] if result.drifts else []
    if rates := _rates(result):
        tables.append(_class_table(rates))
    if result.between is not None:
        tables.append(_between_table(result.between))
    return tables


def _rest_table(drifts: list[RestDrift]) -> Table:
    rows = [
        [
            f"{d.horizon_s:.3g}",
            d.windows,
            _rms_text(d, d.attitude_rms_deg),
            number(d.white_deg, 4),
            _rms_text(d, d.velocity_rms_m_s),
            _rms_text(d, d.horizontal_rms_m),
        ]
        for d in drifts
    ]
    heads = ["over", "stretches", "attitude", "walk", "velocity", "distance"]
    return worded_table(say, "drift", heads, rows, lead=True)


def _rms_text(drift: RestDrift, value: float) -> str:
    return with_uncertainty(value, coverage_factor(drift.windows) * drift.std(value))


def _class_table(rates: Estimates) -> Table:
    rows = []
    for rate in rates:
        bounds = [number(float(f"{getattr(sensor_class, _CLASS_OF[rate.quantity]):.3g}")) for sensor_class in CLASSES]
        shown = with_uncertainty(rate.value, rate.expanded_uncertainty)
        rows.append(
            [quantity_word(rate.quantity), rate.unit, shown,
             _class_name(str(rate.conditions["sensor_class"])), *bounds]
        )  # fmt: skip
    reach = [say("class.up_to", name=_class_name(sensor_class.name)) for sensor_class in CLASSES]
    return worded_table(say, "class", ["figure", "unit", "found", "class"], rows, reach, lead=True)


def _between_table(between: BetweenRests) -> Table:
    speed = np.linalg.norm(between.velocity_error_m_s, axis=1)
    columns = (between.bias_s, between.motion_s, between.tilted_deg, between.level_error_deg, speed)
    rows = [[int(rest) + 1, *(float(column[k]) for column in columns)] for k, rest in enumerate(between.rest)]
    return worded_table(say, "between", ["rest", "length", "motion", "tipped", "level", "velocity"], rows)


def figures_of(result: Found) -> list[Figure]:
    """Drift against its horizon, and the errors of every motion."""
    figures = []
    if len(result.drifts) > 1:
        horizon = np.array([drift.horizon_s for drift in result.drifts])
        series = [
            curve(
                say("drift.measured"), horizon, np.array([drift.attitude_rms_deg for drift in result.drifts]), "points"
            ),
            curve(say("drift.walk"), horizon, np.array([drift.white_deg for drift in result.drifts]), "line"),
        ]
        labels = say("drift.figure"), "", say("drift.x"), say("drift.y")
        figures.append(Figure(*labels, series, x_log=True, y_log=True))
    if result.between is not None and len(result.between.rest) > 1:
        place = result.between.rest.astype(np.float64) + 1.0
        series = [curve(quantity_word("level_error"), place, result.between.level_error_deg, "points")]
        figures.append(Figure(say("between.figure"), "", say("between.x"), "deg", series))
    return figures


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Rests, drift over 3 to 60 s of rest, level and velocity errors from rest to rest, class of the sensors.

    ``indicated`` takes the readings as they are; ``calibrated`` first fits accelerometers and gyroscopes to the rests
    of the log itself, as raw counts need it in any case.

    Raises: FitError B-GNC-006; B-FIT-084 to -086, -141, -142 if the log does not tell.
    """
    log = imu_log(material)
    if log.gyro is None:
        raise FitError(
            "B-GNC-006",
            "the log has no gyroscopes of three axes, so nothing can be carried from rest to rest",
            next_step="map three columns of the role gyro (docs/importing.md)",
        )
    latitude = (material.campaign.get("site") or {}).get("latitude_deg")
    result = _found(log, log.gyro, method, LATITUDE_deg if latitude is None else float(latitude))
    entries = estimates_of(result)
    stuck = stuck_sensors({"accelerometer": [log.accel], "gyro": [log.gyro]})
    return Analysis(
        "imu_strapdown",
        result.method,
        material.campaign["uut"],
        entries,
        notes=notes_of(result),
        missing=list(result.missing),
        tables=tables_of(result),
        figures=figures_of(result),
        evidence=[*stuck, *wide_sizes(entries)],
    )


def _found(log: ImuLog, gyro: Floats, method: str, latitude_deg: float) -> Found:
    stamps = sample_stamps(log.t_s)
    counts = COUNTS in (log.accel_unit, log.gyro_unit)
    steady = np.inf if log.gyro_unit == COUNTS else STEADY_deg_s
    rests = find_rests(log.accel, gyro, stamps.rate_Hz, stamps.breaks, steady)
    triads = _triads(log, gyro, rests, stamps, CALIBRATED if counts else method)
    rates = np.radians(triads.gyro_deg_s)
    missing = []
    try:
        drifts = drift_at_rest(triads.accel, rates, rests, stamps.rate_Hz, latitude_deg)
    except FitError as error:
        if error.code != "B-FIT-140":
            raise
        drifts = []
        missing.append(refused(say("missing.over_rests"), error.message, error.code))
    between = drift_between_rests(triads.accel, rates, rests, stamps.rate_Hz, stamps.breaks, latitude_deg)
    if between is None and len(rests.begin) > 1:
        missing.append(say("missing.between_rests"))
    return Found(
        method=CALIBRATED if counts else method,
        counts=counts,
        stamps=stamps,
        rests=rests,
        walk=random_walk(rates, rests, stamps.rate_Hz),
        drifts=drifts,
        between=between,
        scale=triads.scale,
        missing=tuple(missing),
    )


@dataclass(frozen=True)
class _Triads:
    accel: Floats
    gyro_deg_s: Floats
    scale: TurnScale | None


def _triads(log: ImuLog, gyro: Floats, rests: StaticIntervals, stamps: SampleStamps, method: str) -> _Triads:
    """Return the readings that are integrated, and the factor on all turns before any fit to them."""
    accel = log.accel
    if method == CALIBRATED:
        accel = fit_multi_position(rests.means(accel), log.gravity).apply(accel)
    scale = turn_scale(accel, gyro, rests, stamps.rate_Hz)
    if log.gyro_unit != COUNTS:
        _check_scale(scale, stamps)
    if method == CALIBRATED:
        if scale is None:
            raise FitError(
                "B-FIT-085",
                "fewer than three turns between rests tip the unit by 20 deg: its gyroscopes cannot be fitted",
                next_step="turn the unit by 90 degrees or so between rests, about each axis in both directions",
            )
        step_s = np.full(len(gyro), 1.0 / stamps.rate_Hz)
        fit = fit_between_rests(step_s, gyro, rests, rests.means(accel), 1.0 / scale.scale)
        gyro = (gyro - fit.zero) @ fit.matrix.T
    return _Triads(accel, gyro, scale)


def _check_scale(scale: TurnScale | None, stamps: SampleStamps) -> None:
    """Refuse a log whose turns are all too small or too large alike: any drift of it would be wrong by as much."""
    if scale is None or abs(scale.scale - 1.0) < max(_SCALE_OFF, _SURE * scale.std):
        return
    raise FitError(
        "B-FIT-142",
        f"{scale.turns} turns between rests carry gravity from rest to rest only if all angles are multiplied by "
        f"{scale.scale:.3g} ± {2 * scale.std:.1g}; {stamps.rate_Hz:.6g} samples a second are stated",
        next_step=f"check the rate in the mapping ({stamps.rate_Hz / scale.scale:.3g} Hz would fit), or the unit of "
        "the gyroscopes",
    )
