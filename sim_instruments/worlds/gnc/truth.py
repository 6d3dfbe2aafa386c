"""Simulated truth of the sensors of GNC modules: what a perfect analysis of the records would find.

Nothing of the product reads it. Each campaign's records say by their condition ``item`` what they are for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.world import entry
from sim_instruments.worlds.gnc.imu import ACCEL_LSB_G, GYRO_LSB_DEG_S, SAMPLE_NS, GncImu
from sim_instruments.worlds.gnc.imu_errors import (
    MEAN_INTERVAL_S,
    SLOW_ACCEL_G,
    SLOW_ACCEL_S,
    SLOW_GYRO_DEG_S,
    SLOW_GYRO_S,
    Triad,
)
from sim_instruments.worlds.gnc.magnetometer import field_gauss

Entry = dict[str, Any]

AXES = "xyz"
S_PER_H = 3600.0
_POINT_NS = NS // 2  # true values are averaged over points so far apart


def estimates(modules: Mapping[str, GncImu], windows: Sequence[RecordWindow]) -> list[Entry]:
    """Return true values in the contract's form.

    Biases of a calibration (positions, rotations) are those of a = K N + bias and w = K N - bias. Biases of a unit that
    was only observed at rest (bias, flip) have the same signs and are those of the indicated values: S b.

    Args:
        modules: sensors by the serial number of the module.
        windows: all records; a condition ``unit`` names the module where there are several.
    """
    entries: list[Entry] = []
    for unit, own in _by_unit(windows).items():
        module = modules.get(unit) if unit else next(iter(modules.values()), None)
        if module is not None:
            extra = {"unit": unit} if unit else {}
            entries += [{**value, "conditions": {**extra, **value["conditions"]}} for value in _of_module(module, own)]
    return entries


def _by_unit(windows: Sequence[RecordWindow]) -> dict[str, list[RecordWindow]]:
    groups: dict[str, list[RecordWindow]] = {}
    for window in windows:
        groups.setdefault(str(window.conditions.get("unit", "")), []).append(window)
    return groups


def _of_module(module: GncImu, windows: Sequence[RecordWindow]) -> list[Entry]:
    by_item: dict[str, list[RecordWindow]] = {}
    for window in windows:
        by_item.setdefault(str(window.conditions.get("item", "")), []).append(window)
    entries: list[Entry] = []
    if positions := by_item.get("position"):
        entries += _triad("accel", module.errors.accel, _degC(module, positions))
        entries += _by_axis("accel_bias", "g", -_mean(module.accel_bias_g, positions), "accel")
    if rotations := by_item.get("rotation"):
        entries += _triad("gyro", module.errors.gyro, _degC(module, rotations))
        entries += _gyro_bias_of_rotations(module, rotations)
    if still := by_item.get("bias"):
        indicated = _at_no_input(module.errors.gyro, _mean(module.gyro_bias_deg_s, still), _degC(module, still))
        entries += _by_axis("gyro_bias", "deg/h", indicated * S_PER_H, "gyro")
    if flips := by_item.get("flip"):
        indicated = _at_no_input(module.errors.accel, _mean(module.accel_bias_g, flips), _degC(module, flips))
        entries += _by_axis("accel_bias", "g", -indicated, "accel")
    for window in by_item.get("stability", ()):
        entries += _stability(module, window)
    if repeats := by_item.get("repeatability"):
        entries += _repeatability(module, repeats)
    if turned := by_item.get("magnetometer"):
        entries += _magnetometer(module, turned)
    return [*entries, *_random_walks(module)] if entries else []


def _triad(name: str, triad: Triad, degC: float) -> Iterator[Entry]:
    """Yield matrix, scale errors and cross coupling at one temperature."""
    sensitivity = triad.sensitivity_at(np.array([degC]))[0]
    matrix = np.linalg.inv(sensitivity)
    kind = _kind(name)
    for row, column in np.ndindex(3, 3):
        place = {**kind, "row": AXES[row], "column": AXES[column]}
        yield entry(f"{name}_matrix", "1", matrix[row, column], place)
        if row != column:
            yield entry(f"{name}_cross_coupling", "1", sensitivity[row, column], place)
    for axis in range(3):
        error_ppm = 1e6 * (sensitivity[axis, axis] - 1.0)
        yield entry(f"{name}_scale_error", "ppm", error_ppm, {**kind, "axis": AXES[axis]})


def _mean(bias: Callable[[Integers], Floats], windows: Sequence[RecordWindow]) -> Floats:
    return bias(_times_ns(windows)).mean(axis=0)


def _at_no_input(triad: Triad, bias: Floats, degC: float) -> Floats:
    """Return what sensors with this b indicate without any input, (3,)."""
    return triad.sensitivity_at(np.array([degC]))[0] @ bias


def _gyro_bias_of_rotations(module: GncImu, windows: Sequence[RecordWindow]) -> Iterator[Entry]:
    """Return the bias of w = K N - bias, of each axis over the rotations about the other two, where it is read."""
    means = []
    for axis, name in enumerate(AXES):
        others = [w for w in windows if w.conditions.get("axis") != name] or windows
        means.append(module.gyro_bias_deg_s(_times_ns(others))[:, axis].mean() * S_PER_H)
    return _by_axis("gyro_bias", "deg/h", means, "gyro")


def _stability(module: GncImu, window: RecordWindow) -> Iterator[Entry]:
    """Yield expected standard deviation of the 10 s means of one record: white, slow and rounding noise, warm unit."""
    means = int((window.t_end_ns - window.t_start_ns) / NS / MEAN_INTERVAL_S + 1e-6)
    if means > 1 and module.options.noise:
        gyro = _scatter(module.errors.gyro, GYRO_LSB_DEG_S, SLOW_GYRO_DEG_S, (SLOW_GYRO_S,), means)
        accel = _scatter(module.errors.accel, ACCEL_LSB_G, SLOW_ACCEL_G, SLOW_ACCEL_S, means)
        yield from _by_axis("gyro_bias_stability", "deg/h", gyro * S_PER_H, "gyro")
        yield from _by_axis("accel_bias_stability", "mg", accel * 1e3, "accel")


def _scatter(triad: Triad, lsb: float, slow: float, times_s: Sequence[float], means: int) -> Floats:
    """Return root of the expected sample variance of consecutive 10 s means of each sensor, (3,)."""
    length_s = means * MEAN_INTERVAL_S
    gain = (triad.sensitivity**2).sum(axis=1) * slow**2
    rounding = lsb**2 / 12.0 * SAMPLE_NS / NS
    variance = (triad.white**2 + rounding) / MEAN_INTERVAL_S
    for time_s in times_s:
        rest = _variance_of_mean(MEAN_INTERVAL_S / time_s) - _variance_of_mean(length_s / time_s)
        variance = variance + gain * rest * means / (means - 1)
    return np.sqrt(variance)


def _variance_of_mean(length: float) -> float:
    """Return variance of the mean of a Gauss-Markov process of unit variance over so many correlation times."""
    return float(2.0 / length * (1.0 + np.expm1(-length) / length))


def _repeatability(module: GncImu, windows: Sequence[RecordWindow]) -> Iterator[Entry]:
    """Yield standard deviation (n - 1) of the true mean biases of the records; without their white noise."""
    groups: dict[Any, list[RecordWindow]] = {}
    for window in windows:
        groups.setdefault(window.conditions.get("repeat_index", window.number), []).append(window)
    if len(groups) > 1:
        times = [_times_ns(group) for group in groups.values()]
        gyro = np.std([module.gyro_bias_deg_s(t).mean(axis=0) for t in times], axis=0, ddof=1)
        accel = np.std([module.accel_bias_g(t).mean(axis=0) for t in times], axis=0, ddof=1)
        yield from _by_axis("gyro_bias_repeatability", "deg/h", gyro * S_PER_H, "gyro")
        yield from _by_axis("accel_bias_repeatability", "mg", accel * 1e3, "accel")


def _magnetometer(module: GncImu, windows: Sequence[RecordWindow]) -> Iterator[Entry]:
    """Yield the sensor itself, in Earth's field alone: what a table of steel adds is an error of the measurement."""
    mounting = str(windows[0].conditions.get("mounting", module.surroundings.mounting))
    tilt, times_ns = module.errors.tilt(mounting), _times_ns(windows)
    field = field_gauss(module.surroundings.motion, "non_magnetic", module.site, module.earth, tilt, times_ns, mounting)
    plane = module.magnetometer.in_plane(float(np.hypot(*field[:, :2].T).mean()), float(field[:, 2].mean()))
    kind = _kind("mag")
    matrix = np.linalg.inv(module.magnetometer.matrix)
    for axis in range(2):
        yield entry("mag_offset", "gauss", plane.offset_gauss[axis], {**kind, "axis": AXES[axis]})
    yield entry("mag_gain", "1", plane.gain, kind)
    yield entry("mag_angle", "deg", plane.angle_deg, kind)
    yield entry("mag_radius", "gauss", plane.radius_gauss, kind)
    yield entry("mag_roll_offset", "deg", plane.roll_deg, kind)
    for axis, offset_gauss in zip(AXES, module.magnetometer.offset_gauss, strict=True):
        yield entry("mag_hard_iron", "gauss", float(offset_gauss), {**kind, "axis": axis})
    for row, column in np.ndindex(3, 3):
        yield entry("mag_matrix", "1", matrix[row, column], {**kind, "row": AXES[row], "column": AXES[column]})


