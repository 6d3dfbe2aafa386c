"""Bias, bias stability and bias repeatability of gyros and accelerometers at rest.

Source: GNC-module paper section 5.1 3) and table 2; the Earth's rate is taken off the gyros (level axes see up to
omega cos(latitude), more than the limit of 10 deg/h).
"""

from __future__ import annotations

import numpy as np

from bench.analysis import Analysis, Estimates, Material, check_method, estimate, no_result
from bench.model.errors import FitError
from bench.systems.gnc.bias.report import bias_figures, bias_table, table_2
from bench.systems.gnc.bias.windows import Window, flip_of, window_of
from bench.systems.gnc.estimators.bias_repeatability import bias_repeatability
from bench.systems.gnc.estimators.bias_stability import BiasStability, bias_stability, on_the_counter
from bench.systems.gnc.estimators.earth_rate import earth_rate_body_deg_s, earth_rate_covariance
from bench.systems.gnc.limits import Limits, limits_of
from bench.systems.gnc.rows import AXES, SampledRow, sampled_rows, site_of
from bench.systems.gnc.sample_checks import check_notes, check_table, checked, usable
from bench.systems.gnc.table3 import table_3

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
    check_method(method, METHODS)
    rows, missing = sampled_rows(material, ITEMS)
    looked_at = checked(rows, ("gyro", "accelerometer"), material.campaign)
    good, refused = usable(looked_at)
    by_item = {item: [row for row in good if row.item == item] for item in ITEMS}
    missing += refused + [f"{item}: no record" for item in ITEMS if not by_item[item]]
    stabilities, entries = _stability(by_item["stability"], limits_of(material.campaign), missing)
    notes = list(_NOTES)
    estimates = [
        *_bias(by_item["bias"], material, missing),
        *_flip(by_item["flip"], material, missing, notes),
        *entries,
    ]
    estimates += _repeatability(by_item["repeatability"], missing)
    return Analysis(
        campaign="imu_bias",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=estimates,
        notes=[*no_result(missing), *notes, *check_notes(looked_at)],
        missing=missing,
        figures=bias_figures(stabilities),
        tables=[
            bias_table(estimates),
            table_2(estimates),
            table_3(estimates, material.campaign),
            check_table(looked_at),
        ],
    )


def _bias(rows: list[SampledRow], material: Material, missing: list[str]) -> Estimates:
    """Gyro bias of the first record, Earth's rate taken off: w = N - bias, so it has the sign of the reading."""
    if not rows:
        return []
    site, pose = site_of(material.campaign), rows[0].pose
    window = _window(rows[0], "gyro", _resolution(material, "gyro_resolution_deg_s"), missing)
    if window is None:
        return []
    earth, variance = earth_rate_body_deg_s(pose, site), earth_rate_covariance(pose, site).diagonal()
    std = [float(np.hypot(mean.std, variance[k] ** 0.5)) for k, mean in enumerate(window.means)]
    return [
        estimate("gyro_bias", "deg/h", 3600.0 * (mean.value - earth[k]), 3600.0 * std[k],
                 {"kind": "gyro", "axis": AXES[k], **_INDICATED}, n=mean.samples, dropped=mean.missing, dof=mean.dof)
        for k, mean in enumerate(window.means)
    ]  # fmt: skip


def _flip(rows: list[SampledRow], material: Material, missing: list[str], notes: list[str]) -> Estimates:
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
        estimate("accel_bias", "g", -mean.value, mean.std, {"kind": "accelerometer", "axis": axis, **_INDICATED},
                 n=mean.samples, dropped=mean.missing, dof=mean.dof)
        for axis, mean in flip.by_axis.items()
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
) -> tuple[dict[tuple[str, str], BiasStability], Estimates]:
    stabilities: dict[tuple[str, str], BiasStability] = {}
    entries: Estimates = []
    for kind, prefix, _, unit, _, factor in KINDS if rows else ():
        limit = factor * limits[f"{prefix}_bias_stability"]
        placed = on_the_counter(rows[0].samples.counter, rows[0].values(kind))
        for k, axis in enumerate(AXES):
            try:
                stability = bias_stability(placed[:, k], 1.0 / rows[0].rate_Hz)
            except FitError as error:
                missing.append(_sentence(f"stability of {kind} {axis}", error))
                continue
            stabilities[kind, axis] = stability
            place = {"kind": kind, "axis": axis}
            entries.append(
                estimate(f"{prefix}_bias_stability", unit, factor * stability.value, factor * stability.std, place,
                         n=stability.averages.size, limit=limit, dropped=stability.missing)
            )  # fmt: skip
    return stabilities, entries


def _repeatability(rows: list[SampledRow], missing: list[str]) -> Estimates:
    entries: Estimates = []
    for kind, prefix, _, unit, _, factor in KINDS if rows else ():
        windows = [window for window in (_window(row, kind, 0.0, missing) for row in rows) if window is not None]
        starts, lengths = [window.start_s for window in windows], [window.length_s for window in windows]
        for k, axis in enumerate(AXES):
            means, stds = [window.means[k].value for window in windows], [window.means[k].std for window in windows]
            try:
                scatter = bias_repeatability(means, stds, starts, lengths)
            except FitError as error:
                missing.append(_sentence(f"repeatability of {kind} {axis}", error))
                continue
            place = {"kind": kind, "axis": axis}
            entries.append(
                estimate(f"{prefix}_bias_repeatability", unit, factor * scatter.value, factor * scatter.std, place,
                         n=len(windows), dof=scatter.dof)
            )  # fmt: skip
    return entries


def _sentence(what: str, error: FitError) -> str:
    if error.code not in _OF_ONE_PART:
        raise error
    return f"{what}: {error.message} ({error.code})"
