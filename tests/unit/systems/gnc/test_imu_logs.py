"""Analyses of imported logs: simulated poses found again; recordings made by other people, a hand-held Ferraris
calibration and a multi-position calibration, give the figures known of them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imu_material import turned, values
from spoken import english_left

from bench.analysis import Material
from bench.model.errors import FitError
from bench.systems.gnc.estimators.between_rests import fit_between_rests
from bench.systems.gnc.estimators.earth_rate import RotationRecord, static_means
from bench.systems.gnc.estimators.multi_position import NormFit, fit_multi_position
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import fit_turns_from_rest
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, static_intervals
from bench.systems.gnc.estimators.triad import fit_six_position
from bench.systems.gnc.logs import multi_position as imu_multi_position
from bench.systems.gnc.logs import six_position as imu_six_position

SEED = 610
FOLDER = Path(os.environ.get("BENCH_REAL_DATA", Path(__file__).parents[5] / "shared" / "data"))
ROLES = {"gyro": ("gyro", "deg/s", "deg_s"), "accel": ("accelerometer", "m/s2", "m_s2")}
Keep = Callable[[str, object], None]
FERRARIS, XSENS = FOLDER / "imucal", FOLDER / "imu_tk"
RATE_HZ, G = 102.4, 9.81
needs_ferraris = pytest.mark.skipif(not FERRARIS.is_dir(), reason=f"no recording in {FERRARIS}")
needs_xsens = pytest.mark.skipif(not XSENS.is_dir(), reason=f"no recording in {XSENS}")
ORDER = [f"{axis}_{end}" for axis in "xyz" for end in "pa"]


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
    assert english_left(analysis) == set()
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
    for lacking, code in (("segments", "B-GNC-007"), ("site", "B-GNC-006"), ("columns", "B-GNC-006")):
        with pytest.raises(FitError, match=code):
            imu_six_position.analyse(Material((), material.campaign | {lacking: {}}, {}, series=material.series))
    for module in (imu_six_position, imu_multi_position):
        with pytest.raises(FitError, match="B-FIT-004"):
            module.analyse(material, "other")


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
    assert english_left(analysis) == set()
    np.testing.assert_allclose(values(analysis.estimates, "accel_sensitivity"), scale, rtol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "accel_zero"), zero, atol=1.5)
    assert analysis.tables[1].rows[0][0] == 36
    fit = fit_multi_position(static_intervals(accel, 100.0, initial_s=30.0).means(accel), 9.8)
    for quantity, stds in (("accel_sensitivity", fit.counts_per_unit_std), ("accel_zero", fit.zero_std)):
        found = [one for one in analysis.estimates if one["quantity"] == quantity]
        assert [one["std_uncertainty"] for one in found] == pytest.approx(stds)
        assert {one["dof"] for one in found} == {27.0}  # 36 poses less nine parameters


@pytest.fixture(scope="module")
def sections() -> dict[str, np.ndarray]:
    """Gyroscope deg/s and accelerometer m/s2, (m, 6), of each section."""
    rows = np.genfromtxt(FERRARIS / "imucal_example_ferraris_session.csv", delimiter=",", skip_header=1)
    listed = json.loads((FERRARIS / "imucal_example_ferraris_session_list.json").read_text())
    return {name: rows[span["start"] : span["end"], 1:] for name, span in listed.items()}


def ferraris(sections: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K of the accelerometers, their bias (output), and S of the gyroscopes, by the formulas of the 1995 paper."""
    up = np.array([sections[f"{axis}_p"].mean(axis=0) for axis in "xyz"])
    down = np.array([sections[f"{axis}_a"].mean(axis=0) for axis in "xyz"])
    bias = np.diag((up + down)[:, 3:]) / 2.0
    matrix = np.linalg.inv((up - down)[:, 3:].T / (2.0 * G))
    of_force = (up - down)[:, :3].T / (2.0 * G)  # how the gyroscopes answer to acceleration
    rest = np.vstack([sections[name] for name in ORDER])[:, :3].mean(axis=0)
    turns = []
    for axis in "xyz":
        turn = sections[f"{axis}_rot"]
        true = (turn[:, 3:] - bias) @ matrix.T
        turns.append((turn[:, :3] - rest - true @ of_force.T).sum(axis=0) / RATE_HZ)
    return matrix, bias, np.array(turns).T / -360.0


