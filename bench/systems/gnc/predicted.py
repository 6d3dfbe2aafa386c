"""Predicts what the campaigns of a module and of its inertial unit will know, with the noise that is declared.

A data sheet and a site say noise and field. Planned records get the samples that a unit without error and noise would
give in the planned poses and motions; they go through the fits of positions, turns, rests and attitudes, and the
answers of a nominal module through the judges of a unit test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.analysis import CONTINUES, UNIT, Document, Estimates, Floats, Material, Planned, Prediction, Reading
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow, Samples
from bench.systems.gnc.bias import ITEMS as AT_REST
from bench.systems.gnc.bias import flip_estimates, gyro_estimates, repeatability_estimates, stability_estimates
from bench.systems.gnc.calibration.analysis import estimates_of, fit_triad, name_missing
from bench.systems.gnc.calibration.report import Calibration, sets_of
from bench.systems.gnc.declaration import ACCELEROMETER, AXES, CALIBRATED, GYRO, SENSORS, Sensor
from bench.systems.gnc.estimators.earth_rate import (
    Site,
    earth_rate_local_deg_s,
    mounting_matrix,
    table_to_local,
    turn_axis_in_body,
    turned_about,
)
from bench.systems.gnc.estimators.magnetometer.plane import ELLIPSE
from bench.systems.gnc.estimators.sensor_noise import SensorNoise, expected_range
from bench.systems.gnc.field_evidence import nominal_answers, roll_estimates
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.magnetometer import ITEMS as OF_FIELD
from bench.systems.gnc.magnetometer import Sphere, attitudes_of, plane_estimates, sphere_of, turns_of
from bench.systems.gnc.rows import SampledRow, clock_of, gravity_g, pose_of, power_on_of, sampled_rows, site_of
from bench.systems.gnc.unit_test.analysis import values_of_item
from bench.systems.gnc.unit_test.answers import Answer, asked_of
from bench.systems.gnc.unit_test.judges import Rules, judge
from bench.systems.gnc.unit_test.units import ItemResult, unit_of
from bench.systems.gnc.wording import say

_DIGITS = 12  # a sine of half a turn is zero: what its rounding leaves would determine a sensitivity
_OF_A_TURN = {"angle", "rate", "acceleration"}
_UNITS = {sensor.prefix: sensor.unit for sensor in SENSORS.values()}
ITEMS = ("position", "rotation")
_AT_REST = {"gyro": np.zeros(3), "accel": np.array([0.0, 0.0, 1.0])}
_LABORATORY_degC = 25.0


def noise_of(campaign: Document, sensor: Sensor, missing: list[str]) -> SensorNoise | None:
    """Return the declared noise of gyros or accelerometers; None, and what to declare, without one.

    A sensor of no noise and no step would have no uncertainty: it counts as not declared.
    """
    imu = campaign.get("imu") or {}
    walk, step = imu.get(sensor.walk), float(imu.get(sensor.resolution, 0.0))
    if walk is None or not (walk or step):
        missing.append(say(f"predicted.no_noise.{sensor.kind}"))
        return None
    wandering = [(float(size), float(time_s)) for size, time_s in imu.get(f"{sensor.prefix}_wandering", ())]
    return SensorNoise(float(walk), wandering, step, 1.0 / float(campaign["rate_Hz"]))


def magnetic_noise(campaign: Document) -> float:
    """Return the standard deviation of a reading of the magnetometer with its rounding, gauss.

    Raises: FitError B-GNC-008 if it is not declared, or declared to be nothing.
    """
    imu = campaign.get("imu") or {}
    noise = float(imu.get("mag_noise_gauss", 0.0))
    rounding = float(imu.get("mag_resolution_gauss", 0.0)) / math.sqrt(12.0) if "mag_noise_gauss" in imu else 0.0
    if not math.hypot(noise, rounding) > 0.0:
        raise _not_declared("magnetometer_noise", "uut: imu", "0.5 mgauss")
    return math.hypot(noise, rounding)


def field_local_gauss(campaign: Document) -> Floats:
    """Return the magnetic field of the site, East, North, Up. Raises: FitError B-GNC-008 if it is not declared."""
    field = (campaign.get("site") or {}).get("magnetic_field")
    if field is None:
        raise _not_declared("magnetic_field", "site", "{size: 0.43 gauss, inclination: 55 deg, declination: -4 deg}")
    dip, east = math.radians(field["inclination_deg"]), math.radians(field["declination_deg"])
    level = math.cos(dip)
    return float(field["size_gauss"]) * np.array([level * math.sin(east), level * math.cos(east), -math.sin(dip)])


def _not_declared(name: str, section: str, example: str) -> FitError:
    return FitError(
        "B-GNC-008",
        f"{name} is not declared, so nothing can be predicted",
        where=f"sequence: {section}",
        next_step=f"declare {name} in the section '{section}', such as {name}: {example}",
    )


def nominal_material(planned: Planned, fields: Sequence[str]) -> Material:
    """Return the planned records with samples of these fields ("gyro", "accel", "mag"); temperatures are zero.

    Raises:  FitError B-GNC-005 as ``site_of``.
    """
    site = site_of(planned.campaign)
    local = {"gyro": earth_rate_local_deg_s(site.latitude_deg), "accel": np.array([0.0, 0.0, 1.0])}
    local["accel"] *= gravity_g(planned.campaign)
    if "mag" in fields:
        local["mag"] = field_local_gauss(planned.campaign)
    rate_Hz = float(planned.campaign["rate_Hz"])
    rows = [
        _row(window, planned.readings, {name: local[name] for name in fields}, site, rate_Hz)
        for window in _joined(planned.windows)
    ]
    return Material(rows, planned.campaign, planned.standards)


def _joined(windows: Sequence[RecordWindow]) -> list[RecordWindow]:
    """Return the windows, each that continues the one before as a part of it."""
    joined: list[RecordWindow] = []
    for window in windows:
        if joined and CONTINUES in window.conditions and abs(window.t_start_ns - joined[-1].t_end_ns) < 1e-3 * NS:
            joined[-1] = replace(joined[-1], t_end_ns=window.t_end_ns)
        else:
            joined.append(window)
    return joined


def _row(
    window: RecordWindow, calls: Sequence[Reading], local: dict[str, Floats], site: Site, rate_Hz: float
) -> RecordRow:
    count = round((window.t_end_ns - window.t_start_ns) / NS * rate_Hz)
    edges_s = np.arange(count + 1) / rate_Hz
    t_ns = window.t_start_ns + np.rint(edges_s[1:] * NS).astype(np.int64)
    angle_deg = _angle_deg(window, calls, edges_s)
    columns: dict[str, Any] = {"tick": (t_ns // 1000 % (1 << 32)).astype(np.uint32), "temperature": np.zeros(count)}
    for name, vector in local.items():
        columns[name] = _seen(window, angle_deg, vector, site)
    if "gyro" in local and "axis" in window.conditions:
        columns["gyro"][:, AXES.index(str(window.conditions["axis"]))] += np.diff(angle_deg) * rate_Hz * _along(window)
    scales = {name: (1.0, 0.0, _UNITS.get(name, "")) for name in columns}
    counter = round(window.t_start_ns / NS * rate_Hz) + np.arange(count, dtype=np.int64)
    samples = Samples(columns, counter, t_ns, scales)
    return RecordRow(window, {}, count, 0, 0, Quality.GOOD, samples=samples)


def _angle_deg(window: RecordWindow, calls: Sequence[Reading], edges_s: Floats) -> Floats:
    """Return what the turning axis of the table has turned since the begin of a record, at the edges of its samples."""
    if "rate_deg_s" in window.conditions:
        return float(window.conditions["rate_deg_s"]) * edges_s
    first_s, last_s = window.t_start_ns / NS, window.t_end_ns / NS
    angle_deg = np.zeros(edges_s.size)
    for call in calls:
        if call.name == "turn" and first_s < call.t_s < last_s and call.arguments.keys() >= _OF_A_TURN:
            angle_deg += _trapezoid(edges_s - (call.t_s - first_s), call)
    return angle_deg


def _trapezoid(time_s: Floats, turn: Reading) -> Floats:
    """Return the angle of a turn from rest to rest with its rate and its acceleration."""
    angle, rate, acceleration = (float(turn.arguments[name]) for name in ("angle", "rate", "acceleration"))
    peak = min(rate, math.sqrt(abs(angle) * acceleration))
    ramp_s, whole_s = peak / acceleration, abs(angle) / peak + peak / acceleration
    time_s = np.clip(time_s, 0.0, whole_s)
    early, late = np.minimum(time_s, ramp_s), np.maximum(time_s - (whole_s - ramp_s), 0.0)
    way = acceleration * early**2 / 2.0 + peak * np.maximum(time_s - ramp_s, 0.0) - acceleration * late**2 / 2.0
    return math.copysign(1.0, angle) * way


def _along(window: RecordWindow) -> float:
    """Return whether the body axis turns with the table's axis or against it."""
    turned, axis = str(window.conditions.get("turned", "inner")), AXES.index(str(window.conditions["axis"]))
    return float(turn_axis_in_body(pose_of(window.number, window.conditions), turned)[axis])


