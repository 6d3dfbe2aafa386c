"""Errors as large as the filter says, and how observability is told."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from sync_flights import BASE, LEVEL_UNTIL_S, LaneOffsets, flight, level_matrices

from bench.systems.time_sync.estimators.kalman import filter as sync_filter
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.innovation import (
    NIS_BOUNDS,
    NIS_DOF,
    nees_of_offset,
    nis_summary,
    observability,
    state_errors,
)
from bench.systems.time_sync.estimators.kalman.setup import FilterRun, FilterSetup, ImuSamples
from sim_instruments.worlds.time_sync.flight.imu import imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]

RUNS, SEED = 40, 0
SIGMAS = (0.5, 0.05, 0.05)


def nees(errors: Array, covariance: Array) -> Array:
    """Normalised error squared, (..., R), of the states given: errors (..., R, n), positive covariance (..., n, n)."""
    solved = np.linalg.solve(covariance, np.swapaxes(errors, -1, -2))
    return np.asarray(np.sum(errors * np.swapaxes(solved, -1, -2), axis=-1))


def matched() -> tuple[FilterRun, Array]:
    """A case in which every assumption of the filter holds: white EGI errors of the stated sizes, a first state as
    uncertain as stated, offsets drawn from their distribution, standing still at first so that the offset is not in
    the first position. Returns the run and the errors (m, 1, R, 16).
    """
    path = FlightPath(((0.0, 0.0, 0.0), (1.5, 8.0, 0.0), (4.0, 0.0, 9.0)))
    unit = imu_runs(path, 6.0, RUNS, SEED)
    offsets_s = np.random.default_rng(SEED).normal(size=RUNS) * 0.03
    egi = LaneOffsets(path, np.arange(0.0213, 6.0, 0.02), SIGMAS, offsets_s, SEED + 1)
    begin = FilterSetup(
        (True,),
        (SIGMAS,),
        position_sigma_m=SIGMAS[0],
        velocity_sigma_m_s=SIGMAS[1],
        attitude_sigma_deg=SIGMAS[2],
    )
    run = run_filter(ImuSamples(unit.t_s, unit.dv, unit.dtheta, np.zeros(unit.t_s.size, bool)), egi, begin)
    true = path.state(run.t_s)
    errors = state_errors(run, true.p, true.v, level_matrices(true.yaw), unit.accel_bias, unit.gyro_bias, np.zeros(1))
    errors[..., 15] = run.offset_s - offsets_s
    return run, errors


def consistent(run: FilterRun, errors: Array) -> None:
    """NEES of all states and of the offset, NIS and its scatter, within bounds left once in a thousand."""
    (low, high), alone = (np.array(stats.chi2.interval(0.999, dof * RUNS)) / RUNS for dof in (16, 1))
    for t_s in (1.0, 2.5, 3.9, 4.5, 5.9):
        k = int(np.searchsorted(run.t_s, t_s))
        assert low < nees(errors[k], run.covariance[k]).mean() < high, t_s
        assert alone[0] < nees_of_offset(errors[k, ..., 15], run.covariance[k]).mean() < alone[1], t_s
    summary = nis_summary(run)
    assert summary.ratio == pytest.approx(1.0, abs=0.02)
    assert summary.outside == pytest.approx(0.05, abs=0.006)
    assert np.all(summary.count == run.t_s.size * RUNS)


@pytest.mark.validates(
    "covariance of the time-offset filter, all states and the offset alone",
    against="NEES and NIS of 40 runs, chi-square bounds of 99.9 % at five times",
)
def test_a_filter_whose_assumptions_hold_is_consistent() -> None:
    consistent(*matched())


def test_a_filter_that_knows_too_much_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    propagate = sync_filter.propagate
    monkeypatch.setattr(sync_filter, "propagate", lambda P, phi, noise: propagate(P, phi, 0.0 * noise))
    with pytest.raises(AssertionError):
        consistent(*matched())


def test_a_forgotten_turn_of_the_force_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error model with the sign of [f x] the other way round."""
    refresh = sync_filter.refresh_model
    monkeypatch.setattr(sync_filter, "refresh_model", lambda F, force, C: refresh(F, -force, C))
    with pytest.raises(AssertionError):
        consistent(*matched())


def test_bounds_are_those_of_chi_square() -> None:
    for dof, bounds in zip(NIS_DOF, NIS_BOUNDS, strict=True):
        assert bounds == pytest.approx(stats.chi2.ppf([0.025, 0.975], dof), rel=1e-5)


@pytest.mark.parametrize(("first_m", "level_low"), [(10.0, 0.8), (1.0, 0.0)])
def test_the_turn_is_what_makes_the_offset_observable(first_m: float, level_low: float) -> None:
    trip = flight(6)
    both = FilterSetup((True, False), (BASE, BASE), position_sigma_m=first_m, keep_every=5)
    run = run_filter(trip.imu, trip.egi((0.02, 0.02)), both)
    told = observability(run.covariance, run.first_covariance)
    level, end = int(np.searchsorted(run.t_s, LEVEL_UNTIL_S - 0.1)), -1
    assert np.isnan(told.associated[:, 1]).all()
    assert np.isnan(told.eigenvalues[:, 1]).all()
    assert told.offset_variance[end, 0] < 1e-3
    if first_m == 10.0:
        assert told.associated[level, 0] > level_low
        assert told.associated[end, 0] < 1e-3
        assert told.component[level, 0] > 0.9
    else:  # the trap: the direction p - v T_d has most of the offset in it, and looks observed before any manoeuvre
        assert told.associated[level, 0] < 0.01
        assert told.offset_variance[level, 0] == pytest.approx(1.0 / (1.0 + 3.0**2), rel=0.15)


def test_eigenvalues_of_a_case_known_by_hand() -> None:
    first = np.diag(np.arange(1.0, 17.0) ** 2)[None]
    covariance = first * np.linspace(1.0, 0.25, 16)
    told = observability(covariance[None], first)
    assert told.eigenvalues[0, 0] == pytest.approx(np.sort(np.linspace(1.0, 0.25, 16)))
    assert told.associated[0, 0] == pytest.approx(0.25)
    assert told.offset_variance[0, 0] == pytest.approx(0.25)
    assert told.component[0, 0] == pytest.approx(1.0)
