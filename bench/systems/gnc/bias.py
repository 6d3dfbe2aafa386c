"""Bias, bias stability and bias repeatability of gyros and accelerometers at rest.

Source: GNC-module paper section 5.1 3) and table 2; the Earth's rate is taken off the gyros (level axes see up to
omega cos(latitude), more than the limit of 10 deg/h).

What records at rest say against the biases found in them: the pose is the one named, nothing moves, nothing hangs.

Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bench.analysis import (
    Analysis,
    Estimates,
    Evidence,
    Figure,
    Floats,
    Material,
    Table,
    curve,
    estimate,
    no_result,
    worded_table,
)
from bench.maths.allan import allan_deviation
from bench.model.errors import FitError
from bench.systems.gnc.declaration import ACCELEROMETER, AXES, CALIBRATED, GYRO, Sensor
from bench.systems.gnc.estimators.bias_mean import BiasMean, declared_mean, flip_bias, mean_bias
from bench.systems.gnc.estimators.bias_stability import (
    AVERAGE_s,
    BiasStability,
    bias_repeatability,
    bias_stability,
    on_the_counter,
)
from bench.systems.gnc.estimators.earth_rate import (
    body_to_table,
    earth_rate_body_deg_s,
    earth_rate_covariance,
    up_in_body,
)
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.limits import Limits, limits_of, table_3
from bench.systems.gnc.rows import (
    SampledRow,
    check_notes,
    check_table,
    checked,
    sampled_rows,
    site_of,
    usable,
)
from bench.systems.gnc.wording import channel_name, refused, say

METHODS = ("ten_second_means",)
Noises = Mapping[str, SensorNoise]  # by kind, of records that hold none
ITEMS = ("bias", "flip", "stability", "repeatability")
_OF_ONE_PART = ("B-FIT-092", "B-FIT-093", "B-FIT-094")
_INDICATED = {"output": "indicated"}  # not the bias of a calibration, which stands behind the matrix
_NOTES = ("indicated", "stability", "repeatability", "as_stated")
_ALONG = 0.999  # cosine
_ROWS = ("gyro_bias_stability", "accel_bias_stability", "gyro_bias_repeatability", "accel_bias_repeatability")


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Bias of 3 min, stability of 1 h, repeatability of six windows, accelerometer bias of a flip, for every axis.

    Raises: FitError B-GNC-001, -003, -004, -005.
    """
    rows, missing = sampled_rows(material, ITEMS)
    looked_at = checked(rows, ("gyro", "accelerometer"), material.campaign)
    good, bad = usable(looked_at)
    by_item = {item: [row for row in good if row.item == item] for item in ITEMS}
    missing += bad + [say("missing.item", item=item) for item in ITEMS if not by_item[item]]
    limits = limits_of(material.campaign)
    stabilities, entries = stability_estimates(by_item["stability"], limits, missing)
    notes = [say(f"bias.note.{name}") for name in _NOTES]
    estimates = gyro_estimates(by_item["bias"], material, missing)
    estimates += flip_estimates(by_item["flip"], material, missing, notes) + entries
    estimates += repeatability_estimates(by_item["repeatability"], missing)
    return Analysis(
        "imu_bias",
        method,
        material.campaign["uut"],
        estimates,
        notes=[*no_result(missing), *notes, *check_notes(looked_at)],
        missing=missing,
        figures=_figures(stabilities),
        tables=[*_tables(estimates), table_3(estimates, material.campaign), check_table(looked_at)],
        evidence=evidence(good, limits),
    )


def gyro_estimates(
    rows: list[SampledRow], material: Material, missing: list[str], declared: Noises | None = None
) -> Estimates:
    """Return the gyro bias of the first record, Earth's rate taken off: w = N - bias, so its sign is that of N."""
    if not rows or not _known("gyro", declared):
        return []
    site, pose = site_of(material.campaign), rows[0].pose
    window = _window(rows[0], "gyro", _resolution(material, "gyro_resolution_deg_s"), missing, declared)
    if window is None:
        return []
    earth, variance = earth_rate_body_deg_s(pose, site), earth_rate_covariance(pose, site).diagonal()
    std = [float(np.hypot(mean.std, variance[k] ** 0.5)) for k, mean in enumerate(window.means)]
    return [
        estimate("gyro_bias", "deg/h", 3600.0 * (mean.value - earth[k]), 3600.0 * std[k],
                 {"kind": "gyro", "axis": AXES[k], **_INDICATED}, n=mean.samples, dropped=mean.missing, dof=mean.dof)
        for k, mean in enumerate(window.means)
    ]  # fmt: skip


