"""Error model of the filter against the mechanisation it is the error model of, and signs of what is fed back."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sync_flights import LaneOffsets, turning

from bench.maths.strapdown import earth_rate, navigate, small_rotation
from bench.systems.time_sync.estimators.kalman.filter import (
    first_model,
    propagate,
    refresh_model,
    run_filter,
    skew,
    transition,
)
from bench.systems.time_sync.estimators.kalman.innovation import rotation_between
from bench.systems.time_sync.estimators.kalman.setup import OFFSET, STATES, FilterSetup, ImuDensities, ImuSamples
from sim_instruments.worlds.time_sync.flight.imu import ImuClass, imu_runs

Array = NDArray[np.float64]

STEP_S, INTERVALS = 0.005, 4
LATITUDE_DEG = 37.5
SIZES = np.append(np.repeat([10.0, 0.1, 1e-4, 1e-2, 1e-4], 3), 0.0)  # m, m/s, rad, m/s^2, rad/s, no offset


def test_skew_is_the_matrix_of_the_cross_product() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 7, 3))
    assert np.einsum("nij,nj->ni", skew(a), b) == pytest.approx(np.cross(a, b), abs=1e-15)


def test_error_model_is_that_of_the_mechanisation() -> None:
    """Each error by itself, put into the strapdown and carried on for one EGI interval by both."""
    rng = np.random.default_rng(2)
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
        due = np.concatenate((found[0] - true[0], found[1] - true[1], rotation_between(found[2], true[2])))
        # with the offset, which does not change, an error has the covariance that the error itself becomes
        P = np.zeros((1, STATES, STATES))
        P[0, :, OFFSET], P[0, OFFSET] = error, error
        modelled = propagate(P, transition(F, span_s), np.zeros(STATES))[0, :9, OFFSET]
        limit = 2e-3 * np.abs(due) + 2.0 * (third @ error)[:9] + np.repeat([2e-12, 2e-13, 2e-15], 3)
        assert np.all(np.abs(modelled - due) <= limit), (error, modelled, due)


def test_biases_are_found_with_their_signs() -> None:
    """Sensors whose biases stand far above all noise, in a turn: what is left of them is a small part."""
    path, runs = turning(), 3
    unit = imu_runs(path, 6.0, runs, 5, ImuClass(5000.0, 0.1, 300.0, 1e-3))
    egi = LaneOffsets(path, np.arange(0.0213, 6.0, 0.02), (0.01, 0.002, 0.001), np.full(runs, 0.0137), 6)
    begin = FilterSetup(
        (True,), ((0.01, 0.002, 0.001),), position_sigma_m=5.0, velocity_sigma_m_s=0.01, attitude_sigma_deg=0.002,
        imu=ImuDensities(5000.0, 0.1, 300.0, 1e-3),
    )  # fmt: skip
    run = run_filter(ImuSamples(unit.t_s, unit.dv, unit.dtheta, np.zeros(unit.t_s.size, bool)), egi, begin)
    for found, true in ((run.accel_bias, unit.accel_bias), (run.gyro_bias, unit.gyro_bias)):
        left = found[-1, 0] - true
        assert np.sqrt(np.mean(left**2)) < 0.05 * np.sqrt(np.mean(true**2))
    assert run.offset_s[-1, 0] == pytest.approx(0.0137, abs=2e-4)
