"""Closed-loop filter of an IMU against an EGI whose samples may be late: 15 states, and the time offset as the 16th.

Every lane has its own estimates, all lanes of a group one covariance, linearised about the mean of their estimates.

Source: Lee et al., JKSAS 48(4), 2020, section 3.1, corrected: errors are estimate minus truth, the sample is predicted
from the filter's own states at t - T_hat, the offset's process noise is zero.

Covariance of the 16 states: error model, propagation, update. Axes: groups first, then the matrix.

Source: error model of a strapdown system in a frame fixed to the Earth, rotation vector in t, estimate minus truth;
update in Joseph's form (Bucy and Joseph 1968), which stays positive whatever the gain.

How far a filter really is off, when the errors of the EGI are not the white noise that it takes them for.

The gains of the filter are what they are. Its errors and those of the EGI together, 16 and 9, go through the same
linear steps, and their covariance with them: errors of position and velocity wander for tens of seconds, that of the
heading for minutes, roll and pitch stay. No draws are needed.

Source: covariance analysis of a suboptimal filter with augmented states, Gelb, Applied Optimal Estimation (1974),
section 7.2; Gauss-Markov errors, Brown and Hwang (2012), section 4.6.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.strapdown import Strapdown, earth_rate, gradient, small_rotation
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.kalman.innovation import (
    EgiSample,
    History,
    NisSums,
    block_of,
    egi_samples,
    filled_noise,
    innovation,
    motion_noise,
)
from bench.systems.time_sync.estimators.kalman.setup import (
    OFFSET,
    STATES,
    EgiSource,
    EgiSpread,
    FilterRun,
    FilterSetup,
    FineTrack,
    ImuDensities,
    ImuSamples,
)

_EGI = 9  # errors of the EGI: position, velocity, rotation vector
_LONGEST_STEP_s = 0.2  # of the covariance, where EGI samples are lost


def skew(vector: Floats) -> Floats:
    """[vector x] of (..., 3): (..., 3, 3)."""
    out = np.zeros((*vector.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -vector[..., 2], vector[..., 1], -vector[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = vector[..., 2], -vector[..., 1], vector[..., 0]
    return out


def first_covariance(setup: FilterSetup) -> Floats:
    """Diagonal covariance at the begin, (G, 16, 16); the offset's variance is zero where it is not a state."""
    accel, gyro = setup.imu.bias_sigmas
    attitude = np.deg2rad(setup.attitude_sigma_deg)
    sigmas = np.repeat([setup.position_sigma_m, setup.velocity_sigma_m_s, attitude, accel, gyro], 3)
    out = np.zeros((setup.groups, STATES, STATES))
    for group, augmented in enumerate(setup.augmented):
        out[group, range(STATES), range(STATES)] = np.append(sigmas, setup.offset_sigma_s * augmented) ** 2
    return out


def first_model(setup: FilterSetup) -> Floats:
    """Error model (G, 16, 16) with what does not change; ``refresh_model`` fills in the rest."""
    rate = skew(earth_rate(setup.latitude_deg))
    F = np.zeros((setup.groups, STATES, STATES))
    F[:, range(3), range(3, 6)] = 1.0
    F[:, range(3, 6), range(3)] = gradient(setup.latitude_deg)
    F[:, 3:6, 3:6] = -2.0 * rate
    F[:, 6:9, 6:9] = -rate
    return F


def refresh_model(F: Floats, force: Floats, C: Floats) -> None:
    """Put specific force in t (G, 3) m/s^2 and body-to-t matrix (G, 3, 3), both means of the estimates, into F."""
    F[:, 3:6, 6:9] = -skew(force)
    F[:, 3:6, 9:12] = -C
    F[:, 6:9, 12:15] = -C


def transition(F: Floats, dt: float) -> Floats:
    """Return what errors become within ``dt`` seconds, (G, 16, 16), to second order."""
    step = F * dt
    phi = 0.5 * np.matmul(step, step)
    phi += step
    phi += np.eye(STATES)
    return np.asarray(phi)


def propagate(P: Floats, phi: Floats, noise: Floats) -> Floats:
    """Return covariance after a transition; ``noise`` (16,): variance that each state gains in that time."""
    out: Floats = np.matmul(np.matmul(phi, P), phi.transpose(0, 2, 1))
    out[:, range(STATES), range(STATES)] += noise
    return out


