"""Analysis rlg_count_log: counts of a rate with known noise, rounded to whole counts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench.commands.import_log import import_log
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model

MAPPING = """\
mapping: ring_laser
uut: {model: RLG, serial: S-1}
analysis: rlg_count_log
count_scale: 1.11 arcsec
columns:
  row: {role: time, format: rows, rate: 10 Hz, start: 2024-01-01T00:00:00Z}
  n: {role: count}
"""
WALK, RATE_deg_h, SCALE_arcsec = 0.02, 9.7, 1.11  # deg/sqrt(h)


def counts() -> np.ndarray:
    """Two hours at 10 Hz: the angle is a drift of the Earth's rate and a random walk, floored to counts."""
    rng = np.random.default_rng(30)
    step_s, count = 0.1, 72_000
    walk_arcsec = 3600.0 * WALK / 60.0 * np.sqrt(step_s)  # deg/sqrt(h) is 60 arcsec/sqrt(s)
    angle = np.cumsum(RATE_deg_h * step_s + rng.normal(0.0, walk_arcsec, count))
    return np.floor(angle / SCALE_arcsec)


def found(folder: Path, mapping: str, values: np.ndarray, status: int = 0) -> dict[str, dict[str, float]]:
    (folder / "m.yaml").write_text(mapping, encoding="utf-8")
    np.savetxt(folder / "log.csv", values, header="n", comments="", fmt="%d")
    assert import_log(folder / "m.yaml", folder / "log.csv", folder / "out") == status
    (results,) = (folder / "out").glob("*/results.json")
    return {one["quantity"]: one for one in json.loads(results.read_text(encoding="utf-8"))["estimates"]}


@pytest.mark.parametrize("role", ["count", "count_increment"])
def test_rate_walk_and_quantisation_are_those_it_was_made_of(role: str, tmp_path: Path) -> None:
    values = counts() if role == "count" else np.diff(counts())
    entries = found(tmp_path, MAPPING.replace("role: count", f"role: {role}"), values)
    walk, rate, steps = (entries[name] for name in ("angle_random_walk", "mean_rate", "quantisation_noise"))
    assert walk["value"] == pytest.approx(WALK, abs=1.5 * walk["expanded_uncertainty"])
    assert walk["expanded_uncertainty"] < 0.1 * WALK
    assert rate["value"] == pytest.approx(RATE_deg_h, abs=1.5 * rate["expanded_uncertainty"])
    assert steps["value"] == pytest.approx(SCALE_arcsec / np.sqrt(12.0), rel=0.05)  # a uniform error of one count


def flicker(count: int, seed: int) -> np.ndarray:
    """Noise of the two-sided density B^2 / (2 pi f), B = 1: half an integral of unit white noise (Hosking, Kasdin)."""
    lags = np.arange(1, 2 * count)
    weights = np.concatenate(([1.0], np.cumprod((lags - 0.5) / lags)))
    white = np.random.default_rng(seed).normal(0.0, 1.0, 2 * count)
    size = 4 * count
    return np.fft.irfft(np.fft.rfft(weights, size) * np.fft.rfft(white, size), size)[count : 2 * count]


def test_the_bias_leaves_an_alignment_error_where_the_log_shows_one(tmp_path: Path) -> None:
    """Against the heading of two level gyroscopes that the Earth turns, one of them with this bias."""
    bias_deg_h, latitude_deg, step_s = 0.5, 37.0, 0.1
    rate = RATE_deg_h + bias_deg_h * flicker(2**16, 4)  # deg/h, arcsec/s alike
    values = np.floor(np.cumsum(rate * step_s) / 0.001)
    mapping = MAPPING.replace("1.11 arcsec", "0.001 arcsec")
    stated = mapping + f"laser: {{path_length: 28 cm, latitude: {latitude_deg:g} deg}}\n"
    entries = found(tmp_path, stated, values)
    bias, error = entries["bias_instability"], entries["bias_alignment_error"]
    assert bias["value"] == pytest.approx(bias_deg_h, abs=1.5 * bias["expanded_uncertainty"])
    level_deg_h = 15.041 * np.cos(np.deg2rad(latitude_deg))
    north, east = level_deg_h, bias["value"]  # of a unit that points north
    assert error["value"] == pytest.approx(np.rad2deg(np.arctan2(east, north)), rel=2e-3)
    assert error["std_uncertainty"] / error["value"] == pytest.approx(bias["std_uncertainty"] / bias["value"])


def test_a_log_of_a_random_walk_alone_states_no_bias(tmp_path: Path) -> None:
    entries = found(tmp_path, MAPPING + "laser: {path_length: 28 cm, latitude: 37 deg}\n", counts())
    assert "bias_alignment_error" not in entries


def test_a_counter_that_stands_still_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FitError, match=r"B-FIT-169: .*the same number in every interval"):
        found(tmp_path, MAPPING, np.arange(1000))


def test_what_is_no_record_of_counts_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FitError, match=r"B-FIT-169: .*2 rows are too few"):
        found(tmp_path, MAPPING, np.arange(2))
    uneven = MAPPING.replace(
        "row: {role: time, format: rows, rate: 10 Hz", "n2: {role: time, format: samples, rate: 1 Hz"
    )
    (tmp_path / "m2.yaml").write_text(uneven.replace("n2:", '"t":'), encoding="utf-8")
    (tmp_path / "log2.csv").write_text("t,n\n0,1\n1,2\n5,3\n6,4\n7,5\n")
    with pytest.raises(FitError, match=r"B-FIT-169: .*the rows do not lie"):
        import_log(tmp_path / "m2.yaml", tmp_path / "log2.csv", tmp_path / "out")
    with pytest.raises(InputErrors, match="'count_scale'"):
        parse_yaml(MAPPING.replace("count_scale: 1.11 arcsec\n", ""), "m.yaml", mapping_model())