def _random_walks(module: GncImu) -> Iterator[Entry]:
    yield from _by_axis("angle_random_walk", "deg/rt_h", module.errors.gyro.white * 60.0, "gyro")
    yield from _by_axis("velocity_random_walk", "mg/rt_Hz", module.errors.accel.white * 1e3, "accel")


def _by_axis(quantity: str, unit: str, values: Iterable[float], name: str) -> Iterator[Entry]:
    return (
        entry(quantity, unit, value, {**_kind(name), "axis": axis}) for axis, value in zip(AXES, values, strict=True)
    )


def _kind(name: str) -> dict[str, str]:
    return {"kind": {"accel": "accelerometer", "gyro": "gyro", "mag": "magnetometer"}[name]}


def _degC(module: GncImu, windows: Sequence[RecordWindow]) -> float:
    return float(module.temperature_degC(_times_ns(windows)).mean())


def _times_ns(windows: Sequence[RecordWindow]) -> Integers:
    """Return middles of equal parts of about half a second, over all windows."""
    times = []
    for window in windows:
        count = max(2, round((window.t_end_ns - window.t_start_ns) / _POINT_NS))
        edges = np.linspace(window.t_start_ns, window.t_end_ns, count + 1)
        times.append(((edges[:-1] + edges[1:]) / 2.0).astype(np.int64))
    return np.concatenate(times)
