"""Covariance of the 16 states: error model, propagation, update. Axes: groups first, then the matrix.

Source: error model of a strapdown system in a frame fixed to the Earth, rotation vector in t, estimate minus truth;
update in Joseph's form (Bucy and Joseph 1968), which stays positive whatever the gain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.maths.strapdown_earth import earth_rate, gradient
from bench.systems.time_sync.estimators.kalman.setup import OFFSET, STATES, FilterSetup

Array = NDArray[np.float64]


def skew(vector: Array) -> Array:
    """[vector x] of (..., 3): (..., 3, 3)."""
    out = np.zeros((*vector.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -vector[..., 2], vector[..., 1], -vector[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = vector[..., 2], -vector[..., 1], vector[..., 0]
    return out


def first_covariance(setup: FilterSetup) -> Array:
    """Diagonal covariance at the begin, (G, 16, 16); the offset's variance is zero where it is not a state."""
    accel, gyro = setup.imu.bias_sigmas
    attitude = np.deg2rad(setup.attitude_sigma_deg)
    sigmas = np.repeat([setup.position_sigma_m, setup.velocity_sigma_m_s, attitude, accel, gyro], 3)
    out = np.zeros((setup.groups, STATES, STATES))
    for group, augmented in enumerate(setup.augmented):
        out[group, range(STATES), range(STATES)] = np.append(sigmas, setup.offset_sigma_s * augmented) ** 2
    return out


def first_model(setup: FilterSetup) -> Array:
    """Error model (G, 16, 16) with what does not change; ``refresh_model`` fills in the rest."""
    rate = skew(earth_rate(setup.latitude_deg))
    F = np.zeros((setup.groups, STATES, STATES))
    F[:, range(3), range(3, 6)] = 1.0
    F[:, range(3, 6), range(3)] = gradient(setup.latitude_deg)
    F[:, 3:6, 3:6] = -2.0 * rate
    F[:, 6:9, 6:9] = -rate
    return F


def refresh_model(F: Array, force: Array, C: Array) -> None:
    """Put specific force in t (G, 3) m/s^2 and body-to-t matrix (G, 3, 3), both means of the estimates, into F."""
    F[:, 3:6, 6:9] = -skew(force)
    F[:, 3:6, 9:12] = -C
    F[:, 6:9, 12:15] = -C


def transition(F: Array, dt: float) -> Array:
    """Return what errors become within ``dt`` seconds, (G, 16, 16), to second order."""
    step = F * dt
    phi = 0.5 * np.matmul(step, step)
    phi += step
    phi += np.eye(STATES)
    return np.asarray(phi)


def propagate(P: Array, phi: Array, noise: Array) -> Array:
    """Return covariance after a transition; ``noise`` (16,): variance that each state gains in that time."""
    out: Array = np.matmul(np.matmul(phi, P), phi.transpose(0, 2, 1))
    out[:, range(STATES), range(STATES)] += noise
    return out


def measurement_rows(F: Array, age_s: Array, sensitivity: Array) -> Array:
    """Return rows of the innovation (estimate minus EGI: position, velocity, rotation) over the states, (G, 9, 16).

    Args:   F: error model.   age_s: (G,) how long ago the EGI sample was valid; the errors of then are those of now
            less F times that.   sensitivity: (G, 9) velocity, acceleration, rate at that time.
    Source: Lee et al. 2020, equation (13), h = -[v; a; w]: more offset means an older, hence smaller, prediction.
    """
    H = -age_s[:, None, None] * F[:, :9]
    H[:, range(9), range(9)] += 1.0
    H[:, :, OFFSET] = -sensitivity
    return H


def gain(P: Array, H: Array, noise: Array) -> tuple[Array, Array]:
    """Kalman gain (G, 16, z) and covariance of the innovation (G, z, z); ``noise`` (G, z) variances."""
    PHt = np.matmul(P, H.transpose(0, 2, 1))
    S = np.matmul(H, PHt)
    rows = range(H.shape[1])
    S[:, rows, rows] += noise
    return np.matmul(PHt, np.linalg.inv(S)), S


def update(P: Array, K: Array, H: Array, noise: Array) -> Array:
    """Return covariance after the correction, Joseph's form, made symmetric."""
    rest = -np.matmul(K, H)
    rest[:, range(STATES), range(STATES)] += 1.0
    out: Array = np.matmul(np.matmul(rest, P), rest.transpose(0, 2, 1))
    out += np.matmul(K * noise[:, None], K.transpose(0, 2, 1))
    return np.asarray(0.5 * (out + out.transpose(0, 2, 1)))
