"""A small synthetic log of the shape of a real one, and a mapping for it; made here, without the code under test."""

from __future__ import annotations

from pathlib import Path

import numpy as np

SHORT = """\
mapping: any_log
uut: {model: M, serial: S-1}
columns:
  time: {role: time, format: iso, zone: UTC}
  T: {role: temperature, quantity: sensor, unit: degC}
  U: {role: reading, quantity: voltage, unit: mV}
"""
LOG = "time,T,U\n2024-01-01T00:00:00,20.5,1000\n2024-01-01T00:00:10,20.6,1001\n"

RAMP = """\
mapping: ramp
title: a small ramp
uut: {model: M, serial: "7"}
analysis: temperature_ramp
reference_temperature: 25 degC
file: {delimiter: ";"}
overload: {at_least: 1.0e+37}
columns:
  date: {role: time, format: "%d/%m/%Y-%H:%M:%S", zone: UTC}
  set: {role: set_point, quantity: set_point, unit: degC}
  s1: {role: temperature, quantity: sensor_1, unit: degC}
  s2: {role: temperature, quantity: sensor_2, unit: degC}
  ref: {role: reference, quantity: standard, unit: V}
  dmm: {role: reading, quantity: meter, unit: V}
"""
STEP_s, HOLD_s, RAMP_s = 60.0, 7200.0, 18000.0
LOW_degC, HIGH_degC = 20.0, 35.0
LAG_s = 1800.0


def programme(t_s: np.ndarray) -> np.ndarray:
    """Hold, up, hold, down, hold."""
    corners_s = np.cumsum([0.0, HOLD_s, RAMP_s, HOLD_s, RAMP_s, HOLD_s])
    return np.interp(t_s, corners_s, [LOW_degC, LOW_degC, HIGH_degC, HIGH_degC, LOW_degC, LOW_degC])


def lagging(t_s: np.ndarray, lag_s: float) -> np.ndarray:
    """The programme behind a first-order lag, by small Euler steps."""
    fine_s = np.arange(0.0, t_s[-1] + 1.0, 1.0)
    drive, out = programme(fine_s), np.empty_like(fine_s)
    value = drive[0]
    for index, now in enumerate(drive):
        value += (now - value) / lag_s
        out[index] = value
    return np.interp(t_s, fine_s, out)


def ramp_rows(seed: int, *, step_ppm: float = 0.0, lag_s: float = 0.0) -> dict[str, np.ndarray]:
    """Columns of a ramp: cubic in the (lagging) temperature, quadratic in time, a step between up and down."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 3 * HOLD_s + 2 * RAMP_s, STEP_s)
    sensor = programme(t_s)
    felt = lagging(t_s, lag_s) if lag_s else sensor
    x, hours = felt - 25.0, (t_s - t_s[-1] / 2) / 3600.0
    going = np.sign(np.gradient(programme(t_s)))
    ppm = 0.6 * x + 0.01 * x**2 - 1e-3 * x**3 + 0.05 * hours - 0.005 * hours**2 + step_ppm * going / 2.0
    ppm += rng.normal(0.0, 0.05, t_s.size)
    standard = 1.0 + 1e-6 * np.cumsum(rng.normal(0.0, 0.02, t_s.size))
    return {
        "t_s": t_s,
        "set": programme(t_s),
        "s1": sensor + 0.1,
        "s2": sensor - 0.1,
        "ref": standard,
        "dmm": standard * (1.0 + 1e-6 * ppm),
    }


def write_ramp(path: Path, rows: dict[str, np.ndarray]) -> Path:
    """The log as text: overload sentinels in its first row, a trailing delimiter, CR LF line ends."""
    lines = ["date;set;s1;s2;ref;dmm;"]
    start = np.datetime64("2024-10-20T01:18:45")
    for index, t_s in enumerate(rows["t_s"]):
        when = (start + np.timedelta64(int(t_s), "s")).item().strftime("%d/%m/%Y-%H:%M:%S")
        values = [rows[name][index] for name in ("set", "s1", "s2")]
        volts = [-1e38, 9.9e37] if index == 0 else [rows["ref"][index], rows["dmm"][index]]
        fields = [when, *(f"{one:.4f}" for one in values), *(f"{one:.12e}" for one in volts)]
        lines.append(";".join(fields) + ";")
    path.write_bytes("\r\n".join([*lines, ""]).encode())
    return path
