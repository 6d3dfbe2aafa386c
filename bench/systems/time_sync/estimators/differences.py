"""Solutions of an EGI against the unaided integration of the inertial unit, as a linear model with known noise.

The filter takes one solution after the other and forgets; here all differences of a recording stand side by side, as
means over blocks of about a second, with what each unknown of the filter would make of them and with the covariance of
the errors that the makers of both units state. So residuals can be held against it, and what else could be true.

Source: error model of a strapdown system as in ``kalman.covariance``; generalised least squares, Aitken (1935);
Gauss-Markov errors and their means, Brown and Hwang (2012), section 4.6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats, Integers
from bench.maths.strapdown import Track, earth_rate, navigate
from bench.systems.time_sync.estimators.kalman.filter import first_model, refresh_model, skew
from bench.systems.time_sync.estimators.kalman.innovation import block_of, filled_noise, rotation_between
from bench.systems.time_sync.estimators.kalman.setup import (
    EgiSamples,
    EgiSpread,
    FilterSetup,
    ImuDensities,
    ImuSamples,
)

STATES = 15  # errors of position, velocity and attitude at the begin, biases of accelerometers and gyros
_FIXES = 0.25  # of what errors change by in a block: at a fix of its GPS an EGI corrects all of a solution at once
_SEEN = 9  # position, velocity, attitude
_BLOCK_s = 0.5
_FEWEST, _MOST = 12, 60  # blocks
_NODE_s = 0.1  # steps of the error model
_KICKS = 3  # of the walks, in a block
_DOUBT = 10.0  # a motion counts as seen where its square is above this many times that of its noise
_FLOOR = np.repeat([1e-3, 1e-4, 1e-6], 3)  # m, m/s, rad: arithmetic and resolution


@dataclass(frozen=True)
class Noise:
    """Stated errors, one sigma; ``tag_std_s``: white, of the tags of the EGI."""

    imu: ImuDensities
    egi: EgiSpread
    tag_std_s: float


@dataclass(frozen=True)
class Guess:
    """About which the model is linear: offset and biases (m/s2, rad/s; (3,) each)."""

    offset_s: float
    accel_bias: Floats
    gyro_bias: Floats


@dataclass(frozen=True)
class Differences:
    """Means over b blocks of prediction minus solution, position m, velocity m/s, attitude rad.

    ``block``: numbers (b,) between the edges.   ``at_s``: middles (b,).   ``y``: (b, 9).   ``states``: (b, 9, 15) what
    errors of the states make of them.   ``motion``: (b, 9) what a second of offset makes.   ``drifting``: (b, 9) what 1
    s/s of its drift makes.   ``others``: (b, 9, k) what else could be true, by name.   ``covariance``: (9 b, 9 b).
    """

    block: Integers
    at_s: Floats
    y: Floats
    states: Floats
    motion: Floats
    drifting: Floats
    others: Mapping[str, Floats]
    covariance: Floats


def differences(imu: ImuSamples, egi: EgiSamples, guess: Guess, noise: Noise, middle_s: float) -> Differences:
    """Hold solutions against the integration from the first of them on.

    Args:    imu: one lane.   egi: solutions inside its samples, tags by its clock.   guess: offset and biases nearby.
             noise: as stated.   middle_s: about which the drift of the tags was taken out.
    Source:  see the head of this file.
    """
    valid_s = egi.t_s - guess.offset_s
    start = max(int(np.searchsorted(imu.t_s, valid_s[0])), 0)
    use = (valid_s >= imu.t_s[start]) & (valid_s <= imu.t_s[-1])
    blocks = _Blocks(valid_s[use], block_of(egi.t_s, block_edges_s(egi.t_s))[use])
    egi = egi.part(use)
    path = _Path(imu, egi, guess, noise.imu, start)
    track = path.at(blocks.t_s)
    turned = rotation_between(np.moveaxis(track.C, 0, -1), np.moveaxis(egi.C, 0, -1)).T
    y = np.concatenate((track.p - egi.p, track.v - egi.v, turned), axis=1)
    transition, rate, acceleration = (
        path.between(values, blocks.t_s) for values in (path.X, path.rate, path.acceleration)
    )
    motion = np.concatenate((track.v, acceleration, rate), axis=1)
    mean_motion = blocks.mean(motion)
    covariance = blocks.covariance(noise.egi) + path.walked(blocks, noise.imu)
    tags = (noise.tag_std_s / np.sqrt(blocks.count))[:, None] * mean_motion
    for block, tag in enumerate(tags):
        part = slice(_SEEN * block, _SEEN * (block + 1))
        covariance[part, part] += np.outer(tag, tag)
    alone = blocks.mean(path.unsure(blocks.t_s) ** 2) / blocks.count[:, None] + blocks.changes(noise.egi) ** 2
    covariance += np.diag(alone.ravel())
    return Differences(
        block=blocks.number,
        at_s=blocks.at_s,
        y=blocks.mean(y),
        states=blocks.mean(transition[:, :_SEEN, :STATES]),
        motion=mean_motion,
        drifting=blocks.mean(motion * (egi.t_s - middle_s)[:, None]),
        others={name: blocks.mean(column) for name, column in _others(track.C, rate, transition).items()},
        covariance=covariance,
    )


def block_edges_s(t_s: Floats) -> Floats:
    """Return the edges (b + 1,) of blocks of equal length of solutions with tags (m,)."""
    number = int(np.clip((t_s[-1] - t_s[0]) / _BLOCK_s, _FEWEST, _MOST))
    return np.linspace(t_s[0], t_s[-1], number + 1)


def _others(C: Floats, rate: Floats, transition: Floats) -> dict[str, Floats]:
    """Return what else could be true of each solution, (m, 9, k) by name: m and rad along the body's axes, scales."""
    lever, axes = np.zeros((len(C), _SEEN, 3)), np.zeros((len(C), _SEEN, 3))
    lever[:, :3], lever[:, 3:6] = C, skew(rate) @ C
    axes[:, 6:] = C
    return {
        "lever_arm": lever,
        "axes": axes,
        "gyro_scale": transition[:, :_SEEN, STATES : STATES + 1],
        "accelerometer_scale": transition[:, :_SEEN, STATES + 1 : STATES + 2],
    }


