"""Bias, bias stability and bias repeatability of gyros and accelerometers at rest.

Source: GNC-module paper section 5.1 3) and table 2; the Earth's rate is taken off the gyros (level axes see up to
omega cos(latitude), more than the limit of 10 deg/h).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis.analysis import Analysis
from bench.analysis.estimates import estimate
from bench.analysis.material import Material
from bench.model.errors import FitError
from bench.systems.gnc.bias.report import bias_figures, bias_table, table_2
from bench.systems.gnc.bias.windows import Window, flip_of, window_of
from bench.systems.gnc.estimators.bias_repeatability import bias_repeatability
from bench.systems.gnc.estimators.bias_stability import BiasStability, bias_stability, on_the_counter
from bench.systems.gnc.estimators.earth_rate import earth_rate_body_deg_s, earth_rate_covariance
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.rows import AXES, SampledRow, sampled_rows, site_of
from bench.systems.gnc.sample_checks import check_notes, check_table, checked, usable
from bench.systems.gnc.table3 import table_3

Documents = list[dict[str, Any]]
METHODS: tuple[str, ...] = ("ten_second_means",)
ITEMS = ("bias", "flip", "stability", "repeatability")
_OF_ONE_PART = ("B-FIT-092", "B-FIT-093", "B-FIT-094")
# kind, prefix, unit of the bias, of its stability, and the factors from deg/s and g to them
KINDS = (("gyro", "gyro", "deg/h", "deg/h", 3600.0, 3600.0), ("accelerometer", "accel", "g", "mg", 1.0, 1e3))
_INDICATED = {"output": "indicated"}  # not the bias of a calibration, which stands behind the matrix
_NOTES = (
    "Bias and stability are those of the indicated values, before compensation: they differ from the bias of a "
    "calibration by the scale-factor error and coupling, and 1 % of scale-factor error leaves 1 % of the Earth's rate "
    "in the bias of a gyro (0.15 deg/h).",
    "Stability is the standard deviation of 360 means of 10 s: of a gyro it is mostly its angle random walk (19 deg/h "
    "per deg/sqrt(h)), not the lowest Allan deviation.",
    "Bias repeatability has no limit in the specification: it is reported, not judged.",
    "Latitude, azimuth and angles of the table are taken as stated: their uncertainty is not included.",
)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Bias of 3 min, stability of 1 h, repeatability of six windows, accelerometer bias of a flip, for every axis.

    Raises: FitError B-FIT-004 (unknown method), B-GNC-001, -003, -004, -005.
    """
    if method not in METHODS:
        raise FitError("B-FIT-004", f"unknown method {method!r}", next_step=f"use one of: {', '.join(METHODS)}")
    rows, missing = sampled_rows(material, ITEMS)
    looked_at = checked(rows, ("gyro", "accelerometer"), material.campaign)
    good, refused = usable(looked_at)
    by_item = {item: [row for row in good if row.item == item] for item in ITEMS}
    missing += refused + [f"{item}: no record" for item in ITEMS if not by_item[item]]
    stabilities, found = _stability(by_item["stability"], Limits(material.campaign), missing)
    notes = list(_NOTES)
    estimates = [*_bias(by_item["bias"], material, missing), *_flip(by_item["flip"], material, missing, notes), *found]
    estimates += _repeatability(by_item["repeatability"], missing)
    return Analysis(
        campaign="imu_bias",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=estimates,
        notes=[*(f"No result: {one}." for one in missing), *notes, *check_notes(looked_at)],
        missing=missing,
        figures=bias_figures(stabilities),
        tables=[
            bias_table(estimates),
            table_2(estimates),
            table_3(estimates, material.campaign),
            check_table(looked_at),
        ],
    )


