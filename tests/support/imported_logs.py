"""Logs as the tests import them: a mapping and a file, the session they become; recordings of other people."""

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.analysis import Estimate, estimates
from bench.commands.import_log import import_log
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.replay.series import replay_series

MAPPINGS = Path(__file__).resolve().parents[2] / "docs" / "mappings"


def parsed(mapping: str) -> Any:
    """Return the model of the text of a mapping. Raises: InputErrors."""
    return parse_yaml(mapping, "m.yaml", mapping_model()).model


def imported(folder: Path, mapping: str | Path, log: str | bytes, status: int | None = 0) -> Path:
    """Import a log by the text or the file of a mapping and return its session.

    ``status``: what the command ends with, None if whatever it is.
    """
    path = folder / "m.yaml" if isinstance(mapping, str) else mapping
    if isinstance(mapping, str):
        path.write_text(mapping, encoding="utf-8")
    (folder / "log").write_bytes(log.encode() if isinstance(log, str) else log)
    assert import_log(path, folder / "log", folder / "out") == status or status is None
    (session,) = (each for each in (folder / "out").iterdir() if each.is_dir())
    return session


def table(names: str, rows: Any, form: str = "%.17g") -> str:
    """Return lines of comma-separated values, empty where they are not a number."""
    return "\n".join([names, *(",".join("" if np.isnan(value) else form % value for value in row) for row in rows)])


def estimates_of(session: Path) -> list[Estimate]:
    """Return the estimates of a session."""
    return estimates.estimates_of(json.loads((session / "results.json").read_bytes()))


def columns_of(session: Path) -> Mapping[str, Any]:
    """Return what is read back of a session, in base units."""
    return replay_series(session).columns


def of_mirror(repository: str, name: str) -> bytes:
    """Return a file of another project, of the copy that $BENCH_CAPTURES names; without one the test is skipped."""
    folder = Path(os.environ.get("BENCH_CAPTURES", "/nowhere")) / repository / "repo"
    if not folder.is_dir():
        pytest.skip(f"no {folder}: name the folder of its copy in BENCH_CAPTURES")
    return subprocess.run(["git", "-C", folder, "show", f"HEAD:{name}"], capture_output=True, check=True).stdout


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
