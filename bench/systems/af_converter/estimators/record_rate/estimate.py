"""What every estimator of the current of a record gives.

Source: JCGM 100:2008 section 5.1 (independent parts of a standard uncertainty add in squares).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.record_rate.pulses import PulseRecords

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RateEstimate:
    """Estimate of each record and channel, all (m, c); NaN where the estimator cannot be used.

    ``current_A``: the reading, K_N C_N - K_P C_P, corrected by the clock ratio; positive = N pulses.
    ``quantisation_A``, ``clock_A``, ``white_A``: standard uncertainties by whole pulses or frames, by the counted AF
    clock, by white noise; the random walk of the bias is none of this (see estimators.gates).
    ``start_s``, ``end_s``: what the current is averaged over, second after the first frame of the record began; the
    start is negative where the pulse before the record serves.   ``continues``: the start is the end of the same
    estimator in the record before.
    """

    current_A: Array
    quantisation_A: Array
    clock_A: Array
    white_A: Array
    start_s: Array
    end_s: Array
    continues: NDArray[np.bool_]

    @property
    def std_uncertainty_A(self) -> Array:
        """Standard uncertainty of the mean current over the interval, (m, c), ampere."""
        return np.asarray(np.sqrt(self.quantisation_A**2 + self.clock_A**2 + self.white_A**2))

    @property
    def length_s(self) -> Array:
        """Length of the interval, (m, c), second."""
        return np.asarray(self.end_s - self.start_s)

    @property
    def middle_s(self) -> Array:
        """Middle of the interval, (m, c), second after the first frame of the record began."""
        return np.asarray((self.start_s + self.end_s) / 2.0)

    @property
    def quantum_C(self) -> Array:
        """Charge of the pulse that would give a gated count this quantisation: (quantum / length)^2 / 6; (m, c)."""
        return np.asarray(self.quantisation_A * self.length_s * np.sqrt(6.0))


def on_whole_records(
    records: PulseRecords, shape: tuple[int, ...], *, continues: bool
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Start, end and ``continues`` of an estimator that takes each record from end to end, (m, c) each.

    Args:    records: m records.   shape: (m, c).   continues: neighbours share the error of their common cut.
    Returns: start_s, end_s, continues.
    Raises:  nothing.
    Source:  definition of RateEstimate.
    """
    end_s = (records.frames + records.lost) * records.frame_s
    joined = records.follows[:, None] & np.full(shape, continues)
    return np.zeros(shape), np.broadcast_to(end_s[:, None], shape).copy(), joined
