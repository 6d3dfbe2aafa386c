"""Covariance of a series of gates: against dense matrices and charge that really flowed, not against itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from pulse_simulation import K0_C, WHITE_A_rtHz
from whitened_covariance import covariance_of

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.gates import series_covariance

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
    print(f"lag-1 {lag_1:.3f}; mean of an hour: sd {hour * 1e9:.3f} nA, stated {stated * 1e9:.3f}, "
          f"as if white {white_A * 1e9:.3f}")  # fmt: skip
    record_property(
        "obtained", f"scatter {hour * 1e9:.3f} nA, stated {stated * 1e9:.3f}, as white noise {white_A * 1e9:.3f}"
    )
    assert np.std(error) == pytest.approx(np.sqrt(covariance_of(whitener)[0, 0]), rel=0.05)
    assert lag_1 == pytest.approx(-0.5, abs=0.05)
    assert hour == pytest.approx(stated, rel=0.1)  # 400 trials: 3.5 %
    assert white_A > 4 * hour


@pytest.mark.validates(
    "95 % intervals of level and drift of 100 windows; wrong noise is noticed",
    against="400 simulated series of charge that flowed, whole pulses counted",
)
@pytest.mark.parametrize("mistake", ["none", "white", "no walk"])
def test_intervals_of_a_mean_and_a_slope_cover(record_property: Callable[[str, object], None], mistake: str) -> None:
    """95 % intervals of level and drift over 100 windows; two plausible mistakes must not pass."""
    rng = np.random.default_rng(404)
    trials, windows = 400, 100
    current = rng.uniform(350e-9, 450e-9, (trials, 1))
    charge = charges(rng, trials, windows, current, WALK_A_rth)
    readings = counted(charge, rng.uniform(size=(trials, 1)))
    times = (np.arange(windows) + 0.5) * GATE_s
    walk = 0.0 if mistake == "no walk" else WALK_A_rth
    whitener = series_covariance("gated", times, GATE_s, K0_C, WHITE_A_rtHz, walk, mistake != "white")
    design = whitener.whiten(np.column_stack((np.ones(windows), times / times[-1])))
    covariance = np.linalg.inv(design.T @ design)
    white = whitener.whiten(readings.T)
    found = covariance @ design.T @ white
    chi2 = np.mean(np.sum((white - design @ found) ** 2, axis=0)) / (windows - 2)
    errors = found - np.vstack((current[:, 0], np.zeros(trials)))
    covered = 100.0 * np.mean(np.abs(errors) < 1.96 * np.sqrt(np.diag(covariance))[:, None], axis=1)
    print(f"{mistake}: level {covered[0]:.1f} %, drift {covered[1]:.1f} %, reduced chi-square {chi2:.3f}")
    record_property("obtained", f"mistake {mistake}: {covered[0]:.1f} and {covered[1]:.1f} %")
    right = bool(np.all(np.abs(covered - 95.0) < 3.5)) and abs(chi2 - 1.0) < 0.1
    assert right == (mistake == "none")


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
    print(f"reciprocal: sd {np.std(error) * 1e9:.3f} nA, lag-1 {lag_1:.3f}")
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