def _seen(window: RecordWindow, angle_deg: Floats, vector: Floats, site: Site) -> Floats:
    """Return a vector of the local frame in body axes in the middle of each sample, (n, 3)."""
    pose = pose_of(window.number, window.conditions)
    outer, middle = turned_about(2, pose.outer_deg), turned_about(1, pose.middle_deg)
    inner, mounting = turned_about(0, pose.inner_deg), mounting_matrix(pose.mounting)
    middle_deg = (angle_deg[1:] + angle_deg[:-1]) / 2.0
    if window.conditions.get("turned", "inner") == "inner":
        fixed = inner.T @ middle.T @ outer.T @ table_to_local(site).T @ vector
        seen = _turned_back(0, middle_deg, fixed) @ mounting
    else:
        seen = _turned_back(2, middle_deg, outer.T @ table_to_local(site).T @ vector) @ middle @ inner @ mounting
    return np.round(seen, _DIGITS)


def _turned_back(axis: int, angle_deg: Floats, vector: Floats) -> Floats:
    """Return a vector as a frame sees it that turns about one of its axes, (n, 3)."""
    if not angle_deg.any():
        return np.tile(vector, (angle_deg.size, 1))
    angle, second, third = np.radians(angle_deg), (axis + 1) % 3, (axis + 2) % 3
    seen = np.empty((angle.size, 3))
    seen[:, axis] = vector[axis]
    seen[:, second] = np.cos(angle) * vector[second] + np.sin(angle) * vector[third]
    seen[:, third] = np.cos(angle) * vector[third] - np.sin(angle) * vector[second]
    return seen


