"""Drift of an inertial unit from an imported log: strapdown over and between rests that are found in it.

Source: in ``estimators``: ``static_intervals`` (rests), ``rest_drift`` (over rests, classes of sensors),
``between_rests``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis import Analysis, Floats, Material, check_method
from bench.model.errors import FitError
from bench.systems.gnc.estimators.between_rests import TurnScale, drift_between_rests, fit_between_rests, turn_scale
from bench.systems.gnc.estimators.clocks import SampleStamps, sample_stamps
from bench.systems.gnc.estimators.multi_position import fit_multi_position
from bench.systems.gnc.estimators.rest_drift import LATITUDE_deg, drift_at_rest, random_walk
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, STEADY_deg_s, find_rests
from bench.systems.gnc.logs.evidence import stuck_sensors, wide_sizes
from bench.systems.gnc.logs.log import ImuLog, imu_log
from bench.systems.gnc.logs.strapdown_report import Found, estimates_of, figures_of, notes_of, tables_of
from bench.systems.gnc.wording import refused, say

INDICATED, CALIBRATED = "indicated", "calibrated"
METHODS: tuple[str, ...] = (INDICATED, CALIBRATED)
COUNTS = "1"
_SCALE_OFF = 0.25  # turns that are off by more are a wrong rate or unit, no scale-factor error
_SURE = 5.0  # standard uncertainties


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Rests, drift over 3 to 60 s of rest, level and velocity errors from rest to rest, class of the sensors.

    ``indicated`` takes the readings as they are; ``calibrated`` first fits accelerometers and gyroscopes to the rests
    of the log itself, as raw counts need it in any case.

    Raises: FitError B-FIT-004 (unknown method), B-GNC-006; B-FIT-084 to -086, -141, -142 if the log does not tell.
    """
    check_method(method, METHODS)
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
    stuck = stuck_sensors({"accelerometer": [log.accel], "gyro": [log.gyro]}, {"accelerometer": (), "gyro": ()})
    return Analysis(
        campaign="imu_strapdown",
        method=result.method,
        uut=dict(material.campaign["uut"]),
        estimates=entries,
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
        log=log,
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
