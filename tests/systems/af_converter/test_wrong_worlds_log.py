"""Imported ramps of wrong worlds: rivals, bad rows, gaps and sensors that stand still; right logs are not doubted.

The logs are those of support/import_sample: a programme, a lag by small Euler steps, a reading in ppm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from import_sample import RAMP, LAG_s, lagging, ramp_rows
from scipy.signal import lfilter

from bench.analysis import Analysis, Material, build_results, is_sound
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.systems.af_converter.temperature_ramp.analysis import analyse

NAMES = {"set": "set_point", "s1": "sensor_1", "s2": "sensor_2", "ref": "standard", "dmm": "meter"}
CAMPAIGN = parse_yaml(RAMP, "m.yaml", mapping_model()).model.campaign()
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
FROZEN_h = 10.0
Log = dict[str, np.ndarray]


def log(seed: int, *, lag_s: float = LAG_s, ppm: np.ndarray | float = 0.0) -> Log:
    """A log with noisy sensors; ``ppm`` is added to its reading."""
    rows = ramp_rows(seed, lag_s=lag_s)
    rng = np.random.default_rng(seed + 1000)
    for sensor in ("s1", "s2"):
        rows[sensor] = rows[sensor] + rng.normal(0.0, 0.01, rows["t_s"].size)
    rows["dmm"] = rows["dmm"] * (1.0 + 1e-6 * ppm)
    return rows


def analysed(rows: Log, method: str = "joint") -> tuple[Analysis, dict[str, Any]]:
    series = {NAMES.get(name, name): values.copy() for name, values in rows.items()}
    analysis = analyse(Material(rows=(), campaign=CAMPAIGN, standards={}, series=series), method)
    return analysis, build_results("session", analysis, {}, PROVENANCE)


def reasons(results: dict[str, Any], quantity: str) -> dict[str, str]:
    """Return sentences by code against the one estimate of a quantity."""
    (entry,) = [one for one in results["estimates"] if one["quantity"] == quantity]
    return {reason["code"]: reason["sentence"] for reason in entry["reasons"]}


def unsound(results: dict[str, Any]) -> list[Any]:
    return [one["reasons"] for one in results["estimates"] if not is_sound(one)]


def slack(temperature: np.ndarray, half_width: float) -> np.ndarray:
    """Half of (P - T) / r of a piston with slack: one from the rising branch to the falling one."""
    piston, found = float(temperature[0]), np.empty_like(temperature)
    for index, at in enumerate(temperature.tolist()):
        piston = min(max(piston, at - half_width), at + half_width)
        found[index] = (piston - at) / (2.0 * half_width)
    return found


def alike(seed: int, noise_s: float) -> np.ndarray:
    """Noise of 0.3 ppm, one value a minute, that is alike for a time."""
    kept = float(np.exp(-60.0 / noise_s))
    steps = np.random.default_rng(seed).normal(0.0, 0.3, 960)
    return lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], steps)


def test_hysteresis_of_three_plays_is_doubted() -> None:
    felt = lagging(log(0)["t_s"], LAG_s)
    _, results = analysed(log(0, ppm=20.0 / 3.0 * sum(slack(felt, half) for half in (0.3, 1.0, 2.5))))
    assert len(reasons(results, "hysteresis_width")["rival_second_thermal_lag"]) <= 200


def test_a_step_midway_is_doubted_in_every_number_that_it_moves() -> None:
    t_s = log(1)["t_s"]
    _, results = analysed(log(1, ppm=2.0 * (t_s > 0.55 * t_s[-1])))
    for quantity in ("thermal_lag", "drift_rate", "meter_tc1"):
        assert "A step at 8.8 h" in reasons(results, quantity)["rival_step"]


@pytest.mark.parametrize("world", ["a bend at 30 degC", "a width that grows with the temperature"])
@pytest.mark.parametrize("seed", range(2))
def test_a_misfit_that_the_noise_would_take_is_doubted(seed: int, world: str) -> None:
    """The bend beside noise that is alike for 100 min."""
    felt = lagging(log(seed)["t_s"], LAG_s)
    bend = 3.0 * np.maximum(0.0, felt - 30.0) + alike(seed, 6000.0)
    _, results = analysed(log(seed, ppm=bend if "bend" in world else 0.5 * (felt - 28.0) * slack(felt, 1.0)))
    assert len(reasons(results, "up_minus_down_after_drift")["rival_finer_temperature"]) <= 200


@pytest.mark.parametrize("noise_s", [0.0, 6000.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_right_log_is_not_doubted(seed: int, noise_s: float) -> None:
    """With white noise alone, and with 0.3 ppm that are alike for 100 min beside it."""
    slow = alike(seed, noise_s) if noise_s else 0.0
    assert unsound(analysed(log(seed, ppm=slow))[1]) == []


def test_a_first_row_of_junk_and_a_sensor_that_errs_once_are_named_and_left_out() -> None:
    usual = analysed(log(3), "drift")[1]["estimates"]
    rows = log(3)
    rows["dmm"][0], rows["s2"][500], rows["s1"][-1] = 18.0, 85.0, -40.0
    analysis, results = analysed(rows, "drift")
    assert {(one["n"], one["dropped"]) for one in results["estimates"] if one["n"] > 900} == {(957, 3)}
    assert any("3 of the rows: 0.000 h, 8.333 h, 15.983 h" in note for note in analysis.notes)
    assert unsound(results) == []
    for one, before in zip(results["estimates"], usual, strict=True):
        assert abs(one["value"] - before["value"]) < 0.5 * before["expanded_uncertainty"]


def test_a_row_that_came_twice_counts_once() -> None:
    rows = {name: np.insert(values, 200, values[200]) for name, values in log(3).items()}
    assert {one["dropped"] for one in analysed(rows, "drift")[0].estimates} == {1}


@pytest.mark.parametrize("sensors", [("s1",), ("s1", "s2")])
def test_a_sensor_that_froze_is_doubted(sensors: tuple[str, ...]) -> None:
    rows = log(4)
    late = rows["t_s"] > FROZEN_h * 3600.0
    for name in sensors:
        rows[name][late] = rows[name][late][0]
    _, results = analysed(rows, "drift")
    assert not any(is_sound(one) for one in results["estimates"])
    said = {reason["sentence"] for one in results["estimates"] for reason in one["reasons"]}
    for name in sensors:
        place = f"{NAMES[name]} stands still for 5.97 h from 10.02 h on"
        assert len([sentence for sentence in said if sentence.startswith(place)]) == 1


def test_a_coarse_sensor_may_stand_still_in_a_hold() -> None:
    rows = log(4)
    for name in ("s1", "s2"):
        rows[name] = np.round(rows[name], 1)
    assert unsound(analysed(rows, "drift")[1]) == []


def test_gaps_are_named() -> None:
    rows = log(5)
    kept = np.ones(rows["t_s"].size, dtype=bool)
    for first, length in ((100, 9), (300, 5), (500, 20), (700, 7)):
        kept[first : first + length] = False
    analysis, results = analysed({name: values[kept] for name, values in rows.items()}, "drift")
    assert any("4 gaps" in note and "the longest, 21.0 min, begins at 8.32 h" in note for note in analysis.notes)
    assert unsound(results) == []
