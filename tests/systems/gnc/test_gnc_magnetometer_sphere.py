"""Hard and soft iron of a simulated magnetometer in many attitudes, against what was put into it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import sqrtm
from typer.testing import CliRunner

from bench.cli import app

SHORT = ["--set", "warm_up=2 s", "--set", "record_time=30 s", "--set", "attitude_time=25 s"]
AXES = "xyz"


def run(out: Path, *settings: str, exit_code: int = 0) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    words = ["run", "gnc_magnetometer", "--clock", "virtual", "--seed", "5", "--truth", "--out", str(out), *settings]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == exit_code, result.output
    (folder,) = (path for path in out.iterdir() if path.is_dir())
    truth = json.loads(Path(f"{folder}.truth.json").read_text())
    return json.loads((folder / "results.json").read_text()), truth["estimates"] if isinstance(truth, dict) else truth


def value_of(estimates: list[dict[str, Any]], quantity: str, **conditions: str) -> dict[str, Any]:
    (found,) = (
        one for one in estimates
        if one["quantity"] == quantity and conditions.items() <= one["conditions"].items()
    )  # fmt: skip
    return found


def test_the_ellipsoid_is_the_sensor_that_was_simulated(tmp_path: Path) -> None:
    """B = K (v - b): hard iron b, and the symmetric root of K^T K, scaled so that it keeps volumes."""
    results, truth = run(tmp_path, *SHORT)
    matrix = np.array([[value_of(truth, "mag_matrix", row=r, column=c)["value"] for c in AXES] for r in AXES])
    due = np.real(sqrtm(matrix.T @ matrix)) / np.linalg.det(matrix) ** (1 / 3)
    scores = []
    for row, name in enumerate(AXES):
        for column in range(row + 1):
            found = value_of(results["estimates"], "mag_soft_iron", row=name, column=AXES[column])
            assert found["std_uncertainty"] < 2e-4
            scores.append((found["value"] - due[row, column]) / found["std_uncertainty"])
    for axis in AXES:
        found = value_of(results["estimates"], "mag_hard_iron", axis=axis)
        assert found["std_uncertainty"] < 5e-5
        scores.append(
            (found["value"] - value_of(truth, "mag_hard_iron", axis=axis)["value"]) / found["std_uncertainty"]
        )
    print("soft and hard iron, in standard uncertainties:", np.round(scores, 2))
    assert np.abs(scores).max() < 4.0
    assert np.sqrt(np.mean(np.square(scores))) < 2.0


def test_attitudes_that_leave_a_direction_open_are_named_b_fit_091(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[3] / "sequences" / "gnc_magnetometer.yaml").read_text()
    for middle in ("50", "20", "-10", "-60", "-90"):
        line = next(
            one for one in text.splitlines() if 'attitude: {outer: "{north}"' in one and f"middle: {middle} deg" in one
        )
        text = text.replace(f"{line}\n", "")
    text = text.replace('  - attitude: {outer: "{south}", middle: -60 deg}\n', "")
    path = tmp_path / "gnc_magnetometer.yaml"
    path.write_text(text)
    words = ["run", str(path), "--clock", "virtual", "--seed", "5", "--out", str(tmp_path / "out"), *SHORT]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1, result.output
    (folder,) = (one for one in (tmp_path / "out").iterdir() if one.is_dir())
    results = json.loads((folder / "results.json").read_text())
    assert not [one for one in results["estimates"] if one["quantity"].startswith(("mag_hard", "mag_soft"))]
    assert any("hard and soft iron" in note and "B-FIT-091" in note for note in results["notes"])