def of_calibration(planned: Planned) -> Prediction:
    """Return estimates of a nominal unit with the uncertainties that a calibration will give.

    Raises:  FitError as ``analysis.analyse``, that of the fit where nothing is determined.
    """
    rows, missing = sampled_rows(nominal_material(planned, ("gyro", "accel")), ITEMS)
    parts = fitted(rows, planned.campaign)
    return Prediction(estimates_of(parts, limits_of(planned.campaign)), [*missing, *parts.missing])


def fitted(rows: Sequence[SampledRow], campaign: Document) -> Calibration:
    """Return the fits of records without noise, with the noise that is declared. Raises: FitError as ``predicted``."""
    parts = Calibration(sets_of(rows), clock_of(rows), power_on_of(rows))
    undeclared: list[str] = []
    name_missing(parts)
    for sensor in CALIBRATED:
        noise = noise_of(campaign, sensor, undeclared)
        if noise is not None:
            fit_triad(parts, sensor, campaign, noise)
    parts.missing = [*undeclared, *parts.missing]
    return parts


def of_bias(planned: Planned) -> Prediction:
    """Return estimates of a nominal unit with the uncertainties that its records at rest will give.

    Stability and repeatability are the expected ones of the declared noise.

    Raises:  FitError as ``bias.analyse``.
    """
    material = nominal_material(planned, ("gyro", "accel"))
    rows, missing = sampled_rows(material, AT_REST)
    by_item = {item: [row for row in rows if row.item == item] for item in AT_REST}
    missing += [say("missing.item", item=item) for item in AT_REST if not by_item[item]]
    found = {sensor.kind: noise_of(planned.campaign, sensor, missing) for sensor in (GYRO, ACCELEROMETER)}
    declared = {kind: noise for kind, noise in found.items() if noise is not None}
    estimates = gyro_estimates(by_item["bias"], material, missing, declared)
    estimates += flip_estimates(by_item["flip"], material, missing, [], declared)
    estimates += stability_estimates(by_item["stability"], limits_of(planned.campaign), missing, declared)[1]
    estimates += repeatability_estimates(by_item["repeatability"], missing, declared)
    return Prediction(estimates, missing)