def flip_estimates(
    rows: list[SampledRow], material: Material, missing: list[str], notes: list[str], declared: Noises | None = None
) -> Estimates:
    """Return the accelerometer bias (Y1 + Y2) / 2; a = N + bias, so it has the opposite sign of the mean reading."""
    if not _known("accelerometer", declared):
        return []
    try:
        flip = _flip_of(rows, _resolution(material, "accel_resolution_g"), declared)
    except FitError as error:
        missing.append(_sentence(say("bias.accelerometers"), error))
        return []
    if flip is None:
        if rows:
            missing.append(say("missing.no_flip"))
        return []
    notes.append(say("bias.note.flip", axis=flip.about))
    return [
        estimate("accel_bias", "g", -mean.value, mean.std, {"kind": "accelerometer", "axis": axis, **_INDICATED},
                 n=mean.samples, dropped=mean.missing, dof=mean.dof)
        for axis, mean in flip.by_axis.items()
    ]  # fmt: skip


def _known(kind: str, declared: Noises | None) -> bool:
    """Return whether the noise of a sensor is in its records or declared."""
    return declared is None or kind in declared


def _window(
    row: SampledRow, kind: str, resolution: float, missing: list[str], declared: Noises | None
) -> _Window | None:
    try:
        return _window_of(row, kind, resolution, declared)
    except FitError as error:
        missing.append(_sentence(say("record", number=row.number), error))
        return None


def _resolution(material: Material, name: str) -> float:
    return float((material.campaign.get("imu") or {}).get(name, 0.0))


def stability_estimates(
    rows: list[SampledRow], limits: Limits, missing: list[str], declared: Noises | None = None
) -> tuple[dict[tuple[str, str], BiasStability], Estimates]:
    """Return the stability of each sensor over the first record, and its estimates."""
    stabilities: dict[tuple[str, str], BiasStability] = {}
    entries: Estimates = []
    for sensor in _sensors(rows, declared):
        kind, factor, quantity = sensor.kind, sensor.small, f"{sensor.prefix}_bias_stability"
        limit = factor * limits[quantity]
        placed = on_the_counter(rows[0].samples.counter, rows[0].values(kind))
        for k, axis in enumerate(AXES):
            try:
                noise = None if declared is None else declared[kind]
                stability = bias_stability(placed[:, k], 1.0 / rows[0].rate_Hz, declared=noise)
            except FitError as error:
                missing.append(_sentence(say("bias.stability", sensor=channel_name(f"{kind} {axis}")), error))
                continue
            stabilities[kind, axis] = stability
            place = {"kind": kind, "axis": axis}
            entries.append(
                estimate(quantity, sensor.small_unit, factor * stability.value, factor * stability.std, place,
                         n=stability.averages.size, limit=limit, dropped=stability.missing)
            )  # fmt: skip
    return stabilities, entries


def _sensors(rows: list[SampledRow], declared: Noises | None) -> list[Sensor]:
    return [sensor for sensor in (GYRO, ACCELEROMETER) if rows and _known(sensor.kind, declared)]


def repeatability_estimates(rows: list[SampledRow], missing: list[str], declared: Noises | None = None) -> Estimates:
    """Return the scatter of the biases of the records."""
    entries: Estimates = []
    for sensor in _sensors(rows, declared):
        kind, factor = sensor.kind, sensor.small
        seen = (_window(row, kind, 0.0, missing, declared) for row in rows)
        windows = [window for window in seen if window is not None]
        starts, lengths = [window.start_s for window in windows], [window.length_s for window in windows]
        for k, axis in enumerate(AXES):
            means = [window.means[k].value for window in windows]
            try:
                noise = None if declared is None else declared[kind]
                scatter = bias_repeatability(means, starts, lengths, noise)
            except FitError as error:
                missing.append(_sentence(say("bias.repeatability", sensor=channel_name(f"{kind} {axis}")), error))
                continue
            place = {"kind": kind, "axis": axis}
            entries.append(
                estimate(f"{sensor.prefix}_bias_repeatability", sensor.small_unit, factor * scatter.value,
                         factor * scatter.std, place, n=len(windows), dof=scatter.dof)
            )  # fmt: skip
    return entries


