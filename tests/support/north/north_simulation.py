"""A second simulation of the earth signal and of two lock-ins: what the estimators of north are held against; and north
by one lock-in alone, for comparison with the methods that use both.

Four windows of five turns, one behind the other; before each the index moves on by 90 degrees. Paper's noise: two white
noises of variance 1/4 in each sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from bench.systems.north.estimators import phasors
from bench.systems.north.estimators.formulas import literal_north, propagated, quadrant_north
from bench.systems.north.estimators.likelihood import likelihood_north
from bench.systems.north.estimators.phasors import DOF, North, angle_deg, eight, lock_in_phasors, wrapped_deg

SIGMA_V = 0.5**0.5
TURNS = 20
KINDS = ("constant", "slow", "step", "linear", "white", "double")


def single_north(u1: ArrayLike, u2: ArrayLike, *, f2_deg: float = 0.0) -> North:
    """Phase by (17) with atan2: lock-in 1 alone, as a scheme with one lock-in has it.

    Args:    u1, u2: oriented samples, (..., 4); lock-in 2 only for the noise.   f2_deg: placement of its index pulse.
    Returns: North.
    Raises:  FitError B-FIT-110 for another shape.
    Source:  FOG paper (002) equation (17).
    """
    first, second = eight(u1, u2)
    phasor = np.asarray(lock_in_phasors(first, second)[0] * np.exp(-1j * np.deg2rad(f2_deg)))
    noise, std_deg = propagated(lambda a, b: lock_in_phasors(a, b)[0], first, second)
    return North("single", angle_deg(phasor), std_deg, DOF, phasor, noise, first.mean(-1), second.mean(-1))


def wander(kind: str, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Relative change of a parameter over the run, within 20 %."""
    if kind == "slow":
        return 0.2 * np.sin(2 * np.pi * (rng.uniform(0.02, 0.1) * t + rng.uniform()))
    if kind == "step":
        return rng.uniform(-0.2, 0.2, TURNS)[np.floor(t).astype(int)]
    if kind == "linear":
        return -0.2 + 0.4 * t / TURNS
    if kind == "white":
        return rng.uniform(-0.2, 0.2, t.size)
    if kind == "double":
        return 0.2 * np.sin(2 * np.pi * (2 * t + rng.uniform()))
    return np.zeros(t.size)


def turned(kind: str, fs: int, rng: np.random.Generator) -> np.ndarray:
    """Encoder angle in radian, (n,): steady rotation, its swing of 0.05 degrees at 60 Hz, the index of each window."""
    t = mid_samples_s(fs)
    swing, frequency = (wander(kind if kind != "double" else "constant", t, rng) for _ in range(2))
    phase = 2 * np.pi * np.cumsum(60.0 * (1.0 + frequency)) / fs
    index = np.repeat(np.arange(4), t.size // 4) * np.pi / 2
    return 2 * np.pi * t + np.deg2rad(0.05) * (1.0 + swing) * np.sin(phase) + index


@cache
def mid_samples_s(fs: int) -> np.ndarray:
    return (np.arange(TURNS * fs) + 0.5) / fs


@cache
def square_references(fs: int) -> tuple[np.ndarray, np.ndarray]:
    t = mid_samples_s(fs)
    return np.sign(np.cos(2 * np.pi * t)), np.sign(np.sin(2 * np.pi * t))


def lock_ins(u: np.ndarray, fs: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (..., 4) of lock-in 1 and 2 against a square reference."""
    first, second = ((u * one).reshape(*u.shape[:-1], 4, -1).mean(-1) for one in square_references(fs))
    return first, second


def runs(
    kind: str, count: int, *, fs: int = 1000, noise: float = SIGMA_V, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """True phase (r,), raw samples (r, n) and encoder angle (n,) in degrees; azimuths spread evenly over the circle."""
    rng = np.random.default_rng(seed)
    phi_deg = -180.0 + 360.0 * np.arange(count) / count
    for some in np.array_split(phi_deg, -(-count // 50) if kind == "constant" else count):
        theta, gain = turned(kind, fs, rng), 1.0 + wander(kind, mid_samples_s(fs), rng)
        angle = np.deg2rad(some)[:, None]
        signal = gain * (np.cos(angle) * np.sin(theta) + np.sin(angle) * np.cos(theta))
        yield some, signal + noise * rng.standard_normal(signal.shape), np.rad2deg(theta)


def errors_deg(
    kind: str, count: int, *, fs: int = 1000, noise: float = SIGMA_V, seed: int = 0
) -> dict[str, np.ndarray]:
    """Errors of every method, never modulo 180 but in "literal, half turns removed"."""
    found: dict[str, list[np.ndarray]] = {}
    for phi_deg, u, theta_deg in runs(kind, count, fs=fs, noise=noise, seed=seed):
        eight = lock_ins(u, fs)
        each = {
            "literal": literal_north(*eight).north,
            "quadrant": quadrant_north(*eight),
            "single": single_north(*eight),
            "least_squares": phasors.eight_sample_north(*eight),
            "likelihood": likelihood_north(u, theta_deg),
        }
        for name, one in each.items():
            found.setdefault(name, []).append(wrapped_deg(one.phi_deg - phi_deg))
    errors = {name: np.concatenate(some) for name, some in found.items()}
    return errors | {"literal, half turns removed": wrapped_deg(2 * errors["literal"]) / 2}


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def table(count: int, fs: int, seed: int, say: Callable[[str], None]) -> dict[str, dict[str, float]]:
    """RMS error in degrees of every method and kind of parameters."""
    found = {
        kind: {name: rms(one) for name, one in errors_deg(kind, count, fs=fs, seed=seed).items()} for kind in KINDS
    }
    for kind, row in found.items():
        say(f"{kind}: " + ", ".join(f"{name} {value:.3f}" for name, value in row.items()))
    return found
