"""Full-size sweeps of seeds against the simulated truth: scale factors and the bias ramp."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

LIMIT_GAIN_OFF_PPM = {"gyro": 8.0, "accelerometer": 5.0}
LIMIT_TABLE_2_PPM = {"gyro": 45.0, "accelerometer": 45.0}
ASYMMETRY_LIMIT_PPM = 0.25
SEEDS = range(1, 21)
OFF_SEEDS = (1, 2, 3)
JUDGED = ("hysteresis_width", "play_half_width", "thermal_lag")


def campaign(
    out: Path, sequence: str, seed: int, *settings: str
) -> tuple[list[dict[str, Any]], dict[tuple[Any, ...], float]]:
    """Estimates and truth of one campaign; the measured temperature of the unit is no part of the place of a value."""
    command = [sys.executable, "-m", "bench", "run", sequence, "--truth", "--seed", str(seed), "--out", str(out)]
    command += [word for setting in settings for word in ("--set", setting)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(next(out.glob("*/results.json")).read_text())["estimates"]
    truth = json.loads(next(out.glob("*.truth.json")).read_text())["estimates"]
    return found, {_key(one): one["value"] for one in truth}


def _key(estimate: dict[str, Any]) -> tuple[Any, ...]:
    conditions = {name: value for name, value in estimate["conditions"].items() if name != "unit_temperature_degC"}
    return estimate["quantity"], *sorted(conditions.items())


@pytest.mark.sweep
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("settings", "limits_ppm"), [(("world.calibrator_gain=off",), LIMIT_GAIN_OFF_PPM), ((), LIMIT_TABLE_2_PPM)]
)
def test_scale_factors_against_truth(
    tmp_path: Path, seed: int, settings: tuple[str, ...], limits_ppm: dict[str, float]
) -> None:
    """With the gain of table 2, and without it."""
    found, truth = campaign(tmp_path, "scale_factor_38h", seed, *settings)
    worst: dict[tuple[str, str], float] = {}
    for one in found:
        if one["quantity"] in ("dsf_n", "dsf_p", "dsf_asymmetry"):
            name = one["quantity"], one["conditions"]["kind"]
            worst[name] = max(worst.get(name, 0.0), abs(one["value"] - truth[_key(one)]))
    print(f"seed {seed}, {settings}: {worst}")
    assert len(worst) == 6
    for (quantity, kind), error_ppm in worst.items():
        limit = ASYMMETRY_LIMIT_PPM if quantity == "dsf_asymmetry" else limits_ppm[kind]
        assert error_ppm < limit, (quantity, kind, error_ppm)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", SEEDS)
def test_campaign_against_truth(tmp_path: Path, seed: int) -> None:
    found, truth = campaign(tmp_path, "bias_ramp_25h", seed)
    known = [(one, one["value"] - truth[_key(one)]) for one in found if _key(one) in truth]
    assert {one["quantity"] for one, _ in known} >= {"bias", "bias_tc1", "master_clock_error", *JUDGED}
    widths = [error for one, error in known if one["quantity"] == "hysteresis_width"]
    print(f"seed {seed}: mean width error {np.mean(widths) * 1e9:.3f} nA")
    assert len(widths) == 10
    assert abs(np.mean(widths)) < 1e-9
    for one, error in known:
        limit = {"bias": 4e-9, "bias_tc1": 1e-10}.get(one["quantity"])
        if limit is not None:
            assert abs(error) < limit, one
        if one["quantity"] in JUDGED:
            assert abs(error) < 5 * one["std_uncertainty"], one


@pytest.mark.sweep
@pytest.mark.parametrize("seed", OFF_SEEDS)
def test_a_unit_without_hysteresis_shows_none(tmp_path: Path, seed: int) -> None:
    found, _ = campaign(tmp_path, "bias_ramp_25h", seed, "world.hysteresis=off")
    assert not [one for one in found if one["quantity"] == "play_half_width"]
    lags = [one for one in found if one["quantity"] == "thermal_lag"]
    assert len(lags) == 10
    for one in found:
        if one["quantity"] == "hysteresis_width":
            assert abs(one["value"]) < 4 * one["std_uncertainty"], one