def of_magnetometer(planned: Planned) -> Prediction:
    """Return estimates of a nominal unit with the uncertainties that a calibration of the magnetometer will give.

    Raises:  FitError B-GNC-008 without declared noise or field; else as ``magnetometer.analyse``.
    """
    noise = magnetic_noise(planned.campaign)
    rows, missing = sampled_rows(nominal_material(planned, ("mag",)), OF_FIELD)
    fits, attitudes = turns_of(rows, missing, noise), attitudes_of(rows)
    sphere = sphere_of(attitudes, noise=noise) if attitudes else Sphere(missing=[say("note.no_attitudes")])
    plane, limit_deg = fits[0][1], limits_of(planned.campaign)["roll_error"]
    answers = nominal_answers(planned.exchanges, plane.ellipse.parameters.radius)
    rolls = roll_estimates(answers, plane.by_method, ELLIPSE, limit_deg, noise)
    return Prediction(plane_estimates(fits) + rolls + sphere.estimates, [*missing, *sphere.missing])


def of_unit_test(planned: Planned) -> Prediction:
    """Return measured values of nominal modules with the uncertainties that their tests will give.

    Raises:  FitError B-GNC-001 for limits that are not usable.
    """
    limits, missing = limits_of(planned.campaign), list[str]()
    of_units: dict[str, dict[str, list[Answer]]] = {}
    for exchange in planned.exchanges:
        if exchange.item == exchange.name in ("timer", "imu"):
            asked = asked_of(exchange)
            if not asked:
                missing.append(say("predicted.other_request", item=exchange.item, length=len(exchange.sent)))
                continue
            unit = unit_of(exchange.conditions, str(planned.campaign["uut"]["serial"]))
            of_units.setdefault(unit, {}).setdefault(exchange.item, []).append(Answer(exchange, asked, {}))
    asked_imu = any("imu" in items for items in of_units.values())
    sensors = (GYRO, ACCELEROMETER) if asked_imu else ()
    noise = {sensor.prefix: noise_of(planned.campaign, sensor, missing) for sensor in sensors}
    estimates: Estimates = []
    for unit, items in of_units.items():
        for item, answers in items.items():
            fields = [_on_time(one) if item == "timer" else _at_rest(one, noise) for one in answers]
            nominal = [replace(one, fields=of) for one, of in zip(answers, fields, strict=True)]
            found = judge(item, nominal, Rules(limits, {}, {}))
            estimates += values_of_item(ItemResult(item, found, len(answers)), {UNIT: unit})
    return Prediction([entry for entry in estimates if entry.std_uncertainty > 0.0], list(dict.fromkeys(missing)))


def _on_time(answer: Answer) -> dict[str, Any]:
    setting_us, ticks = answer.asked["setting_us"], answer.asked["ticks"]
    return {"intervals_us": [setting_us] * ticks, "interrupts": ticks}


def _at_rest(answer: Answer, noise: Mapping[str, SensorNoise | None]) -> dict[str, Any]:
    """Return means and extremes of a module at rest; sensors whose noise is not declared have none."""
    samples = int(answer.asked["samples"])
    fields: dict[str, Any] = {"samples": samples}
    for name, mean in _AT_REST.items():
        declared = noise[name]
        std = 0.0 if declared is None else math.sqrt(declared.density / declared.interval_s)
        reach = std * expected_range(samples) / 2.0 if samples > 1 else 0.0
        fields |= {name: mean, f"{name}_low": mean - reach, f"{name}_high": mean + reach}
        fields[f"{name}_temperature"] = _LABORATORY_degC
    return fields