def _bias(rows: list[SampledRow], material: Material, missing: list[str]) -> Documents:
    """Gyro bias of the first record, Earth's rate taken off: w = N - bias, so it has the sign of the reading."""
    if not rows:
        return []
    site, pose = site_of(material.campaign), rows[0].pose
    window = _window(rows[0], "gyro", _resolution(material, "gyro_resolution_deg_s"), missing)
    if window is None:
        return []
    earth, variance = earth_rate_body_deg_s(pose, site), earth_rate_covariance(pose, site).diagonal()
    std = [float(np.hypot(one.std, variance[k] ** 0.5)) for k, one in enumerate(window.means)]
    return [
        estimate("gyro_bias", "deg/h", 3600.0 * (one.value - earth[k]), 3600.0 * std[k],
                 {"kind": "gyro", "axis": AXES[k], **_INDICATED}, n=one.samples, dropped=one.missing, dof=one.dof)
        for k, one in enumerate(window.means)
    ]  # fmt: skip


def _flip(rows: list[SampledRow], material: Material, missing: list[str], notes: list[str]) -> Documents:
    """Accelerometer bias (Y1 + Y2) / 2; a = N + bias, so it has the opposite sign of the mean reading."""
    try:
        flip = flip_of(rows, _resolution(material, "accel_resolution_g"))
    except FitError as error:
        missing.append(_sentence("bias of the accelerometers", error))
        return []
    if flip is None:
        if rows:
            missing.append("bias of the accelerometers: no two records are half a turn about a body axis apart")
        return []
    notes.append(
        f"The flip was about {flip.about}: it does not reverse accelerometer {flip.about}, whose bias is not separated "
        "from the tilt of the table."
    )
    return [
        estimate("accel_bias", "g", -one.value, one.std, {"kind": "accelerometer", "axis": axis, **_INDICATED},
                 n=one.samples, dropped=one.missing, dof=one.dof)
        for axis, one in flip.by_axis.items()
    ]  # fmt: skip


def _window(row: SampledRow, kind: str, resolution: float, missing: list[str]) -> Window | None:
    try:
        return window_of(row, kind, resolution)
    except FitError as error:
        missing.append(_sentence(f"record {row.number}", error))
        return None


def _resolution(material: Material, name: str) -> float:
    return float((material.campaign.get("imu") or {}).get(name, 0.0))


def _stability(
    rows: list[SampledRow], limits: Limits, missing: list[str]
) -> tuple[dict[tuple[str, str], BiasStability], Documents]:
    stabilities: dict[tuple[str, str], BiasStability] = {}
    found: Documents = []
    for kind, prefix, _, unit, _, factor in KINDS if rows else ():
        limit = factor * limits(f"{prefix}_bias_stability")
        placed = on_the_counter(rows[0].samples.counter, rows[0].values(kind))
        for k, axis in enumerate(AXES):
            try:
                one = bias_stability(placed[:, k], 1.0 / rows[0].rate_Hz)
            except FitError as error:
                missing.append(_sentence(f"stability of {kind} {axis}", error))
                continue
            stabilities[kind, axis] = one
            place = {"kind": kind, "axis": axis}
            found.append(
                estimate(f"{prefix}_bias_stability", unit, factor * one.value, factor * one.std, place,
                         n=one.averages.size, limit=limit, dropped=one.missing)
            )  # fmt: skip
    return stabilities, found


def _repeatability(rows: list[SampledRow], missing: list[str]) -> Documents:
    found: Documents = []
    for kind, prefix, _, unit, _, factor in KINDS if rows else ():
        windows = [one for one in (_window(row, kind, 0.0, missing) for row in rows) if one is not None]
        starts, lengths = [one.start_s for one in windows], [one.length_s for one in windows]
        for k, axis in enumerate(AXES):
            means, stds = [one.means[k].value for one in windows], [one.means[k].std for one in windows]
            try:
                scatter = bias_repeatability(means, stds, starts, lengths)
            except FitError as error:
                missing.append(_sentence(f"repeatability of {kind} {axis}", error))
                continue
            place = {"kind": kind, "axis": axis}
            found.append(
                estimate(f"{prefix}_bias_repeatability", unit, factor * scatter.value, factor * scatter.std, place,
                         n=len(windows), dof=scatter.dof)
            )  # fmt: skip
    return found


def _sentence(what: str, error: FitError) -> str:
    if error.code not in _OF_ONE_PART:
        raise error
    return f"{what}: {error.message} ({error.code})"
