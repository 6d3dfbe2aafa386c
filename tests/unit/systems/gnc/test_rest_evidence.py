"""Records at rest and logs of a world that is not the named one: what is found in them is doubted or refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from imu_material import Rig, Unit

from bench.analysis import build_results
from bench.analysis.doubt import weigh
from bench.systems.gnc.bias import analyse
from bench.systems.gnc.estimators.multi_position import fit_multi_position
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.logs.log import of_rests, own_axes, stuck_sensors

SEED = 611
POSE, OVER = (20.0, 0.0, 0.0), (20.0, 0.0, 180.0)
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}
G = 9.80665


def rig() -> Rig:
    made = Rig(SEED, Unit())
    made.rest(61.0, POSE, item="bias", up="+z")
    made.rest(61.0, POSE, item="flip", up="+z")
    made.rest(61.0, OVER, item="flip", up="-z")
    return made


def qualities(made: Rig) -> dict[str, tuple[str, list[str]]]:
    found = build_results("one", analyse(made.material("imu_bias")), {}, PROVENANCE)["estimates"]
    return {
        f"{entry['quantity']} {entry['conditions']['axis']}": (
            entry["quality"],
            [why["code"] for why in entry["reasons"]],
        )
        for entry in found
    }


def test_a_unit_as_named_is_sound() -> None:
    assert {quality for quality, _ in qualities(rig()).values()} == {"sound"}


def test_a_pose_that_is_not_the_named_one_refuses_what_rests_on_it() -> None:
    made = rig()
    made.rows[0].window.conditions["inner_deg"] = 180.0
    found = qualities(made)
    assert found["gyro_bias x"] == ("refused", ["implausible_pose"])
    assert found["accel_bias y"] == ("sound", [])


def tips_over(values: Any) -> None:
    values[len(values) // 2 :, 1] += 20  # 20 mg: 1.1 deg


@pytest.mark.parametrize("record", [1, 2])
def test_a_unit_that_tips_over_at_rest_is_doubted(record: int) -> None:
    made = rig()
    tips_over(made.rows[record].samples.columns["accel"])
    found = qualities(made)
    assert found["accel_bias z"] == ("doubtful", ["not_at_rest"])
    assert found["gyro_bias x"] == ("sound", [])


def test_a_gyro_that_warms_is_doubted() -> None:
    made = rig()
    gyro = made.rows[0].samples.columns["gyro"]
    gyro[:, 2] += np.linspace(0.0, 8.0, len(gyro)).astype(gyro.dtype)  # 0.04 deg/s
    assert qualities(made)["gyro_bias x"] == ("doubtful", ["not_at_rest"])


def test_a_sensor_that_never_changes_is_refused_and_its_neighbours_stand() -> None:
    made = rig()
    for row in made.rows:
        row.samples.columns["gyro"][:, 1] = 7
    found = qualities(made)
    assert found["gyro_bias y"] == ("refused", ["stands_still"])
    assert found["gyro_bias x"] == ("sound", [])


def rests(wrong: Callable[[Any, Any], Any], seed: int, count: int = 40) -> tuple[Any, Any]:
    """Mean readings of poses held at any time of 15 min, and when; ``wrong`` adds what no ellipsoid has."""
    draw = np.random.default_rng(seed)
    up = draw.normal(size=(count, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    time_s = np.sort(draw.uniform(0.0, 900.0, count))
    matrix = np.eye(3) + np.triu(draw.normal(0.0, 0.01, (3, 3)))
    read = np.linalg.solve(matrix, G * up.T).T + draw.normal(0.0, 0.2, 3) + draw.normal(0.0, 3e-3, (count, 3))
    return read + wrong(up, time_s), time_s


def one_rest(up: Any, time_s: Any) -> Any:
    moved = np.zeros_like(up)
    moved[np.argmin(np.abs(up).max(axis=1))] = 0.4
    return moved


WRONG = {
    "zeros_drift": lambda up, time_s: time_s[:, None] / 900.0 * [0.05, -0.03, 0.04],
    "sensors_bend": lambda up, time_s: 0.08 * up**3,
    "odd_rest": one_rest,
}


def against(wrong: Callable[[Any, Any], Any], seed: int) -> set[str]:
    mean, time_s = rests(wrong, seed)
    return {seen.code for seen in weigh(of_rests(fit_multi_position(mean, G), mean, time_s)).against}


@pytest.mark.parametrize("code", WRONG)
def test_rests_that_no_ellipsoid_explains_are_doubted_by_name(code: str) -> None:
    assert all(code in against(WRONG[code], seed) for seed in range(5))


def test_rests_of_one_ellipsoid_are_not_doubted() -> None:
    assert not any(against(lambda up, time_s: 0.0, seed) for seed in range(40))


def test_a_log_whose_sensor_hangs_is_doubted() -> None:
    log = np.random.default_rng(SEED).normal(0.0, 0.01, (5000, 3)).round(3)
    assert stuck_sensors({"gyro": [log]}, {"gyro": ()}) == []
    log[3000:3100, 2] = log[3000, 2]
    (seen,) = stuck_sensors({"gyro": [log]}, {"gyro": ("gyro_matrix",)})
    assert seen.code == "stands_still"
    assert seen.quantities == ("gyro_matrix",)


@pytest.mark.parametrize(
    "wrong", [np.eye(3)[[1, 0, 2]], np.diag([1.0, -1.0, 1.0]), np.eye(3) + 0.2 * np.eye(3)[[1, 2, 0]]]
)
def test_columns_or_signs_that_were_mixed_up_are_refused(wrong: Any) -> None:
    assert own_axes("accel", triad(300.0 * np.eye(3))) == []
    (seen,) = own_axes("accel", triad(300.0 * wrong))
    assert seen.refuses


def triad(sensitivity: Any) -> TriadFit:
    return TriadFit(np.linalg.inv(sensitivity), np.zeros(3), np.eye(12), np.zeros((6, 3)), 0.0, 6, 6.0, 1.0)
