"""Three-state charge balance for the tests of the estimators, from its definition; nothing of bench or simulators.

``clock_by_clock`` steps through every edge of the AF clock. ``frames_at_once`` is the closed form for one polarity,
which test_fit_record_rate holds against the loop. Rows are trials (or channels), columns frames.
"""

from dataclasses import dataclass

import numpy as np

FRAME_s, MASTER_Hz = 0.01, 1e7
K0_C, WHITE_A_rtHz = 1.25e-6, 2e-9  # gyro channel


@dataclass(frozen=True)
class Counts:
    """Pulses of each frame, (trials, frames), and AF clocks of each frame, (trials, frames)."""

    n: np.ndarray
    p: np.ndarray
    af: np.ndarray


def clocks(trials: int, frames: int, per_frame: float, rng: np.random.Generator) -> np.ndarray:
    """AF clock edges up to each frame end, (trials, frames + 1): one clock for all, at a random phase to the frames."""
    edges = np.floor(np.arange(frames + 1) * per_frame + rng.uniform()).astype(np.int64)
    return np.broadcast_to(edges, (trials, frames + 1))


def clock_by_clock(current_A, edges, residue_C, *, q_n_C, q_p_C, clock_s, threshold_C) -> Counts:
    """Every edge: add the charge of a clock; above the threshold an N pulse, below minus the threshold a P pulse.

    current_A (trials, frames) holds within a frame; edges as from ``clocks``; residue_C (trials,).
    """
    trials, frames = current_A.shape
    charge, n, p = residue_C.copy(), np.zeros((trials, frames), int), np.zeros((trials, frames), int)
    af = np.diff(edges, axis=1)
    for frame in range(frames):
        step = current_A[:, frame] * clock_s
        for clock in range(int(af[:, frame].max())):
            charge = charge + np.where(clock < af[:, frame], step, 0.0)
            up, down = charge > threshold_C, charge < -threshold_C
            charge = charge - q_n_C * up + q_p_C * down
            n[:, frame] += up
            p[:, frame] += down
    return Counts(n, p, af)


def frames_at_once(current_A, edges, residue_C, *, q_n_C, clock_s, threshold_C) -> Counts:
    """N pulses alone: their number is what it takes to bring the highest charge so far below the threshold."""
    af = np.diff(edges, axis=1)
    charge = residue_C[:, None] + np.cumsum(current_A * clock_s * af, axis=1)
    highest = np.maximum.accumulate(charge, axis=1)
    total = np.maximum(np.ceil((highest - threshold_C) / q_n_C), 0).astype(np.int64)
    n = np.diff(total, axis=1, prepend=0)
    return Counts(n, np.zeros_like(n), af)


def white(shape, rng, density_A_rtHz=WHITE_A_rtHz) -> np.ndarray:
    """Frame means of white noise with a one-sided density."""
    return rng.standard_normal(shape) * density_A_rtHz / np.sqrt(2.0 * FRAME_s)


def steady(current_A, trials, frames, rng, *, noise=True, clock_Hz=256_000.0, clock_error=20e-6, k0_C=K0_C) -> Counts:
    """Records of a steady positive current, (trials, frames), that began long ago: any phase of the integrator.

    The charge of a pulse is that of one AF clock period, so a fast clock makes smaller pulses.
    """
    clock_s = 1.0 / (clock_Hz * (1.0 + clock_error))
    edges = clocks(trials, frames, FRAME_s / clock_s, rng)
    q_C = k0_C / (1.0 + clock_error)
    current = np.broadcast_to(np.asarray(current_A, dtype=float), (trials, frames))
    if noise:
        current = current + white(current.shape, rng)
    return frames_at_once(current, edges, rng.uniform(0.0, q_C, trials), q_n_C=q_C, clock_s=clock_s, threshold_C=q_C)


def cut(counts: Counts, frames: int, first_counter: int = 1000):
    """Windows, sums and timing of contiguous records of ``frames``, one channel per trial, by literal loops."""
    windows, sums, timing = [], [], []
    for start in range(0, counts.n.shape[1], frames):
        part = slice(start, start + frames)
        first = first_counter + start
        windows.append((first, frames, 0))
        sums.append({
            "npp": counts.n[:, part].sum(axis=1), "ppp": counts.p[:, part].sum(axis=1),
            "af_clock": counts.af[0, part].sum(), "master_count": round(frames * FRAME_s * MASTER_Hz),
        })  # fmt: skip
        timing.append({**_timing("npp", counts.n[:, part], first), **_timing("ppp", counts.p[:, part], first)})
    return windows, sums, timing


def _timing(name: str, x: np.ndarray, first: int) -> dict[str, np.ndarray]:
    j = np.arange(1, x.shape[1] + 1)
    places = [np.flatnonzero(row) for row in x]
    ends = [(place[0], place[-1]) if place.size else (-1, -1) for place in places]
    return {
        f"{name}.moment1": x @ j,
        f"{name}.moment2": x @ j**2,
        f"{name}.first": np.array([first + a if a >= 0 else -1 for a, _ in ends]),
        f"{name}.last": np.array([first + b if b >= 0 else -1 for _, b in ends]),
        f"{name}.at_first": np.array([row[a] if a >= 0 else 0 for row, (a, _) in zip(x, ends, strict=True)]),
        f"{name}.at_last": np.array([row[b] if b >= 0 else 0 for row, (_, b) in zip(x, ends, strict=True)]),
    }
