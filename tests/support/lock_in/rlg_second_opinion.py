"""A dithered ring laser by Picard iteration, half a dither period after the other: another way than the simulator's.

The slow part x of the phase, psi = K theta(t) + x, obeys x(t) = x0 + B(t) - K W_L int sin(psi + beta) dt; each round
of the iteration takes the error down by the size of a lock-in error, 0.03 to 0.1. B is the quantum noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OMEGA = 2.0 * np.pi * 400.0
HALF_S = np.pi / OMEGA
_POINTS, _ROUNDS, _SETTLED = 3001, 9, 1e-9


@dataclass(frozen=True)
class Gyro:
    """What the compensators must find out: rates in rad/s, phases in rad."""

    path_m: float = 0.28
    beta: float = np.pi / 2.0
    beta_drift_rad_s: float = 0.0
    second_harmonic: float = 0.0  # of the backscatter, as a share of the first
    quantum_deg_rth: float = 0.0
    beat_noise_rad: float = 0.0
    dither_scatter: float = 0.05

    @property
    def gain(self) -> float:
        """Rad of phase in a rad of rotation."""
        return float(np.pi * self.path_m / (2.0 * 632.8e-9))

    @property
    def lock_in(self) -> float:
        """Lock-in rate, rad/s."""
        return float(np.deg2rad(0.05) * (0.28 / self.path_m) ** 2)

    @property
    def kappa(self) -> float:
        """Lock-in rate in phase, rad/s."""
        return self.gain * self.lock_in


@dataclass(frozen=True)
class Beat:
    """Crossings (time, level of the sine, level of the cosine), pick-off edges, and the truth of each half period."""

    time_s: Array
    rising: NDArray[np.bool_]
    cosine: NDArray[np.bool_]
    level: NDArray[np.int64]
    pickoff_s: Array
    pickoff_rising: NDArray[np.bool_]
    jump_rad: Array  # what lock-in added from pick-off to pick-off
    turning_rad: Array  # phase at the turnaround


def simulate(gyro: Gyro, seconds: float, seed: int) -> Beat:
    """Beat of ``seconds``, beginning at a rising zero of the dither angle."""
    rng = np.random.default_rng(seed)
    count = round(seconds / HALF_S)
    step = HALF_S / (_POINTS - 1)
    clock = np.linspace(0.0, HALF_S, _POINTS)
    jitter = np.deg2rad(gyro.quantum_deg_rth / 60.0) * gyro.gain * np.sqrt(step)
    x, sign, edges, jump, turning = rng.uniform(0.0, 2.0 * np.pi), 1.0, [], np.empty(count), np.empty(count)
    for j in range(count):
        swing = sign * np.deg2rad(100.0) * (1.0 + gyro.dither_scatter * rng.standard_normal()) * gyro.gain / OMEGA
        beta = gyro.beta + gyro.beta_drift_rad_s * (j + 0.5) * HALF_S
        noise = np.zeros(_POINTS)
        if jitter:
            noise[1:] = np.cumsum(jitter * rng.standard_normal(_POINTS - 1))
        smooth, pull = _slow(gyro, swing * np.sin(OMEGA * clock) + noise + x, beta, step)
        edges.append(_crossings(clock + j * HALF_S, swing, x + smooth, -pull, noise))
        jump[j], turning[j] = smooth[-1], swing + x + smooth[_POINTS // 2] + noise[_POINTS // 2]
        x, sign = x + smooth[-1] + noise[-1], -sign
    time, level, upward, rate = (np.concatenate(column) for column in zip(*edges, strict=True))
    if gyro.beat_noise_rad:  # moves each edge by its phase over the rate there, and sometimes past its neighbour
        time = time + gyro.beat_noise_rad * rng.standard_normal(time.size) / np.maximum(np.abs(rate), 1e4)
        order = np.argsort(time, kind="stable")
        time, level, upward = time[order], level[order], upward[order]
    even = level % 2 == 0
    return Beat(
        time, upward == even, even, level, HALF_S * np.arange(count + 1), np.arange(count + 1) % 2 == 0, jump, turning
    )


def _slow(gyro: Gyro, phase: Array, beta: float, step: float) -> tuple[Array, Array]:
    """What lock-in adds to a phase, and its rate with the sign turned round."""
    smooth = np.zeros(_POINTS)
    for _ in range(_ROUNDS):
        psi = phase + smooth
        pull = gyro.kappa * np.sin(psi + beta)
        if gyro.second_harmonic:
            pull += gyro.kappa * gyro.second_harmonic * np.sin(2.0 * psi + 0.4)
        panel = np.empty(_POINTS - 1)
        panel[1:-1] = (13.0 * (pull[1:-2] + pull[2:-1]) - pull[:-3] - pull[3:]) / 24.0
        panel[0] = (5.0 * pull[0] + 8.0 * pull[1] - pull[2]) / 12.0
        panel[-1] = (5.0 * pull[-1] + 8.0 * pull[-2] - pull[-3]) / 12.0
        before, smooth[1:] = smooth[-1], -step * np.cumsum(panel)
        if abs(smooth[-1] - before) < _SETTLED:
            break
    return smooth, pull


def _crossings(clock: Array, swing: float, slow: Array, slope: Array, noise: Array) -> tuple[Array, ...]:
    """Times and levels where the phase crosses n pi, by Newton's method on the exact swing and a cubic slow part."""
    start, step = clock[0], clock[1] - clock[0]
    psi = swing * np.sin(OMEGA * (clock - start)) + slow + noise
    cell = np.floor(psi / np.pi).astype(np.int64)
    at = np.flatnonzero(np.diff(cell))
    upward = cell[at + 1] > cell[at]
    level = np.maximum(cell[at], cell[at + 1])
    part = (level * np.pi - psi[at]) / (psi[at + 1] - psi[at])
    cubic = [slow[at], step * slope[at], slow[at + 1], step * slope[at + 1]]
    for _ in range(6):
        s2, s3 = part * part, part**3
        value = (2 * s3 - 3 * s2 + 1) * cubic[0] + (s3 - 2 * s2 + part) * cubic[1]
        value += (3 * s2 - 2 * s3) * cubic[2] + (s3 - s2) * cubic[3]
        turn = OMEGA * (clock[at] - start + part * step)
        found = swing * np.sin(turn) + value + noise[at] + part * (noise[at + 1] - noise[at]) - level * np.pi
        rate = swing * OMEGA * step * np.cos(turn) + (psi[at + 1] - psi[at]) * 1e-12
        part = np.clip(part - found / rate, 0.0, 1.0)
    return clock[at] + part * step, level, upward, rate / step


def ticks(time_s: Array, clock_Hz: float) -> NDArray[np.int64]:
    """Time stamps of a tagger."""
    return np.floor(time_s * clock_Hz).astype(np.int64)
