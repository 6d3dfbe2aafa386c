"""Analysis north_log: samples and readings made of the formula of a gyroscope that turns about the vertical."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench.commands.import_log import import_log
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model

SAMPLES = """\
mapping: north
uut: {model: FOG, serial: S-1}
analysis: north_log
columns:
  t: {role: time, format: elapsed, unit: s, start: 2024-01-01T00:00:00Z}
  U: {role: output, unit: mV}
  angle: {role: encoder, unit: deg}
"""
READINGS = """\
mapping: north
uut: {model: FOG, serial: S-1}
analysis: north_log
turntable: counter_clockwise
columns:
  t: {role: time, format: elapsed, unit: s, start: 2024-01-01T00:00:00Z}
  a: {role: lock_in_1, unit: mV}
  b: {role: lock_in_2, unit: mV}
  k: {role: index}
"""


def found(folder: Path, mapping: str, header: str, table: np.ndarray, status: int = 0) -> list[dict[str, float]]:
    (folder / "m.yaml").write_text(mapping, encoding="utf-8")
    np.savetxt(folder / "log.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    assert import_log(folder / "m.yaml", folder / "log.csv", folder / "out") == status
    (results,) = (folder / "out").glob("*/results.json")
    return list(json.loads(results.read_text(encoding="utf-8"))["estimates"])


def samples(heading_deg: float, sense: int, noise: float = 0.5) -> np.ndarray:
    """A turn a second for 60 s at 500 Hz: 1 V cos(H0 - theta), offset, noise; the paper's equation (1)."""
    t_s = np.arange(0.0, 60.0, 0.002)
    theta = np.mod(sense * 360.0 * t_s, 360.0)
    volts = np.cos(np.radians(heading_deg - theta)) + 0.3
    return np.column_stack((t_s, 1e3 * (volts + np.random.default_rng(5).normal(0.0, noise, t_s.size)), theta))


@pytest.mark.parametrize(("heading_deg", "sense"), [(63.4, 1), (181.0, -1), (359.0, 1)])
def test_samples_give_the_heading_they_were_made_with(heading_deg: float, sense: int, tmp_path: Path) -> None:
    azimuth, amplitude = found(tmp_path, SAMPLES, "t,U,angle", samples(heading_deg, sense))
    off = (azimuth["value"] - heading_deg + 180.0) % 360.0 - 180.0
    assert abs(off) < 1.5 * azimuth["expanded_uncertainty"]
    bound_deg = np.degrees(0.5 * np.sqrt(2.0 / 30_000))  # Cramer-Rao: sqrt(2/N) of noise over amplitude
    assert azimuth["std_uncertainty"] == pytest.approx(bound_deg, rel=0.05)
    assert amplitude["value"] == pytest.approx(1.0, abs=0.02)


def test_noise_alone_is_refused_and_ends_with_status_1(tmp_path: Path) -> None:
    noise = samples(63.4, 1)
    noise[:, 1] = np.random.default_rng(8).normal(0.0, 1e3, len(noise))
    azimuth, _ = found(tmp_path, SAMPLES, "t,U,angle", noise, status=1)
    assert (azimuth["quality"], azimuth["value"]) == ("refused", None)


@pytest.mark.parametrize(("turntable", "sense"), [("counter_clockwise", 1), ("clockwise", -1)])
def test_readings_of_lock_ins_give_the_heading(turntable: str, sense: int, tmp_path: Path) -> None:
    """Equations (13) and (14): phi = 90 deg - H0, or 90 deg + H0 clockwise, where lock-in 1 changes its sign."""
    heading_deg, sets = 200.0, 40
    k = np.tile(np.arange(4), sets)
    phi = np.radians(90.0 - sense * heading_deg + 90.0 * k)
    noise = np.random.default_rng(6).normal(0.0, 50.0, (2, k.size))
    table = np.column_stack((
        np.arange(k.size), sense * 1e3 * np.sin(phi) + 20.0 + noise[0], 1e3 * np.cos(phi) - 5.0 + noise[1], k,
    ))  # fmt: skip
    mapping = READINGS.replace("counter_clockwise", turntable)
    (azimuth,) = found(tmp_path, mapping, "t,a,b,k", table)
    assert azimuth["value"] == pytest.approx(heading_deg, abs=1.5 * azimuth["expanded_uncertainty"])
    assert azimuth["std_uncertainty"] == pytest.approx(np.degrees(0.05 / np.sqrt(8 * sets / 2)), rel=0.2)


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    table = np.column_stack((np.arange(8), np.ones(8), np.ones(8), [0, 1, 2, 3, 0, 1, 3, 2]))
    with pytest.raises(FitError, match=r"B-FIT-110: .*8 rows"):
        found(tmp_path, READINGS, "t,a,b,k", table)
    for old, new, said in (
        ("unit: deg}", "unit: mV}", "an encoder needs a unit of angle"),
        ("role: encoder", "role: index", "needs columns of the roles output and encoder"),
        ("role: output", "role: signal", "'time', 'output', 'encoder', 'lock_in_1'"),
    ):
        with pytest.raises(InputErrors) as raised:
            parse_yaml(SAMPLES.replace(old, new), "m.yaml", mapping_model())
        assert said in str(raised.value)
    with pytest.raises(InputErrors, match="need 'turntable"):
        parse_yaml(READINGS.replace("turntable: counter_clockwise\n", ""), "m.yaml", mapping_model())