@pytest.mark.real
@needs_ferraris
@pytest.mark.validates(
    "six positions and one turn about each axis of a real unit, held in the hand",
    against="the formulas of Ferraris, Grimaldi and Parvis 1995 on the recording published with the package imucal",
)
def test_ferraris_recording(sections: dict[str, np.ndarray], record_property: Keep) -> None:
    matrix, bias, sensitivity = ferraris(sections)
    means, _, _ = static_means([sections[name][:, 3:] for name in ORDER], RATE_HZ)
    force = np.kron(np.eye(3), [[G], [-G]])
    triad = fit_six_position(means, force)
    rms = float(np.sqrt(np.mean(triad.residual**2)))
    rest, spread, _ = static_means([sections[name][:, :3] for name in ORDER], RATE_HZ)
    length_s = np.array([len(sections[name]) for name in ORDER]) / RATE_HZ
    records = []
    for axis in "xyz":
        turn = sections[f"{axis}_rot"]
        place = np.arange(len(turn))
        records.append(RotationRecord(axis, -360.0, place, place / RATE_HZ, turn[:, :3]))
    mean = length_s @ rest / length_s.sum()
    gyro = fit_turns_from_rest(records, mean, spread.mean(axis=0) / 6.0, spread[0] * length_s[0], Declared())
    apart = np.abs(triad.matrix - matrix).max(), np.abs(gyro.sensitivity - sensitivity).max()
    bias_apart = np.abs(triad.bias + matrix @ bias).max()
    record_property(
        "obtained", f"apart {apart[0]:.1e}, turns {apart[1]:.1e} (limits 1e-4), bias {bias_apart:.3f} m/s2 (0.03)"
    )
    record_property("obtained", f"residual {rms:.4f} m/s2")
    assert max(apart) < 1e-4
    assert bias_apart < 0.03
    assert rms == pytest.approx(0.0131, abs=1e-4)


@pytest.fixture(scope="module")
def xsens() -> tuple[np.ndarray, np.ndarray, StaticIntervals]:
    acceleration, gyro = (np.loadtxt(XSENS / f"xsens_{name}.mat") for name in ("acc", "gyro"))
    return acceleration, gyro, static_intervals(acceleration[:, 1:], 100.0, initial_s=50.0, least_s=2.0)


def published(means: np.ndarray) -> NormFit:
    return fit_multi_position(means, 9.81744)  # gravity of the publication


@pytest.mark.real
@needs_xsens
@pytest.mark.validates(
    "multi-position calibration of a real unit turned by hand",
    against="the figures of the public multi-position method on the recording published with it (imu_tk)",
)
def test_multi_position_recording(xsens: tuple[np.ndarray, np.ndarray, StaticIntervals], record_property: Keep) -> None:
    acceleration, gyro, rests = xsens
    means = rests.means(acceleration[:, 1:])
    fit = published(means)
    third = np.arange(len(means)) % 3
    left = np.concatenate(
        [np.linalg.norm(published(means[third != k]).apply(means[third == k]), axis=1) - 9.81744 for k in range(3)]
    )
    step = np.diff(gyro[:, 0], prepend=gyro[0, 0] - 0.01)
    turned = fit_between_rests(step, gyro[:, 1:], rests, fit.apply(means), 83.0)
    per_rad = np.degrees(turned.counts_per_unit)
    scale, zero = ", ".join(f"{v:.2f}" for v in fit.counts_per_unit), ", ".join(f"{v:.1f}" for v in fit.zero)
    record_property(
        "obtained", f"{len(means)} rests, {scale} counts/(m/s2), zero {zero}, residual {fit.residual_rms:.5f} m/s2"
    )
    record_property("obtained", f"rests left out, every third, {np.sqrt(np.mean(left**2)):.4f} m/s2")
    record_property(
        "obtained",
        f"gyroscopes {per_rad[0]:.0f}, {per_rad[1]:.0f}, {per_rad[2]:.0f} counts/(rad/s), maker 4778, 4758, 4766",
    )
    assert 36 <= len(means) <= 38
    assert fit.counts_per_unit == pytest.approx([414.42, 412.03, 414.62], rel=5e-4)
    assert fit.zero == pytest.approx([33123.8, 33275.1, 32364.5], abs=1.0)
    assert fit.residual_rms <= 0.0011
    assert np.sqrt(np.mean(left**2)) < 0.002
    assert per_rad == pytest.approx([4778.0, 4758.0, 4766.0], rel=0.005)
