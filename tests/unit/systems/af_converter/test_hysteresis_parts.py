"""Play, lag, gate means, level, branches: each against its definition or a closed form; gaps in a drive."""

from collections.abc import Callable

import numpy as np
import pytest
from bias_simulation import slack
from pulse_simulation import K0_C, WHITE_A_rtHz
from scipy.integrate import solve_ivp
from strd_linear import covariance_of

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.gates import (
    Drive,
    hidden_degC,
    lagged,
    lagged_means,
    require_known,
    series_covariance,
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


WALK_A_rth, GATE_s = 3e-10, 100.0


def dense(times, gate, quantum, white, walk, linked, parabolic):
    """The covariance written out: integrals of min(t, t'), shared edges, independent noise."""
    m = times.size
    found = np.diag(quantum**2 / gate**2 / 6.0 + white**2 / (2.0 * gate) * np.where(parabolic, 1.2, 1.0))
    for k in range(1, m):
        if linked[k] and not parabolic[k] and not parabolic[k - 1]:
            found[k, k - 1] -= quantum[k] * quantum[k - 1] / (12.0 * gate[k] * gate[k - 1])
            found[k - 1, k] = found[k, k - 1]
    middle = times - (times[0] - gate[0] / 2.0)
    shared = np.minimum.outer(middle, middle)
    shared[np.diag_indices(m)] -= np.where(parabolic, 9.0 / 70.0, 1.0 / 6.0) * gate
    return found + walk**2 / 3600.0 * shared


def series(seed: int, m: int):
    """A series with gaps, unequal lengths, breaks of contiguity and all three estimators."""
    rng = np.random.default_rng(seed)
    gate = rng.uniform(60.0, 140.0, m)
    gap = np.where(rng.uniform(size=m) < 0.2, rng.uniform(10.0, 900.0, m), 0.0)
    start = np.concatenate(([0.0], np.cumsum(gate + gap)[:-1])) + 5000.0
    linked = np.concatenate(([True], gap[:-1] == 0.0))
    names = rng.choice(["gated", "omega", "reciprocal"], m, p=[0.6, 0.2, 0.2])
    return names, start + gate / 2.0, gate, rng.uniform(0.1, 1.0, m) * K0_C, linked


@pytest.mark.parametrize("m", [1, 2, 3, 40, 900])
@pytest.mark.parametrize(("white", "walk"), [(WHITE_A_rtHz, WALK_A_rth), (WHITE_A_rtHz, 0.0), (0.0, 0.0)])
def test_whitening_is_that_of_the_dense_cholesky_factor(m, white, walk) -> None:
    names, times, gate, quantum, linked = series(m, m)
    expected = dense(times, gate, quantum, white, walk, linked, names == "omega")
    whitener = series_covariance(names, times, gate, quantum, white, walk, linked)
    np.testing.assert_allclose(covariance_of(whitener), expected, rtol=1e-10, atol=1e-12 * expected.max())
    x = np.random.default_rng(m).standard_normal((m, 4))
    by_hand = np.linalg.solve(np.linalg.cholesky(expected), x)
    scale = np.abs(by_hand).max()
    assert np.abs(whitener.whiten(x) - by_hand).max() < 1e-10 * scale
    assert np.abs(whitener.whiten(x[:, 0]) - by_hand[:, 0]).max() < 1e-10 * scale


@pytest.mark.validates(
    "whitening of 900 contiguous windows",
    against="numpy's Cholesky factor of the covariance written out",
)
def test_900_windows_of_the_bias_ramp(record_property: Callable[[str, object], None]) -> None:
    m = 900
    times = (np.arange(m) + 0.5) * GATE_s
    one = np.ones(m)
    expected = dense(times, GATE_s * one, K0_C * one, WHITE_A_rtHz, WALK_A_rth, one > 0, one < 0)
    whitener = series_covariance("gated", times, GATE_s, K0_C, WHITE_A_rtHz, WALK_A_rth)
    y = np.random.default_rng(9).multivariate_normal(np.zeros(m), expected)
    by_hand = np.linalg.solve(np.linalg.cholesky(expected), y)
    apart = np.abs(whitener.whiten(y) - by_hand).max() / np.abs(by_hand).max()
    record_property("obtained", f"{apart:.0e} of the largest, limit 1e-10")
    assert apart < 1e-10


def counted(charge_C: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Gated readings of whole pulses: (trials, windows) of ampere from the charge at the cuts (trials, windows + 1)."""
    return np.diff(np.floor(charge_C / K0_C + phase), axis=1) * K0_C / GATE_s


def charges(rng, trials: int, windows: int, current_A, walk: float = 0.0) -> np.ndarray:
    """Charge at the cuts, (trials, windows + 1), of a current with white noise and a walk, in steps of 5 s."""
    step_s, steps = 5.0, windows * round(GATE_s / 5.0)
    wander = np.cumsum(rng.standard_normal((trials, steps)), axis=1) * walk * np.sqrt(step_s / 3600.0)
    drawn = rng.standard_normal((trials, steps)) * WHITE_A_rtHz / np.sqrt(2.0 * step_s)
    flow = np.cumsum(current_A + wander + drawn, axis=1) * step_s
    return np.concatenate((np.zeros((trials, 1)), flow), axis=1)[:, :: round(GATE_s / step_s)]


@pytest.mark.validates(
    "contiguous gates: uncertainty of the mean of an hour",
    against="400 simulated hours of charge, whole pulses counted",
)
def test_contiguous_gates_telescope(record_property: Callable[[str, object], None]) -> None:
    """Errors of neighbours are correlated by -1/2, and an hour is known far better than a white series would be."""
    rng = np.random.default_rng(20261)
    trials, windows = 400, 36
    current = rng.uniform(350e-9, 450e-9, (trials, 1))  # rates that nothing locks to the gate
    charge = charges(rng, trials, windows, current)
    error = counted(charge, rng.uniform(size=(trials, 1))) - current
    lag_1 = np.mean(error[:, 1:] * error[:, :-1]) / np.mean(error**2)
    hour = float(np.std(error.mean(axis=1)))
    whitener = series_covariance("gated", (np.arange(windows) + 0.5) * GATE_s, GATE_s, K0_C, WHITE_A_rtHz, 0.0)
    stated = float(np.sqrt(covariance_of(whitener).mean()))
    white_A = float(np.sqrt(np.trace(covariance_of(whitener))) / windows)
    record_property(
        "obtained", f"scatter {hour * 1e9:.3f} nA, stated {stated * 1e9:.3f}, as white noise {white_A * 1e9:.3f}"
    )
    assert np.std(error) == pytest.approx(np.sqrt(covariance_of(whitener)[0, 0]), rel=0.05)
    assert lag_1 == pytest.approx(-0.5, abs=0.05)
    assert hour == pytest.approx(stated, rel=0.1)  # 400 trials: 3.5 %
    assert white_A > 4 * hour


@pytest.mark.validates(
    "95 % intervals of level and drift of 100 windows",
    against="400 simulated series of charge that flowed, whole pulses counted",
)
def test_intervals_of_a_mean_and_a_slope_cover(record_property: Callable[[str, object], None]) -> None:
    """95 % intervals of level and drift over 100 windows."""
    rng = np.random.default_rng(404)
    trials, windows = 400, 100
    current = rng.uniform(350e-9, 450e-9, (trials, 1))
    charge = charges(rng, trials, windows, current, WALK_A_rth)
    readings = counted(charge, rng.uniform(size=(trials, 1)))
    times = (np.arange(windows) + 0.5) * GATE_s
    whitener = series_covariance("gated", times, GATE_s, K0_C, WHITE_A_rtHz, WALK_A_rth)
    design = whitener.whiten(np.column_stack((np.ones(windows), times / times[-1])))
    covariance = np.linalg.inv(design.T @ design)
    white = whitener.whiten(readings.T)
    found = covariance @ design.T @ white
    chi2 = np.mean(np.sum((white - design @ found) ** 2, axis=0)) / (windows - 2)
    errors = found - np.vstack((current[:, 0], np.zeros(trials)))
    covered = 100.0 * np.mean(np.abs(errors) < 1.96 * np.sqrt(np.diag(covariance))[:, None], axis=1)
    record_property("obtained", f"{covered[0]:.1f} and {covered[1]:.1f} %")
    assert np.all(np.abs(covered - 95.0) < 3.5)
    assert chi2 == pytest.approx(1.0, abs=0.1)


def test_a_reciprocal_series_shares_its_pulses() -> None:
    """Times known to a frame: the pulse that ends one interval begins the next one."""
    rng = np.random.default_rng(77)
    trials, windows, current, frame_s = 2000, 12, 400e-9, 1.0  # coarse frames, so that they matter
    pulses = (np.arange(windows * 32 + 60) + rng.uniform(size=(trials, 1))) * K0_C / current
    pulses *= rng.uniform(0.98, 1.02, (trials, 1))
    seen = (np.floor(pulses / frame_s) + 0.5) * frame_s
    last = np.array([np.searchsorted(row, np.arange(1, windows + 2) * GATE_s) - 1 for row in pulses])
    rows = np.arange(trials)[:, None]
    true = np.diff(last, axis=1) * K0_C / np.diff(pulses[rows, last], axis=1)
    error = np.diff(last, axis=1) * K0_C / np.diff(seen[rows, last], axis=1) - true
    lag_1 = np.mean(error[:, 1:] * error[:, :-1]) / np.mean(error**2)
    whitener = series_covariance("reciprocal", np.arange(windows) * GATE_s, GATE_s, current * frame_s, 0.0, 0.0)
    assert np.std(error) == pytest.approx(np.sqrt(covariance_of(whitener)[0, 0]), rel=0.05)
    assert lag_1 == pytest.approx(-0.5, abs=0.05)


@pytest.mark.parametrize(
    ("times", "gate", "sizes", "code"),
    [
        ([100.0, 50.0], 100.0, (K0_C, WHITE_A_rtHz, WALK_A_rth), "B-FIT-025"),
        ([50.0, 150.0], 0.0, (K0_C, WHITE_A_rtHz, WALK_A_rth), "B-FIT-025"),
        ([50.0, 150.0], 100.0, (0.0, 0.0, 0.0), "B-FIT-002"),
    ],
)
def test_a_series_out_of_order_or_without_any_uncertainty_is_refused(times, gate, sizes, code) -> None:
    with pytest.raises(FitError) as caught:
        series_covariance("gated", np.array(times), gate, *sizes)
    assert caught.value.code == code
