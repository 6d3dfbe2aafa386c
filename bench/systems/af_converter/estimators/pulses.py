"""Pulses of records as arrays: counts of each polarity and, where the frames were timed, when they came.

Source: AF-converter paper section 2 (pulses of separate polarities, counted in frames).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from bench.maths.arrays import Flags, Floats, Integers
from bench.systems.af_converter.estimators.readings import clock_ratio, count_noise

TIMING = ("moment1", "moment2", "first", "last", "at_first", "at_last")


@dataclass(frozen=True)
class Pulses:
    """Pulses of one polarity; all (m, c) for m records and c channels, x_j the count of frame j = 1 ... n.

    ``moment1`` = sum of j x_j, ``moment2`` = sum of j^2 x_j; ``first``, ``last``: unwrapped counters of the first and
    last frame with a pulse (-1: none), ``at_first``, ``at_last``: pulses in them. Meaningless where not timed.
    """

    count: Integers
    moment1: Integers
    moment2: Integers
    first: Integers
    last: Integers
    at_first: Integers
    at_last: Integers


@dataclass(frozen=True)
class PulseRecords:
    """m records in order of time, (m,) unless said otherwise.

    ``frames``: good frames; ``lost``: missing or unusable ones; ``gate_s``: nominal gate of the good frames;
    ``timed`` (bool): the record has timing, so no frame is missing; ``n``, ``p``: pulses of each polarity.
    """

    first_counter: Integers
    frames: Integers
    lost: Integers
    gate_s: Floats
    af_count: Floats
    timed: Flags
    n: Pulses
    p: Pulses

    @property
    def frame_s(self) -> Floats:
        """Nominal length of a frame, (m,), second; NaN without a gate."""
        return np.where(self.gate_s > 0, self.gate_s, np.nan) / np.maximum(self.frames, 1)

    @property
    def follows(self) -> Flags:
        """True where a record begins with the frame right after the record before it, both without a gap; (m,).

        A record that lost frames does not reach the next one: its good frames are fewer than its counters.
        """
        joined = np.zeros(self.frames.size, dtype=np.bool_)
        stop = self.first_counter + self.frames
        joined[1:] = (self.first_counter[1:] == stop[:-1]) & (self.lost[1:] == 0)
        return joined


@dataclass(frozen=True)
class PulseConverters:
    """Declared constants of c channels: charge of a pulse of each polarity and white noise, (c,) or one for all.

    ``white_A_rtHz``: one-sided density. With a scale-factor error d known, k = k0 (1 + d).
    """

    k_n_C: ArrayLike
    k_p_C: ArrayLike
    white_A_rtHz: ArrayLike
    af_clock_Hz: float

    def ratio(self, records: PulseRecords) -> Floats:
        """Clock ratio r of each record, (m, 1), which turns counted rates into current; NaN without AF clock."""
        return clock_ratio(records.af_count, records.gate_s, self.af_clock_Hz)[:, None]

    def ratio_std(self, records: PulseRecords) -> Floats:
        """Relative standard uncertainty of the clock ratio of each record, (m, 1)."""
        return count_noise(records.af_count)[:, None]


def stack_records(
    windows: Sequence[tuple[int, int, int]],
    sums: Sequence[Mapping[str, Any]],
    timing: Sequence[Mapping[str, Any]],
    master_Hz: float,
) -> PulseRecords:
    """Arrays from the records of a session, in order of time.

    Args:    windows: per record the unwrapped counter of its first frame, its good frames, its lost frames.
             sums: per record "npp", "ppp" (c,), "af_clock", "master_count" () over the good frames.
             timing: per record "npp.moment1" ... "ppp.at_last" (c,), empty where there is none.
             master_Hz: nominal master clock, which makes the gate of the master count.
    Returns: PulseRecords of m records and c channels.
    Raises:  nothing.
    Source:  AF-converter paper equation (1): the gate is counted in pulses of the master clock.
    """
    first, frames, lost = np.array(windows, dtype=np.int64).reshape(-1, 3).T
    return PulseRecords(
        first_counter=first,
        frames=frames,
        lost=lost,
        gate_s=np.array([int(record["master_count"]) for record in sums]) / master_Hz,
        af_count=np.array([int(record["af_clock"]) for record in sums], dtype=np.float64),
        timed=np.array([bool(record) for record in timing]) & (lost == 0),
        n=_pulses("npp", sums, timing),
        p=_pulses("ppp", sums, timing),
    )


def _pulses(name: str, sums: Sequence[Mapping[str, Any]], timing: Sequence[Mapping[str, Any]]) -> Pulses:
    count = np.array([record[name] for record in sums], dtype=np.int64)
    empty = np.full(count.shape[1:], -1, dtype=np.int64)
    columns = {
        key: np.array([record.get(f"{name}.{key}", empty) for record in timing], dtype=np.int64) for key in TIMING
    }
    return Pulses(count, **columns)


def count_step(counts: Floats, apart: float = np.inf) -> tuple[int, float]:
    """Return the largest step of which counts are multiples, apart from a remainder that all share.

    Where points are missing, the few counts that are left may go in steps of the levels of the stimulus: that is no
    step of the counter.

    Args:    counts: of gates that differ, (m,); zeros and counts that occur twice say nothing.
             apart: pulses between neighbouring levels.
    Returns: the step, 1 for single pulses, and the probability of one as large by chance.
    Source:  d whole numbers are all multiples of k with probability k^-d; sum over all k from the step on.
    """
    differences = np.diff(np.unique(counts[counts > 0])).astype(np.int64)
    if differences.size < 2:  # one alone is a multiple of itself
        return 1, 1.0
    step = int(np.gcd.reduce(differences))
    if 2 * step > apart:
        return 1, 1.0
    return step, 1.0 if step == 1 else min(1.0, float(special.zeta(differences.size, step)))
