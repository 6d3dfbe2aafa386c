"""Play, lag, gate means, level, branches: each against its definition or a closed form; gaps in a drive."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from bias_simulation import slack
from scipy.integrate import solve_ivp

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.gates import (
    Drive,
    hidden_degC,
    lagged,
    lagged_means,
    require_known,
    usable_drive,
)
from bench.systems.af_converter.estimators.hysteresis.fit import branch_difference
from bench.systems.af_converter.estimators.hysteresis.model import (
    Gates,
    HysteresisModel,
    ModelShape,
    cell_means,
    mean_of_walk,
    play,
)

CORNERS_s = (0.0, 7200.0, 43_200.0, 46_800.0, 82_800.0, 90_000.0)
CORNERS_degC = (-10.0, -10.0, 50.0, 50.0, -10.0, -10.0)


def test_play_by_hand() -> None:
    """r = 1: from above at 0 (P = 1), up to 5, down to 2.5 (half crossed), up again, then down through everything."""
    temperature = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 4.0, 2.5, 4.0, 0.0])
    expected = [1.0, 1.0, 1.0, 2.0, 4.0, 4.0, 3.5, 3.5, 1.0]
    assert play(temperature, 1.0).tolist() == expected
    assert play(np.array([0.0, 0.5]), 1.0, start=-1.0).tolist() == [-1.0, -0.5]
    assert play(np.empty(0), 1.0).size == 0


@pytest.mark.validates(
    "play operator of the bias fit",
    against="its definition, sample by sample, on 2,000 random temperatures",
)
def test_play_against_its_definition(record_property: Callable[[str, object], None]) -> None:
    rng = np.random.default_rng(20)
    for half_width in (0.0, 0.3, 2.5):
        temperature = np.cumsum(rng.normal(0, 0.5, 2000))
        apart_degC = np.abs(play(temperature, half_width, 0.0) - slack(temperature, half_width)).max()
        record_property("obtained", f"r = {half_width}: {apart_degC:.0e} degC")
        assert apart_degC <= 1e-12


def test_mean_of_the_play_in_a_cell_is_exact() -> None:
    coarse = np.array([0.0, 3.0, 3.0, -4.0, 1.0])
    output = play(coarse, 1.0, 0.0)
    for index, mean in enumerate(cell_means(coarse, output)):
        fine = np.linspace(coarse[index], coarse[index + 1], 20001)
        start = output[index] - coarse[index]
        assert mean == pytest.approx(np.trapezoid(play(fine, 1.0, start)) / 20000, abs=1e-6)


@pytest.mark.validates(
    "thermal lag, response to a step and to a ramp",
    against="closed forms",
)
def test_lag_against_closed_forms(record_property: Callable[[str, object], None]) -> None:
    t_s = np.concatenate(([0.0, 7.0], np.sort(np.random.default_rng(3).uniform(8, 9000, 50))))
    step = lagged(t_s, np.full(t_s.size, 10.0), 1500.0, start_degC=0.0)
    record_property("obtained", f"step {np.abs(step - 10.0 * -np.expm1(-t_s / 1500.0)).max():.0e} degC, limit 1e-11")
    np.testing.assert_allclose(step, 10.0 * -np.expm1(-t_s / 1500.0), atol=1e-11)
    ramp = lagged(t_s, 0.002 * t_s, 1500.0)
    np.testing.assert_allclose(ramp, 0.002 * (t_s - 1500.0 * -np.expm1(-t_s / 1500.0)), atol=1e-11)
    np.testing.assert_array_equal(lagged(t_s, 0.002 * t_s, 0.0), 0.002 * t_s)


@pytest.mark.validates(
    "thermal lag behind a temperature programme and its means",
    against="scipy.integrate.solve_ivp",
)
def test_lag_and_its_means_against_an_integrator(record_property: Callable[[str, object], None]) -> None:
    t_s = np.arange(0.0, 6001.0, 60.0)
    air = np.interp(t_s, [0, 1200, 2400, 6000], [23.0, -10.0, 30.0, 30.0])
    answer = solve_ivp(
        lambda t, state: [(np.interp(t, t_s, air) - state[0]) / 900.0, state[0]],
        (0.0, 6000.0),
        [20.0, 0.0],
        t_eval=t_s,
        rtol=1e-10,
        atol=1e-10,
        max_step=60.0,
    )
    unit = lagged(t_s, air, 900.0, start_degC=20.0)
    record_property("obtained", f"{np.abs(unit - answer.y[0]).max():.0e} degC, limit 1e-6")
    np.testing.assert_allclose(unit, answer.y[0], atol=1e-6)
    np.testing.assert_allclose(lagged_means(t_s, air, unit, 900.0), np.diff(answer.y[1]) / 60.0, atol=1e-6)


def test_columns_are_means_over_the_gate() -> None:
    """Against a grid of 1 s; the middle of a gate alone would be 0.08 nA off where the play begins to move."""
    t_s = np.arange(0.0, 40_000.0, 60.0)
    air = np.interp(t_s, [0, 4000, 20_000, 40_000], [20.0, 20.0, 46.7, 13.3])
    start_s = np.arange(1000.0, 39_000.0, 100.0)
    model = HysteresisModel(Gates(start_s, start_s + 100.0), Drive(t_s, air), ModelShape())
    fine_s = np.arange(0.0, 39_900.0, 1.0)
    unit = lagged(fine_s, np.interp(fine_s, t_s, air), 1500.0)
    behind = play(unit, 2.5) - unit
    places = (start_s[:, None] + np.arange(100)).astype(int)
    in_between = [(column[places] + column[places + 1]).mean(axis=1) / 2.0 for column in (unit, behind)]
    nA_per_degC = 4.0
    found = model.shape_column(1500.0, 2.5) * 5.0
    assert nA_per_degC * np.abs(found - in_between[1]).max() < 0.01
    assert nA_per_degC * np.abs(behind[places[:, 50]] - in_between[1]).max() > 0.05
    np.testing.assert_allclose(model.unit_degC(1500.0), in_between[0], atol=1e-4)


def test_level_against_the_dense_covariance() -> None:
    start_s = np.array([0.0, 100.0, 350.0, 450.0, 900.0])
    end_s = start_s + 100.0
    middle = (start_s + end_s) / 2.0
    dense = 9e-20 / 3600.0 * (np.minimum.outer(middle, middle) - np.eye(5) * 100.0 / 6.0)
    level = mean_of_walk(start_s + 5e5, end_s + 5e5, 3e-10)
    np.testing.assert_allclose(level.covariance, dense.mean(axis=1), rtol=1e-9)
    assert level.variance == pytest.approx(dense.mean(), rel=1e-9)


def test_branches_of_known_polynomials() -> None:
    temperature = np.concatenate((np.linspace(-10, 45, 80), np.linspace(50, -5, 80)))
    rising = np.arange(160) < 80
    readings = 3.0 + 0.5 * temperature + 1e-3 * temperature**3 + np.where(rising, 0.0, 2.0 + 0.1 * temperature)
    found = branch_difference(temperature, readings, rising, ~rising, np.array([-10.0, 0.0, 20.0, 50.0]))
    assert np.isnan(found[[0, 3]]).all()
    np.testing.assert_allclose(found[1:3], [2.0, 4.0], rtol=1e-9)
    few = branch_difference(temperature, readings, rising & (temperature > 43), ~rising, np.array([44.0]))
    assert np.isnan(few).all()


def test_a_drive_needs_readings_and_extra_columns_must_match() -> None:
    drive = usable_drive(np.array([3.0, 1.0, 2.0, 2.0]), np.array([5.0, 4.0, np.nan, 4.5]))
    assert drive.t_s.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(FitError, match="1 usable") as caught:
        usable_drive(np.array([1.0, 2.0]), np.array([20.0, np.nan]))
    assert caught.value.code == "B-FIT-020"
    gates = Gates(np.arange(5.0), np.arange(5.0) + 1.0)
    with pytest.raises(FitError, match="5 readings and 1 names") as caught:
        HysteresisModel(gates, Drive(np.arange(9.0), np.arange(9.0)), ModelShape(20.0, 3, np.ones((4, 1)), ("t",)))
    assert caught.value.code == "B-FIT-021"


def ramp(gap_s: tuple[float, float], noise_degC: float = 0.02) -> Drive:
    """The 25-hour ramp read once a minute, without the readings inside the gap."""
    t_s = np.arange(0.0, 90_000.0, 60.0)
    degC = np.interp(t_s, CORNERS_s, CORNERS_degC) + np.random.default_rng(4).normal(0, noise_degC, t_s.size)
    kept = (t_s <= gap_s[0]) | (t_s >= gap_s[1])
    return Drive(t_s[kept], degC[kept])


@pytest.mark.parametrize("gap_s", [(0.0, 0.0), (20_000.0, 23_600.0), (60_000.0, 60_200.0), (84_000.0, 87_600.0)])
def test_a_gap_on_a_straight_stretch_is_bridged(gap_s: tuple[float, float]) -> None:
    drive = ramp(gap_s)
    assert require_known(drive, 0.0) is drive


@pytest.mark.parametrize(
    ("gap_s", "name"), [((5400.0, 9000.0), "hold to ramp"), ((42_000.0, 48_000.0), "up, hold and down")]
)
def test_a_gap_that_hides_a_turn_is_refused(gap_s: tuple[float, float], name: str) -> None:
    """Not one long before what is fitted. By hand: a corner of 0.1 degC/min 1,800 s into a gap is off by 3 degC / 2."""
    with pytest.raises(FitError, match=rf"B-FIT-024.*from {gap_s[0]:.0f} s to {gap_s[1]:.0f} s") as refusal:
        require_known(ramp(gap_s), 0.0)
    assert "joint_unit_sensor" in refusal.value.next_step, name
    require_known(ramp(gap_s), gap_s[1] + 11_000.0)
    with pytest.raises(FitError, match="B-FIT-024"):
        require_known(ramp(gap_s), gap_s[1] + 100.0)
    drive = ramp((5400.0, 9000.0), noise_degC=0.0)
    assert hidden_degC(drive, int(np.argmax(np.diff(drive.t_s)))) == pytest.approx(1.5, rel=0.02)