def measurement_rows(F: Floats, age_s: Floats, sensitivity: Floats) -> Floats:
    """Return rows of the innovation (estimate minus EGI: position, velocity, rotation) over the states, (G, 9, 16).

    Args:   F: error model.   age_s: (G,) how long ago the EGI sample was valid; the errors of then are those of now
            less F times that.   sensitivity: (G, 9) velocity, acceleration, rate at that time.
    Source: Lee et al. 2020, equation (13), h = -[v; a; w]: more offset means an older, hence smaller, prediction.
    """
    H = -age_s[:, None, None] * F[:, :9]
    H[:, range(9), range(9)] += 1.0
    H[:, :, OFFSET] = -sensitivity
    return H


def gain(P: Floats, H: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Kalman gain (G, 16, z) and covariance of the innovation (G, z, z); ``noise`` (G, z) variances."""
    PHt = np.matmul(P, H.transpose(0, 2, 1))
    S = np.matmul(H, PHt)
    rows = range(H.shape[1])
    S[:, rows, rows] += noise
    return np.matmul(PHt, np.linalg.inv(S)), S


def update(P: Floats, K: Floats, H: Floats, noise: Floats) -> Floats:
    """Return covariance after the correction, Joseph's form, made symmetric."""
    rest = -np.matmul(K, H)
    rest[:, range(STATES), range(STATES)] += 1.0
    out: Floats = np.matmul(np.matmul(rest, P), rest.transpose(0, 2, 1))
    out += np.matmul(K * noise[:, None], K.transpose(0, 2, 1))
    return 0.5 * (out + out.transpose(0, 2, 1))


class RealCovariance:
    """Covariance (G, 25, 25) of errors of the filter and of the EGI, from the first solution on.

    Args: groups: filters.   spread: errors of the EGI.   imu: of the inertial unit.   edges_s: of blocks of solutions.
    Attributes: response: (G, 16, b, 9) what errors of 1 of all solutions of a block make of the states.
    """

    def __init__(self, groups: int, spread: EgiSpread, imu: ImuDensities, edges_s: Floats) -> None:
        heading, level = math.radians(spread.heading_deg), math.radians(spread.level_deg)
        sigma = np.array([*(spread.position_m,) * 3, *(spread.velocity_m_s,) * 3, level, level, heading])
        self._variance = sigma**2
        self._rate = np.repeat([1.0 / spread.wander_s, 0.0, 1.0 / spread.heading_wander_s], [6, 2, 1])
        self._S = np.zeros((groups, STATES + _EGI, STATES + _EGI))
        first, own = np.arange(_EGI), np.arange(STATES, STATES + _EGI)
        for rows in (first, own):  # the filter begins with a solution, and with its errors
            self._S[:, rows, first] = self._S[:, rows, own] = self._variance
        accel, gyro = imu.bias_sigmas
        self._S[:, range(9, 15), range(9, 15)] = np.repeat([accel, gyro], 3) ** 2
        self._edges_s = edges_s
        self.response = np.zeros((groups, STATES, edges_s.size - 1, _EGI))
        self.response[:, first, 0, first] = 1.0

    def propagate(self, phi: Floats, noise: Floats) -> None:
        """Take the errors of the filter on; ``phi`` (G, 16, 16), ``noise`` (16,): as those of the filter itself."""
        S = self._S
        flat = self._flat_response()
        flat[...] = np.matmul(phi, flat)
        S[:, :STATES] = np.matmul(phi, S[:, :STATES])
        S[:, :, :STATES] = np.matmul(S[:, :, :STATES], phi.transpose(0, 2, 1))
        S[:, range(STATES), range(STATES)] += noise

    def wander(self, dt: float) -> None:
        """Take the errors of the EGI on from one solution to the next."""
        kept = np.exp(-self._rate * dt)
        S, own = self._S, np.arange(STATES, STATES + _EGI)
        S[:, STATES:] *= kept[:, None]
        S[:, :, STATES:] *= kept
        S[:, own, own] += self._variance * (1.0 - kept**2)

    def update(self, K: Floats, H: Floats, at_s: float) -> None:
        """Correct by a solution; ``K`` (G, 16, z), ``H`` (G, z, 16): gain and rows of the last z of 9 differences."""
        S = self._S
        flat = self._flat_response()
        flat -= np.matmul(K, np.matmul(H, flat))
        self.response[:, :, block_of(at_s, self._edges_s), _EGI - K.shape[2] :] += K
        change = np.concatenate((-H, np.zeros((*H.shape[:2], _EGI))), axis=2)
        change[:, range(H.shape[1]), range(STATES + _EGI - H.shape[1], STATES + _EGI)] = 1.0
        step = np.matmul(K, change)
        S[:, :STATES] += np.matmul(step, S)
        S[:, :, :STATES] += np.matmul(S, step.transpose(0, 2, 1))

    def _flat_response(self) -> Floats:
        return self.response.reshape(*self.response.shape[:2], -1)

    @property
    def of_filter(self) -> Floats:
        """Return the covariance of the errors of the filter, (G, 16, 16)."""
        return self._S[:, :STATES, :STATES].copy()


class _Filter:
    """State of a run; one call of ``imu`` per IMU sample, one of ``egi`` per EGI sample."""

    def __init__(self, imu: ImuSamples, setup: FilterSetup, begin: EgiSample, start: int) -> None:
        groups, runs = setup.groups, imu.dv.shape[1]
        self._setup, self._t_s = setup, imu.t_s
        interval_s = float(np.median(np.diff(imu.t_s)))
        self.ins = Strapdown((groups, runs), setup.latitude_deg, interval_s)
        self._history = History(imu.t_s, setup.reach_s, groups, runs)
        self._offset_s = np.full((groups, runs), setup.offset0_s)
        self._P = self._first_P = first_covariance(setup)
        self._F = first_model(setup)
        self._real = RealCovariance(groups, setup.egi, setup.imu, setup.edges_s) if setup.egi is not None else None
        sigma_r = np.array(setup.sigma_r) * (1.0, 1.0, np.pi / 180.0)
        self._R = np.repeat(sigma_r**2, 3, axis=1)
        self._filled = filled_noise(imu)
        self._motion_noise = motion_noise(setup.imu, interval_s, runs)
        self._nis = NisSums(groups)
        self._j = self._at = start  # newest IMU sample; sample to which the covariance belongs
        self._seen = 0
        self._epochs: list[tuple[Floats, ...]] = []  # as the fields of FilterRun
        self._fine: list[tuple[Floats, ...]] = []  # as those of FineTrack
        self._before_s = begin.t_s
        since_s = imu.t_s[start] - begin.t_s + setup.offset0_s  # the state begins at an IMU sample
        self.ins.p[...], self.ins.v[...], self.ins.C[...] = begin.p + since_s * begin.v, begin.v, begin.C
        self._mean_C = self.ins.C.mean(axis=-1).transpose(2, 0, 1)
        self._history.store(start, self.ins.state)

    def imu(self, j: int, dv: Floats, dtheta: Floats, dt: float) -> None:
        """Take one IMU sample (3, 1, R) in."""
        self.ins.step(dv, dtheta, dt)
        self._j = j
        self._history.store(j, self.ins.state)
        if self._t_s[j] - self._t_s[self._at] > _LONGEST_STEP_s:
            self._propagate()
        if self._t_s[j] >= self._setup.fine_from_s:
            self._fine.append((self._t_s[j], *_lanes_first(self.ins.p, self.ins.v, self.ins.C)))

    def egi(self, sample: EgiSample) -> None:
        """Take one EGI sample in, keep the epoch if it is its turn."""
        self._propagate()
        if self._real is not None:
            self._real.wander(sample.t_s - self._before_s)
        self._before_s = sample.t_s
        if sample.usable.any():
            self._correct(sample)
        self._seen += 1
        if self._seen % self._setup.keep_every == 0:
            ins = self.ins
            states = _lanes_first(ins.p, ins.v, ins.C, ins.bias_v, ins.bias_theta)
            epoch = (self._t_s[self._j], *states, self._offset_s.copy(), self._P, *self._nis.take())
            self._epochs.append(epoch)

    def result(self) -> FilterRun:
        """Return what was kept."""
        epochs, fine = (map(np.array, zip(*kept, strict=True)) for kept in (self._epochs, self._fine))
        run = FilterRun(*epochs, first_covariance=self._first_P, fine=FineTrack(*fine) if self._fine else None)
        real = self._real
        return run if real is None else replace(run, real_covariance=real.of_filter, response=real.response)

    def _propagate(self) -> None:
        """Bring the covariance to the newest IMU sample, by the means of force and attitude since."""
        dt = float(self._t_s[self._j] - self._t_s[self._at])
        if dt <= 0.0:
            return
        C = self.ins.C.mean(axis=-1).transpose(2, 0, 1)
        refresh_model(self._F, self.ins.specific.mean(axis=-1).T / dt, 0.5 * (C + self._mean_C))
        self._mean_C, self.ins.specific[...] = C, 0.0
        noise = np.zeros(OFFSET + 1)
        noise[3:6] = self._setup.imu.velocity_walk**2 * dt
        noise[6:9] = self._setup.imu.angle_walk**2 * dt
        noise[3:9] += self._filled[self._j] - self._filled[self._at]
        phi = transition(self._F, dt)
        self._P = propagate(self._P, phi, noise)
        if self._real is not None:
            self._real.propagate(phi, noise)
        self._at = self._j

    def _correct(self, sample: EgiSample) -> None:
        dz, past, sensitivity = innovation(sample, self._offset_s, self._history, self._motion_noise)
        dz = np.where(sample.usable[:, None, None], dz, 0.0)
        H, R = measurement_rows(self._F, past.age_s, sensitivity), self._R
        if self._t_s[self._j] >= self._setup.hold_position_from_s:
            dz, H, R = np.ascontiguousarray(dz[:, 6:]), H[:, 6:], R[:, 6:]
        K, S = gain(self._P, H, R)
        K *= sample.usable[:, None, None]
        self._nis.add(dz, S, sample.usable)
        self._P = update(self._P, K, H, R)
        if self._real is not None:
            self._real.update(K, H, sample.t_s)
        self._feed_back(np.ascontiguousarray(np.matmul(K, dz).transpose(1, 0, 2)))

    def _feed_back(self, dx: Floats) -> None:
        """Take the estimated errors (16, G, R) out of the states; errors are estimate minus truth."""
        ins = self.ins
        ins.state[:6] -= dx[:6]
        turn = small_rotation(-dx[6:9])
        ins.C[...] = np.add.reduce(turn[:, :, None] * ins.C[None], axis=1)
        ins.bias_v -= dx[9:12]
        ins.bias_theta -= dx[12:15]
        self._offset_s -= dx[OFFSET]
        self._history.correct(dx[:9], ins.state)


def _lanes_first(*rows: Floats) -> list[Floats]:
    """Return copies with the axes of space last: of (3, G, R) or (3, 3, G, R)."""
    return [np.moveaxis(x, (-2, -1), (0, 1)).copy() for x in rows]


def run_filter(imu: ImuSamples, egi: EgiSource, setup: FilterSetup) -> FilterRun:
    """Run G filters on R lanes of an IMU and their EGI samples.

    The state begins at the first usable EGI sample within the IMU's. All arrays in SI, see ``FilterSetup``.

    Raises:  FitError B-FIT-116 if EGI and IMU do not overlap, or no EGI sample is usable.
    Source:  see the head of this file.
    """
    k0 = int(np.searchsorted(egi.t_s, imu.t_s[0]))
    samples = egi_samples(egi, k0)
    first, begin = next(((k, sample) for k, sample in enumerate(samples, k0) if sample.usable.all()), (-1, None))
    start = imu.t_s.size if begin is None else int(np.searchsorted(imu.t_s, begin.t_s))
    count = int(np.searchsorted(egi.t_s, imu.t_s[-1] - setup.look_ahead_s, side="right")) - first - 1
    if begin is None or start >= imu.t_s.size - 1 or count < 1:
        raise FitError(
            "B-FIT-116",
            f"no EGI sample can be held against the IMU: {egi.t_s.size} EGI samples, first usable one "
            f"{'none' if first < 0 else first}, IMU from {imu.t_s[0]:.6g} s to {imu.t_s[-1]:.6g} s",
            next_step="look at the mode and the tags of the EGI; both clocks must be on one time scale to some 0.5 s",
        )
    work = _Filter(imu, setup, begin, start)
    sample = next(samples, None)
    dv, dtheta = (np.moveaxis(x, -1, 1)[:, :, None] for x in (imu.dv, imu.dtheta))
    for j, dt in enumerate(np.diff(imu.t_s[start:]).tolist(), start + 1):
        work.imu(j, dv[j], dtheta[j], dt)
        while sample is not None and sample.t_s + setup.look_ahead_s <= imu.t_s[j]:
            work.egi(sample)
            sample = next(samples, None)
    return work.result()
