"""Analyses of imported logs: simulated poses found again; other people's recordings give the figures known of them."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imu_material import turned, values

from bench.analysis import Material
from bench.model.errors import FitError
from bench.systems.gnc.estimators.multi_position import fit_multi_position
from bench.systems.gnc.estimators.static_intervals import static_intervals
from bench.systems.gnc.logs import multi_position as imu_multi_position
from bench.systems.gnc.logs import six_position as imu_six_position

SEED = 610
FOLDER = Path(os.environ.get("BENCH_REAL_DATA", Path(__file__).parents[5] / "shared" / "data"))
TURNED = FOLDER / "imucal" / "imucal_example_ferraris_session.csv"
POSES = FOLDER / "imu_tk" / "xsens_acc.mat"
real = [
    pytest.mark.real,
    pytest.mark.skipif(not (TURNED.exists() and POSES.exists()), reason=f"no recordings in {FOLDER}"),
]
ROLES = {"gyro": ("gyro", "deg/s", "deg_s"), "accel": ("accelerometer", "m/s2", "m_s2")}


def log(accel: Any, gyro: Any, t_s: Any, segments: list[dict[str, Any]], **more: Any) -> Material:
    """What an imported log gives to an analysis."""
    series, columns = {"t_s": t_s}, []
    for word, table in (("accel", accel), ("gyro", gyro)):
        for k, axis in enumerate("xyz" if table is not None else ""):
            role, unit, suffix = ROLES[word]
            unit, suffix = ("1", "counts") if more.get("counts") else (unit, suffix)
            columns.append(
                {"name": f"{word}_{axis}_{suffix}", "role": role, "axis": axis, "unit": unit, "header": axis}
            )
            series[f"{word}_{axis}_{suffix}"] = table[:, k]
    campaign = {"uut": {"model": "any", "serial": "1"}, "columns": columns, "segments": segments}
    campaign |= {"site": {"gravity_m_s2": more.get("gravity", 9.81)}, "rate_Hz": more.get("rate_Hz")}
    return Material(rows=(), campaign=campaign, standards={}, series=series)


def positions_and_turns() -> Material:
    rng = np.random.default_rng(SEED)
    K, b = np.array([[1.01, 0.004, 0.0], [-0.003, 0.99, 0.002], [0.001, 0.0, 1.02]]), np.array([0.2, -0.1, 0.3])
    accel, gyro, segments, first = [], [], [], 0
    for axis in range(3):
        for sign in (1.0, -1.0):
            force = np.zeros(3)
            force[axis] = 9.81 * sign
            accel.append(np.linalg.solve(K, force - b) + rng.normal(0.0, 0.01, (300, 3)))
            gyro.append(np.full((300, 3), 0.5) + rng.normal(0.0, 0.05, (300, 3)))
            up = f"{'+' if sign > 0 else '-'}{'xyz'[axis]}"
            segments.append({"label": up, "first": first, "last": first + 299, "item": "position", "up": up})
            first += 300
    for axis in range(3):
        rate = np.zeros((400, 3))
        rate[50:350, axis] = -120.0
        accel.append(np.zeros((400, 3)))
        gyro.append(np.linalg.solve(K, rate.T).T + 0.5 + rng.normal(0.0, 0.05, (400, 3)))
        turn = {"item": "rotation", "axis": "xyz"[axis], "turn_deg": -360.0}
        segments.append({"label": "turn", "first": first, "last": first + 399, **turn})
        first += 400
    return log(np.vstack(accel), np.vstack(gyro), np.arange(first) / 100.0, segments, rate_Hz=100.0)


def test_six_positions_and_turns_are_found_again() -> None:
    analysis = imu_six_position.analyse(positions_and_turns())
    K = np.array([[1.01, 0.004, 0.0], [-0.003, 0.99, 0.002], [0.001, 0.0, 1.02]])
    np.testing.assert_allclose(values(analysis.estimates, "accel_matrix", "row", "column"), K, atol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "accel_bias"), [0.2, -0.1, 0.3], atol=5e-3)
    np.testing.assert_allclose(values(analysis.estimates, "gyro_matrix", "row", "column"), K, atol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "gyro_bias"), K @ [0.5, 0.5, 0.5], atol=0.02)
    assert analysis.missing == []


def test_a_missing_turn_costs_the_gyros_and_is_named() -> None:
    material = positions_and_turns()
    material.campaign["segments"].pop()
    material.campaign["segments"].pop(0)
    analysis = imu_six_position.analyse(material)
    assert "position +x up: no stretch" in analysis.missing
    assert any(one.startswith("gyros: ") for one in analysis.missing)
    assert not any(one["quantity"] == "gyro_matrix" for one in analysis.estimates)


def test_logs_that_do_not_serve() -> None:
    material = positions_and_turns()
    for change, code in (
        ({"segments": []}, "B-GNC-007"),
        ({"site": {}}, "B-GNC-006"),
        ({"columns": []}, "B-GNC-006"),
    ):
        with pytest.raises(FitError) as caught:
            imu_six_position.analyse(Material((), {**material.campaign, **change}, {}, series=material.series))
        assert caught.value.code == code
    for module in (imu_six_position, imu_multi_position):
        with pytest.raises(FitError) as caught:
            module.analyse(material, "other")
        assert caught.value.code == "B-FIT-004"


def test_many_poses_are_found_again() -> None:
    rng = np.random.default_rng(SEED)
    zero, scale = np.array([33_000.0, 32_900.0, 33_100.0]), np.array([410.0, 412.0, 415.0])
    pieces = []
    for number in range(36):
        towards = turned(2, rng.uniform(0, 360)) @ turned(1, rng.uniform(0, 360)) @ np.array([0.0, 0.0, 9.8])
        seconds = 35 if number == 0 else 5
        pieces.append(np.tile(towards * scale + zero, (seconds * 100, 1)))
        pieces.append(towards * scale + zero + rng.normal(0.0, 300.0, (200, 3)))
    accel = np.vstack(pieces)
    accel = accel + rng.normal(0.0, 2.0, accel.shape)
    material = log(accel, None, np.arange(len(accel)) / 100.0, [], counts=True, gravity=9.8)
    analysis = imu_multi_position.analyse(material)
    np.testing.assert_allclose(values(analysis.estimates, "accel_sensitivity"), scale, rtol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "accel_zero"), zero, atol=1.5)
    assert analysis.tables[1].rows[0][0] == 36
    fit = fit_multi_position(static_intervals(accel, 100.0, initial_s=30.0).means(accel), 9.8)
    for quantity, stds in (("accel_sensitivity", fit.counts_per_unit_std), ("accel_zero", fit.zero_std)):
        found = [one for one in analysis.estimates if one["quantity"] == quantity]
        assert [one["std_uncertainty"] for one in found] == pytest.approx(stds)
        assert {one["dof"] for one in found} == {27.0}  # 36 poses less nine parameters


@pytest.mark.parametrize("_", [pytest.param(0, marks=real)])
def test_many_poses_of_another_sensor(_: int) -> None:
    table = np.loadtxt(POSES)
    material = log(table[:, 1:], None, table[:, 0] - table[0, 0], [], counts=True, gravity=9.81744)
    analysis = imu_multi_position.analyse(material)
    np.testing.assert_allclose(values(analysis.estimates, "accel_sensitivity"), [414.42, 412.03, 414.62], rtol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "accel_zero"), [33123.8, 33275.1, 32364.5], atol=1.0)
    residual = next(one["value"] for one in analysis.estimates if one["quantity"] == "accel_residual")
    assert residual <= 0.0011
    assert 36 <= analysis.tables[1].rows[0][0] <= 38


@pytest.mark.parametrize("_", [pytest.param(0, marks=real)])
def test_six_positions_of_another_sensor(_: int) -> None:
    """Against the normal equations of the paper, and against Ferraris' differences of opposite positions."""
    table = np.loadtxt(TURNED, delimiter=",", skiprows=1)
    ranges = json.loads(TURNED.with_name("imucal_example_ferraris_session_list.json").read_text(encoding="utf-8"))
    segments = []
    for name, rows in ranges.items():
        axis, kind = name.split("_")
        what = {"item": "rotation", "axis": axis, "turn_deg": -360.0} if kind == "rot" else {
            "item": "position", "up": f"{'+' if kind == 'p' else '-'}{axis}"}  # fmt: skip
        segments.append({"label": name, "first": rows["start"], "last": rows["end"] - 1, **what})
    material = log(table[:, 4:7], table[:, 1:4], table[:, 0] / 102.4, segments, rate_Hz=102.4)
    analysis = imu_six_position.analyse(material)
    means = np.array([table[ranges[f"{axis}_{end}"]["start"] : ranges[f"{axis}_{end}"]["end"], 4:7].mean(axis=0)
                      for axis in "xyz" for end in "pa"])  # fmt: skip
    sensitivity = np.stack([(means[2 * k] - means[2 * k + 1]) / (2 * 9.81) for k in range(3)], axis=1)
    K = values(analysis.estimates, "accel_matrix", "row", "column")
    np.testing.assert_allclose(K, np.linalg.inv(sensitivity), atol=1e-4)
    bias = values(analysis.estimates, "accel_bias")
    np.testing.assert_allclose(bias, -np.linalg.inv(sensitivity) @ means.mean(axis=0), atol=0.03)
    assert "Residual 0.01308 m/s2" in analysis.tables[0].caption
    assert analysis.missing == []
