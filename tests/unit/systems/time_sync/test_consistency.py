"""The filter against what it filters: errors as large as it says, the error model against its mechanisation."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from sync_rig import BASE, LEVEL_UNTIL_S, flight, level_matrices, setup, turning_path, white_egi

from bench.maths.strapdown import earth_rate, navigate, small_rotation
from bench.systems.time_sync.estimators.kalman import innovation
from bench.systems.time_sync.estimators.kalman.filter import (
    first_model,
    propagate,
    refresh_model,
    run_filter,
    skew,
    transition,
)
from bench.systems.time_sync.estimators.kalman.setup import (
    OFFSET,
    STATES,
    FilterSetup,
    ImuDensities,
    ImuSamples,
)
from sim_instruments.worlds.time_sync.flight.imu import ImuClass, ImuRuns, imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]

RUNS, SEED = 40, 0
SIGMAS = (0.5, 0.05, 0.05)
STEP_S, INTERVALS = 0.005, 4
LATITUDE_DEG = 37.5
SIZES = np.append(np.repeat([10.0, 0.1, 1e-4, 1e-2, 1e-4], 3), 0.0)  # m, m/s, rad, m/s^2, rad/s, no offset


def samples_of(unit: ImuRuns) -> ImuSamples:
    return ImuSamples(unit.t_s, unit.dv, unit.dtheta, np.zeros(unit.t_s.size, bool))


@pytest.mark.validates(
    "covariance of the time-offset filter, all states and the offset alone",
    against="NEES and NIS of 40 runs, chi-square bounds of 99.9 % at five times",
)
def test_a_filter_whose_assumptions_hold_is_consistent() -> None:
    """NEES of all states and of the offset, NIS and its scatter, within bounds left once in a thousand.

    Every assumption of the filter holds: white EGI errors of the stated sizes, a first state as uncertain as stated,
    offsets drawn from their distribution, standing still at first so that the offset is not in the first position.
    """
    path = FlightPath(((0.0, 0.0, 0.0), (1.5, 8.0, 0.0), (4.0, 0.0, 9.0)))
    unit = imu_runs(path, 6.0, RUNS, SEED)
    offsets_s = np.random.default_rng(SEED).normal(size=RUNS) * 0.03
    egi = white_egi(path, SIGMAS, offsets_s, SEED + 1)
    sizes = dict(zip(("position_sigma_m", "velocity_sigma_m_s", "attitude_sigma_deg"), SIGMAS, strict=True))
    run = run_filter(samples_of(unit), egi, setup(1, SIGMAS, **sizes))
    true = path.state(run.t_s)
    errors = innovation.state_errors(
        run, true.p, true.v, level_matrices(true.yaw), unit.accel_bias, unit.gyro_bias, np.zeros(1)
    )
    errors[..., 15] = run.offset_s - offsets_s
    (low, high), alone = (np.array(stats.chi2.interval(0.999, dof * RUNS)) / RUNS for dof in (16, 1))
    for t_s in (1.0, 2.5, 3.9, 4.5, 5.9):
        k = int(np.searchsorted(run.t_s, t_s))
        solved = np.swapaxes(np.linalg.solve(run.covariance[k], np.swapaxes(errors[k], -1, -2)), -1, -2)
        assert low < np.sum(errors[k] * solved, axis=-1).mean() < high, t_s
        assert alone[0] < innovation.nees_of_offset(errors[k, ..., 15], run.covariance[k]).mean() < alone[1], t_s
    summary = innovation.nis_summary(run)
    assert summary.ratio == pytest.approx(1.0, abs=0.02)
    assert summary.outside == pytest.approx(0.05, abs=0.006)
    assert np.all(summary.count == run.t_s.size * RUNS)


@pytest.mark.parametrize(("first_m", "level_low"), [(10.0, 0.8), (1.0, 0.0)])
def test_the_turn_is_what_makes_the_offset_observable(first_m: float, level_low: float) -> None:
    trip = flight(6)
    both = FilterSetup((True, False), (BASE, BASE), position_sigma_m=first_m, keep_every=5)
    run = run_filter(trip.imu, trip.egi((0.02, 0.02)), both)
    told = innovation.observability(run.covariance, run.first_covariance)
    level, end = int(np.searchsorted(run.t_s, LEVEL_UNTIL_S - 0.1)), -1
    assert np.isnan(told.associated[:, 1]).all()
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
    told = innovation.observability(covariance[None], first)
    assert told.associated[0, 0] == pytest.approx(0.25)
    assert told.offset_variance[0, 0] == pytest.approx(0.25)
    assert told.component[0, 0] == pytest.approx(1.0)
    for dof, bounds in zip(innovation.NIS_DOF, innovation.NIS_BOUNDS, strict=True):
        assert bounds == pytest.approx(stats.chi2.ppf([0.025, 0.975], dof), rel=1e-5)


def test_error_model_is_that_of_the_mechanisation() -> None:
    """Each error by itself, put into the strapdown and carried on for one EGI interval by both."""
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 7, 3))
    assert np.einsum("nij,nj->ni", skew(a), b) == pytest.approx(np.cross(a, b), abs=1e-15)
    p0, v0, C0 = rng.normal(size=3) * 1e3, rng.normal(size=3) * 100.0, small_rotation(np.array([0.06, -0.03, 0.05]))
    force = np.array([3.0, -20.0, -12.0])
    dv = np.tile(STEP_S * force, (INTERVALS, 1))
    dtheta = np.tile(STEP_S * C0.T @ earth_rate(LATITUDE_DEG), (INTERVALS, 1))  # does not turn against the plane
    t_s = STEP_S * np.arange(1, INTERVALS + 1)
    span_s = float(t_s[-1])

    def flown(error: Array) -> tuple[Array, Array, Array]:
        track = navigate(
            t_s, dv - error[9:12] * STEP_S, dtheta - error[12:15] * STEP_S, p0 + error[:3], v0 + error[3:6],
            small_rotation(error[6:9]) @ C0, LATITUDE_DEG,
        )  # fmt: skip
        return track.p[-1], track.v[-1], track.C[-1]

    true = flown(np.zeros(STATES))
    F = first_model(FilterSetup((True,), ((1.0, 1.0, 1.0),), latitude_deg=LATITUDE_DEG))
    refresh_model(F, (C0 @ force)[None], C0[None])
    third = np.linalg.matrix_power(np.abs(F[0] * span_s), 3) / 6.0  # the model goes to the second power
    for error in np.diag(SIZES)[:OFFSET]:
        found = flown(error)
        due = np.concatenate((found[0] - true[0], found[1] - true[1], innovation.rotation_between(found[2], true[2])))
        # with the offset, which does not change, an error has the covariance that the error itself becomes
        P = np.zeros((1, STATES, STATES))
        P[0, :, OFFSET], P[0, OFFSET] = error, error
        modelled = propagate(P, transition(F, span_s), np.zeros(STATES))[0, :9, OFFSET]
        limit = 2e-3 * np.abs(due) + 2.0 * (third @ error)[:9] + np.repeat([2e-12, 2e-13, 2e-15], 3)
        assert np.all(np.abs(modelled - due) <= limit), (error, modelled, due)


def test_biases_are_found_with_their_signs() -> None:
    """Sensors whose biases stand far above all noise, in a turn: what is left of them is a small part."""
    path, runs = turning_path(), 3
    unit = imu_runs(path, 6.0, runs, 5, ImuClass(5000.0, 0.1, 300.0, 1e-3))
    egi = white_egi(path, (0.01, 0.002, 0.001), np.full(runs, 0.0137), 6)
    begin = FilterSetup(
        (True,), ((0.01, 0.002, 0.001),), position_sigma_m=5.0, velocity_sigma_m_s=0.01, attitude_sigma_deg=0.002,
        imu=ImuDensities(5000.0, 0.1, 300.0, 1e-3),
    )  # fmt: skip
    run = run_filter(samples_of(unit), egi, begin)
    for found, true in ((run.accel_bias, unit.accel_bias), (run.gyro_bias, unit.gyro_bias)):
        left = found[-1, 0] - true
        assert np.sqrt(np.mean(left**2)) < 0.05 * np.sqrt(np.mean(true**2))
    assert run.offset_s[-1, 0] == pytest.approx(0.0137, abs=2e-4)


RATE_rad_s = 0.3
ACCELERATION_m_s2 = np.array([4.0, -2.0, 1.0])
JUMP = np.array([2.0, 0.0, 0.0, 0.5, -0.3, 0.2, 0.0, 0.0, 1e-3])  # position, velocity, rotation


def true_state(t_s: float) -> Array:
    """(15, 1, 1): accelerated from 50 m/s, turning about the vertical."""
    v = np.array([50.0, 0.0, 0.0]) + ACCELERATION_m_s2 * t_s
    p = np.array([50.0, 0.0, 0.0]) * t_s + 0.5 * ACCELERATION_m_s2 * t_s**2
    C = small_rotation(np.array([0.0, 0.0, RATE_rad_s * t_s])[:, None])[..., 0]
    return np.concatenate([p, v, C.ravel()])[:, None, None]


def past_of(corrected_at: int | None, t_s: float) -> innovation.Past:
    """Of 40 samples; the first ones, up to a correction, are wrong by minus JUMP."""
    history = innovation.History(np.arange(100) * 0.005, 0.1, 1, 1)
    for j in range(40):
        state = true_state(j * 0.005)
        if corrected_at is not None and j <= corrected_at:
            state[:3] += -JUMP[:3, None, None] - JUMP[3:6, None, None] * (j - corrected_at) * 0.005
            state[3:6] -= JUMP[3:6, None, None]
            turn = small_rotation(-JUMP[6:, None])[..., 0]
            state[6:] = (turn @ state[6:].reshape(3, 3)).reshape(9, 1, 1)
        history.store(j, state)
        if j == corrected_at:
            history.correct(-JUMP[:, None, None], true_state(j * 0.005))
    return history.read(np.array([[t_s]]))


@pytest.mark.parametrize("corrected_at", [None, 30, 33, 34, 38])
@pytest.mark.parametrize("t_s", [0.1713, 0.15, 0.2021, 0.165])
def test_a_past_state_is_what_it_would_be_with_the_correction(t_s: float, corrected_at: int | None) -> None:
    """And the correction is no acceleration and no turn: 0.6 m/s in 20 ms would be 30 m/s2 and 3 deg/s."""
    past, true = past_of(corrected_at, t_s), true_state(t_s)
    assert past.p == pytest.approx(true[:3], abs=1e-9)
    assert past.v == pytest.approx(true[3:6], abs=1e-9)
    turned = innovation.rotation_between(past.C, true[6:].reshape(3, 3, 1, 1)) + past.turned
    assert turned == pytest.approx(np.zeros((3, 1, 1)), abs=1e-5)
    assert past.age_s == pytest.approx(39 * 0.005 - t_s)
    assert past.acceleration[:, 0] == pytest.approx(ACCELERATION_m_s2, abs=1e-6)
    assert past.rate[:, 0] == pytest.approx([0.0, 0.0, RATE_rad_s], abs=1e-4)


def test_beyond_what_is_stored_motion_goes_on_evenly() -> None:
    for t_s in (0.26, 0.02):  # ahead of the newest, and from before the oldest of 0.1 s
        past, true = past_of(None, t_s), true_state(t_s)
        assert past.p == pytest.approx(true[:3], abs=1e-6)
        assert past.v == pytest.approx(true[3:6], abs=1e-6)
        turned = innovation.rotation_between(past.C, true[6:].reshape(3, 3, 1, 1))
        assert turned == pytest.approx(np.zeros((3, 1, 1)), abs=1e-3)