def _sentence(what: str, error: FitError) -> str:
    if error.code not in _OF_ONE_PART:
        raise error
    return refused(what, error.message, error.code)


@dataclass(frozen=True)
class _Window:
    """``means``: of x, y, z as indicated.   ``start_s``: bench clock.   ``length_s``: by the unit's own clock."""

    means: tuple[BiasMean, ...]
    start_s: float
    length_s: float


def _window_of(row: SampledRow, kind: str, resolution: float, declared: Noises | None) -> _Window:
    """Means of a record at rest. Raises: FitError B-FIT-092 for less than a minute of samples."""
    interval_s = 1.0 / row.rate_Hz
    placed = on_the_counter(row.samples.counter, row.values(kind))
    if declared is None:
        means = tuple(mean_bias(placed[:, k], interval_s, resolution) for k in range(3))
    else:
        means = tuple(declared_mean(float(value), declared[kind], len(placed)) for value in placed.mean(axis=0))
    return _Window(means, row.begin_s, len(placed) * interval_s)


@dataclass(frozen=True)
class _FlipBias:
    """Accelerometer bias by axis from two records, and the axis about which the unit was turned: it has none."""

    by_axis: dict[str, BiasMean]
    about: str


def _flip_of(rows: Sequence[SampledRow], resolution_g: float, declared: Noises | None) -> _FlipBias | None:
    """The first two records between which the unit was turned by half a turn about a body axis; None without any.

    Raises: FitError B-FIT-092 for records of less than a minute.
    """
    for first_row, second_row in combinations(rows, 2):
        about = _about(first_row, second_row)
        if about is not None:
            first, second = (
                _window_of(row, "accelerometer", resolution_g, declared).means for row in (first_row, second_row)
            )
            by_axis: dict[str, BiasMean] = {}
            for k, axis in enumerate(AXES):
                try:
                    by_axis[axis] = flip_bias(first[k], second[k], axis=axis, about=about)
                except FitError as error:
                    if error.code != "B-FIT-094":
                        raise
            return _FlipBias(by_axis, about)
    return None


def _about(first: SampledRow, second: SampledRow) -> str | None:
    """Body axis that stays where it is in the table's frame while the two others turn over."""
    cosines = np.sum(body_to_table(first.pose) * body_to_table(second.pose), axis=0)
    if np.sum(cosines < -_ALONG) != 2 or np.sum(cosines > _ALONG) != 1:
        return None
    return AXES[int(np.argmax(cosines))]


def _tables(estimates: Estimates) -> list[Table]:
    """Bias of each axis, and table 2 of the paper for all axes (it prints X only): value and expanded uncertainty."""
    factors = {"gyro_bias": 1.0, "accel_bias": 1e3} | dict.fromkeys(_ROWS, 1.0)
    rows = [
        [say(f"bias.row.{quantity}"), *(_cell(estimates, quantity, axis, factor) for axis in AXES)]
        for quantity, factor in factors.items()
    ]
    return [
        worded_table(say, "bias", ["quantity"], rows[:2], AXES, lead=True),
        worded_table(say, "table2", ["quantity"], rows[2:], AXES, lead=True),
    ]


def _cell(estimates: Estimates, quantity: str, axis: str, factor: float) -> str:
    for entry in estimates:
        if entry.quantity == quantity and entry.conditions.get("axis") == axis:
            value, wide = factor * entry.value, factor * entry.expanded_uncertainty
            places = max(0, min(9, 1 - int(np.floor(np.log10(wide))))) if wide > 0 else 4
            return f"{value:.{places}f} ± {wide:.{places}f}"
    return say("verdict.not_tested")


def _figures(stabilities: Mapping[tuple[str, str], BiasStability]) -> list[Figure]:
    """Means of 10 s over the hour, and their Allan deviation."""
    figures = []
    for sensor in (GYRO, ACCELEROMETER):
        by_axis = {axis: stabilities[sensor.kind, axis] for axis in AXES if (sensor.kind, axis) in stabilities}
        if by_axis:
            figures += [_means(sensor, by_axis), _allan(sensor, by_axis)]
    return figures