class _Path:
    """Integration of the inertial unit, and the error model along it at nodes."""

    def __init__(self, imu: ImuSamples, egi: EgiSamples, guess: Guess, densities: ImuDensities, start: int) -> None:
        t_s = imu.t_s[start + 1 :]
        dt = np.diff(imu.t_s[start:])[:, None]
        dv = imu.dv[start + 1 :, 0] - guess.accel_bias * dt
        dtheta = imu.dtheta[start + 1 :, 0] - guess.gyro_bias * dt
        changes = [np.diff(x, axis=0, prepend=x[:1], append=x[-1:]) for x in (0.0 * dv, dv, dtheta)]
        self._changes = np.linalg.norm(changes, axis=2).T
        first_p = egi.p[0] + egi.v[0] * (imu.t_s[start] - egi.t_s[0] + guess.offset_s)
        latitude_deg, begin_s = egi.frame.latitude_deg, float(imu.t_s[start])
        walked = navigate(t_s, dv, dtheta, first_p, egi.v[0], egi.C[0], latitude_deg, begin_s)
        begin = [values[None] for values in (first_p, egi.v[0], egi.C[0])]
        p, v, C = (np.concatenate((one, rest)) for one, rest in zip(begin, (walked.p, walked.v, walked.C), strict=True))
        self._track = Track(imu.t_s[start:], p, v, C)
        stride = max(1, round(_NODE_s / float(np.median(dt))))
        self._node = np.append(np.arange(0, len(C) - 1, stride), len(C) - 1)
        self.t_s = self._track.t_s[self._node]
        steps_s = np.diff(self.t_s)[:, None]
        middle = 0.5 * (C[1:] + C[:-1])
        self._force = self._over_nodes(np.einsum("nij,nj->ni", middle, dv)) / steps_s
        turning = self._over_nodes(np.einsum("nij,nj->ni", middle, dtheta)) / steps_s
        rate = turning - earth_rate(latitude_deg)
        self._turning = rate * _shown(rate, densities.angle_walk**2 / steps_s)
        acceleration = np.diff(v[self._node], axis=0) / steps_s
        acceleration *= _shown(acceleration, densities.velocity_walk**2 / steps_s)
        self._filled = filled_noise(imu)[start:][self._node]
        self.rate, self.acceleration = _at_nodes(self._turning), _at_nodes(acceleration)
        self.X = self._transitions(C, latitude_deg)

    def _over_nodes(self, increments: Floats) -> Floats:
        return np.add.reduceat(increments, self._node[:-1], axis=0)

    def _transitions(self, C: Floats, latitude_deg: float) -> Floats:
        """Return errors at the nodes by errors at the begin, and by 1 of both scales: (nodes, 15, 17)."""
        F = first_model(FilterSetup((False,), ((1.0, 1.0, 1.0),), latitude_deg))
        out = np.zeros((self._node.size, STATES, STATES + 2))
        out[0, :, :STATES] = np.eye(STATES)
        for k, dt in enumerate(np.diff(self.t_s)):
            refresh_model(F, self._force[k : k + 1], C[(self._node[k] + self._node[k + 1]) // 2][None])
            step = F[0, :STATES, :STATES] * dt
            out[k + 1] = out[k] + step @ (out[k] + 0.5 * (step @ out[k]))
            out[k + 1, 6:9, STATES] += self._turning[k] * dt
            out[k + 1, 3:6, STATES + 1] += self._force[k] * dt
        return out

    def at(self, t_s: Floats) -> Track:
        """Return the integration at other times."""
        track = self._track
        return Track(t_s, *(_linear(t_s, track.t_s, values) for values in (track.p, track.v, track.C)))

    def unsure(self, t_s: Floats) -> Floats:
        """Return what a motion that changes from sample to sample leaves open between them, (m, 9): that of a kink."""
        before = np.clip(np.searchsorted(self._track.t_s, t_s, side="right") - 1, 0, self._changes.shape[0] - 2)
        most = 0.25 * np.maximum(self._changes[before], self._changes[before + 1])
        return np.repeat(most, 3, axis=1)

    def between(self, at_nodes: Floats, t_s: Floats) -> Floats:
        """Return values of the nodes at other times."""
        return _linear(t_s, self.t_s, at_nodes)

    def walked(self, blocks: _Blocks, imu: ImuDensities) -> Floats:
        """Return the covariance (9 b, 9 b) that the walks of the inertial unit leave in the blocks."""
        count = _KICKS * blocks.at_s.size
        edges_s = np.linspace(self.t_s[0], self.t_s[-1], count + 1)
        kicked = np.clip(np.searchsorted(self.t_s, 0.5 * (edges_s[1:] + edges_s[:-1])), 0, self.t_s.size - 1)
        variance = np.diff(edges_s)[:, None] * np.repeat([imu.velocity_walk, imu.angle_walk], 3) ** 2
        variance = variance + np.diff(_linear(edges_s, self.t_s, self._filled), axis=0)
        inverse = np.linalg.inv(self.X[kicked][:, :, :STATES])[:, :, 3:9] * np.sqrt(variance)[:, None, :]
        rows = blocks.later(self.between(self.X[:, :_SEEN, :STATES], blocks.t_s), self.t_s[kicked])
        response = np.einsum("kbij,kjl->bikl", rows, inverse, optimize=True)
        flat = response.reshape(blocks.at_s.size * _SEEN, -1)
        return np.asarray(flat @ flat.T)


class _Blocks:
    """Times (m,) in blocks of equal length; ``number``: those (b,) that hold some."""

    def __init__(self, t_s: Floats, block: Integers) -> None:
        self.t_s = t_s
        self.number, self._first = np.unique(block, return_index=True)
        self.count = np.diff(np.append(self._first, t_s.size))
        self._length_s = float(t_s[-1] - t_s[0]) / self.number.size
        self.at_s = self.mean(t_s)

    def mean(self, values: Floats) -> Floats:
        """Return means of values (m, ...) over the blocks, (b, ...)."""
        shape = (-1, *(1,) * (values.ndim - 1))
        return np.add.reduceat(values, self._first, axis=0) / self.count.reshape(shape)

    def later(self, rows: Floats, from_s: Floats) -> Floats:
        """Return means over the blocks of rows (m, ...), zero up to each time: (k, b, ...)."""
        sums = np.concatenate((np.zeros((1, *rows.shape[1:])), np.cumsum(rows, axis=0)))
        ends = np.append(self._first[1:], self.t_s.size)
        begins = np.maximum(self._first, np.searchsorted(self.t_s, from_s)[:, None])
        begins = np.minimum(begins, ends)
        shape = (1, -1, *(1,) * (rows.ndim - 1))
        return np.asarray((sums[ends] - sums[begins]) / self.count.reshape(shape))

    def covariance(self, egi: EgiSpread) -> Floats:
        """Return what the stated errors of an EGI leave in the blocks, (9 b, 9 b)."""
        out = np.zeros((self.at_s.size, _SEEN, self.at_s.size, _SEEN))
        wander, heading = self._alike(egi.wander_s), self._alike(egi.heading_wander_s)
        for axis in range(3):
            out[:, axis, :, axis] = egi.position_m**2 * wander
            out[:, 3 + axis, :, 3 + axis] = egi.velocity_m_s**2 * wander
        for axis in (6, 7):
            out[:, axis, :, axis] = math.radians(egi.level_deg) ** 2
        out[:, 8, :, 8] = math.radians(egi.heading_deg) ** 2 * heading
        flat = out.reshape(self.at_s.size * _SEEN, -1)
        return flat + np.diag(np.tile(_FLOOR**2, self.at_s.size))

    def changes(self, egi: EgiSpread) -> Floats:
        """Return errors of single blocks beside those that wander, (9,)."""
        part = np.repeat(_FIXES * self._length_s / np.array([egi.wander_s, egi.heading_wander_s]), [6, 3])
        level = [0.0, 0.0, math.radians(egi.heading_deg)]
        return np.asarray(np.sqrt(part) * np.array([*(egi.position_m,) * 3, *(egi.velocity_m_s,) * 3, *level]))

    def _alike(self, time_s: float) -> Floats:
        """Return covariance of the means of an error of unit variance that wanders and returns, (b, b)."""
        part = self._length_s / time_s
        out = np.exp(-np.abs(self.at_s[:, None] - self.at_s) / time_s) * (math.sinh(0.5 * part) / (0.5 * part)) ** 2
        np.fill_diagonal(out, 2.0 / part * (1.0 + math.expm1(-part) / part))
        return out


def _shown(motion: Floats, variance: Floats) -> Floats:
    """Return the share of motions (n, 3) that is not their noise, (n, 1): what is made of noise fits its own errors."""
    square, doubt = np.sum(motion**2, axis=1, keepdims=True), _DOUBT * 3.0 * variance
    return np.asarray(np.maximum(0.0, 1.0 - doubt / np.maximum(square, doubt)))


def _at_nodes(between: Floats) -> Floats:
    """Return values at the nodes from those between them."""
    return np.concatenate((between[:1], 0.5 * (between[1:] + between[:-1]), between[-1:]))


def _linear(at_s: Floats, t_s: Floats, values: Floats) -> Floats:
    """Return values (n, ...) at other times by lines between them, (m, ...)."""
    before = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, t_s.size - 2)
    part = (at_s - t_s[before]) / (t_s[before + 1] - t_s[before])
    shape = (-1, *(1,) * (values.ndim - 1))
    return values[before] + part.reshape(shape) * (values[before + 1] - values[before])
