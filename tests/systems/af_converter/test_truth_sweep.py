"""The whole 38-hour campaign against the simulated truth, through drivers, ports, frames, records and fit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

LIMIT_GAIN_OFF_PPM = {"gyro": 8.0, "accelerometer": 5.0}
LIMIT_TABLE_2_PPM = 45.0
ASYMMETRY_LIMIT_PPM = 0.25
SEEDS = range(1, 21)


def worst_errors(out: Path, seed: int, *settings: str) -> dict[tuple[str, str], float]:
    """Largest absolute error per quantity and kind of one campaign, ppm."""
    command = [sys.executable, "-m", "bench", "run", "scale_factor_38h", "--truth"]
    command += ["--seed", str(seed), "--out", str(out)]
    command += [word for setting in settings for word in ("--set", setting)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(next(out.glob("*/results.json")).read_text())["estimates"]
    truth = json.loads(next(out.glob("*.truth.json")).read_text())["estimates"]
    expected = {_key(one): one["value"] for one in truth}
    worst: dict[tuple[str, str], float] = {}
    for one in found:
        if one["quantity"] in ("dsf_n", "dsf_p", "dsf_asymmetry"):
            name = one["quantity"], one["conditions"]["kind"]
            worst[name] = max(worst.get(name, 0.0), abs(one["value"] - expected[_key(one)]))
    assert len(worst) == 6
    return worst


def _key(estimate: dict[str, Any]) -> tuple[Any, ...]:
    conditions = estimate["conditions"]
    return estimate["quantity"], conditions.get("channel"), conditions.get("temperature_degC")


@pytest.mark.sweep
@pytest.mark.parametrize("seed", SEEDS)
def test_gain_off(tmp_path: Path, seed: int) -> None:
    worst = worst_errors(tmp_path, seed, "world.calibrator_gain=off")
    print(f"seed {seed}, gain off: {worst}")
    for (quantity, kind), error_ppm in worst.items():
        limit = ASYMMETRY_LIMIT_PPM if quantity == "dsf_asymmetry" else LIMIT_GAIN_OFF_PPM[kind]
        assert error_ppm < limit, (quantity, kind, error_ppm)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", SEEDS)
def test_table_2_gain(tmp_path: Path, seed: int) -> None:
    worst = worst_errors(tmp_path, seed)
    print(f"seed {seed}, Table 2 gain: {worst}")
    for (quantity, kind), error_ppm in worst.items():
        limit = ASYMMETRY_LIMIT_PPM if quantity == "dsf_asymmetry" else LIMIT_TABLE_2_PPM
        assert error_ppm < limit, (quantity, kind, error_ppm)