def _means(sensor: Sensor, by_axis: Mapping[str, BiasStability]) -> Figure:
    series = [
        curve(
            axis,
            np.arange(0.5, stability.averages.size, dtype=np.float64) * AVERAGE_s / 60.0,
            sensor.small * (stability.averages - stability.mean),
            "line",
        )
        for axis, stability in by_axis.items()
    ]
    labels = say("means.caption"), say("means.x"), say("means.y", unit=sensor.small_unit)
    return Figure(say(f"means.title.{sensor.kind}"), *labels, series)


def _allan(sensor: Sensor, by_axis: Mapping[str, BiasStability]) -> Figure:
    series = []
    for axis, stability in by_axis.items():
        curve_of = allan_deviation(sensor.small * stability.averages, AVERAGE_s)
        series.append(curve(axis, curve_of.tau_s, curve_of.deviation, "line"))
    labels = say("allan.caption"), say("allan.x"), say("allan.y", unit=sensor.small_unit)
    return Figure(say(f"allan.title.{sensor.kind}"), *labels, series, x_log=True, y_log=True)


_PLAUSIBLE_g = 0.1  # bias and scale-factor error of an accelerometer together
_TIMES_STABILITY = 5.0  # a bias that wanders as specified changes less within a record
_SURE = 6.0  # standard deviations of the noise of both means
_QUANTITIES = {
    "bias": ("gyro_bias",),
    "flip": ("accel_bias",),
    "stability": ("gyro_bias_stability", "accel_bias_stability"),
    "repeatability": ("gyro_bias_repeatability", "accel_bias_repeatability"),
}


def evidence(rows: Sequence[SampledRow], limits: Limits) -> list[Evidence]:
    """Return what speaks against the biases of these records."""
    return [*(seen for row in rows for seen in (*_other_pose(row), *_moves(row, limits))), *_stands_still(rows)]


def _other_pose(row: SampledRow) -> list[Evidence]:
    """Return a refusal where gravity is not where the pose of the record has it."""
    off = row.values("accelerometer").mean(axis=0) - up_in_body(row.pose)
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) <= _PLAUSIBLE_g:
        return []
    text = say(
        "evidence.pose", number=row.number, item=row.item, axis=AXES[worst], off=float(off[worst]), bound=_PLAUSIBLE_g
    )
    return [Evidence("implausible_pose", text, float(off[worst]), 0.0, quantities=_QUANTITIES[row.item], refuses=True)]


def _moves(row: SampledRow, limits: Limits) -> list[Evidence]:
    """Return each axis whose mean changes from the first to the last quarter of a record beyond any bias of the kind.

    The accelerometers tell a unit that tips over its mounting, the gyros one that turns, either of them one that warms.
    """
    found = []
    for sensor in CALIBRATED:
        values = row.values(sensor.kind)
        quarter = len(values) // 4
        if not quarter:
            continue
        first, last = values[:quarter], values[-quarter:]
        change = last.mean(axis=0) - first.mean(axis=0)
        noise = np.sqrt((_variance(first) + _variance(last)) / quarter)
        far = np.abs(change) / np.maximum(_TIMES_STABILITY * limits[f"{sensor.prefix}_bias_stability"], _SURE * noise)
        worst = int(np.argmax(far))
        if far[worst] > 1.0:
            text = say(
                "evidence.moves",
                number=row.number,
                item=row.item,
                sensor=channel_name(f"{sensor.kind} {AXES[worst]}"),
                change=float(change[worst]),
                unit=sensor.unit,
                times=_TIMES_STABILITY,
            )
            found.append(Evidence("not_at_rest", text, float(change[worst]), 0.0, quantities=_QUANTITIES[row.item]))
    return found


def _variance(values: Floats) -> Floats:
    """Return the variance of white noise, from successive differences, (3,)."""
    return np.asarray(np.mean(np.diff(values, axis=0) ** 2, axis=0) / 2.0)


def _stands_still(rows: Sequence[SampledRow]) -> list[Evidence]:
    """Return each axis that never changes in any record while another one of its kind has noise: it is not there."""
    found = []
    for sensor in CALIBRATED:
        still = np.array([np.ptp(row.samples.columns[sensor.prefix], axis=0) == 0 for row in rows]).all(axis=0)
        for k in np.flatnonzero(still) if rows and not still.all() else ():
            text = say("evidence.silent", sensor=channel_name(f"{sensor.kind} {AXES[k]}"))
            place = {"kind": sensor.kind, "axis": AXES[k]}
            found.append(Evidence("stands_still", text, float(len(rows)), 0.0, conditions=place, refuses=True))
    return found
