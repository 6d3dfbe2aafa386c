"""Planned records with the samples that a unit without error and noise would give in the planned poses and motions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.analysis import CONTINUES, Floats, Material, Planned, Reading
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow, Samples
from bench.systems.gnc.estimators.earth_rate import (
    Site,
    earth_rate_local_deg_s,
    mounting_matrix,
    table_to_local,
    turn_axis_in_body,
    turned_about,
)
from bench.systems.gnc.predicted.declared import field_local_gauss
from bench.systems.gnc.rows import AXES, gravity_g, pose_of, site_of

_DIGITS = 12  # a sine of half a turn is zero: what its rounding leaves would determine a sensitivity
_OF_A_TURN = {"angle", "rate", "acceleration"}
_UNITS = {"gyro": "deg/s", "accel": "g", "mag": "gauss"}


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
        return np.asarray(float(window.conditions["rate_deg_s"]) * edges_s)
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
    return np.asarray(math.copysign(1.0, angle) * way)


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
    return np.asarray(np.round(seen, _DIGITS))


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
