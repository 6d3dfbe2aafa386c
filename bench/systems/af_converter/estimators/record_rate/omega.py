"""Slope of the cumulative count of a record: every frame counts, those in the middle most.

Source: least-squares line through the cumulative counts (the omega counter of frequency metrology); formulas below.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.record_rate.estimate import RateEstimate, on_whole_records
from bench.systems.af_converter.estimators.record_rate.pulses import PulseConverters, PulseRecords, Pulses

Array = NDArray[np.float64]
_HARMONICS = 64  # of the saw-tooth of the integrator; the locked error by the last one is under 1 % of a pulse
_PEAK = 0.2181  # largest value of (sin x - x cos x) / (2 x^2)
_UNSURE = 1.0  # by how much the pulses of a record may be off while the saw-tooth is locked to the frames
_LEAST_PULSES = 2


def omega(records: PulseRecords, converters: PulseConverters) -> RateEstimate:
    """Current from the least-squares slope of the cumulative count Y_k at the ends k = 0 ... n of the frames.

    slope = sum of w_j x_j with w_j = 6 j (n + 1 - j) / (n (n + 1) (n + 2)), so from the moments alone. White noise:
    w^2 / (2 t) times n sum w_j^2 = 6/5 (1 + ...). Quantisation: the integrator's saw-tooth, seen once a frame, is a
    line spectrum of q / (pi m) at the multiples m of the pulse rate f per frame; the slope takes from each what its
    weights let through: (q / t)^2 72 / pi^2 sum of g^2 / m^2, g = (sin x - x cos x) / (2 x^2), x = n sin(pi m f).
    The envelope of g is used, because f is not known to a fraction of 1 / n where it matters: near a rate locked to
    the frames. The same saw-tooth with I / f_AF in place of q comes from the AF clock, whose edges the pulses wait for.

    Args:    records: m records of c channels.   converters: their constants.
    Returns: RateEstimate; NaN where the record is not timed, has fewer than two pulses, or pulses of both polarities.
    Raises:  nothing.
    Source:  E. Rubiola, On the measurement of frequency and of its sample variance with high-resolution counters,
             Rev. Sci. Instrum. 76 (2005) 054703 (weights); Fourier series of the Bernoulli polynomial B_2 (spectrum).
    """
    n, p = records.n.count, records.p.count
    usable = records.timed[:, None] & ((n > 0) != (p > 0)) & (n + p >= _LEAST_PULSES)
    gate_s = np.where(usable, np.where(records.gate_s > 0, records.gate_s, np.nan)[:, None], np.nan)
    frames = records.frames[:, None].astype(np.float64)
    net_C = np.asarray(converters.k_n_C) * slope(records.n, records.frames)
    net_C = net_C - np.asarray(converters.k_p_C) * slope(records.p, records.frames)
    current_A = converters.ratio(records) * net_C * frames / gate_s
    quantum_C = np.where(n > 0, converters.k_n_C, converters.k_p_C)
    rate = np.where(usable, np.abs(net_C) / quantum_C, 0.0)
    per_clock_C = np.abs(current_A) / converters.af_clock_Hz
    locked = quantum_C * _leak(rate, frames)
    edges = per_clock_C * _leak(records.af_count[:, None] / frames, frames)
    start_s, end_s, continues = on_whole_records(records, n.shape, continues=False)
    widened = 1.2 * ((frames + 1.0) ** 2 + 1.0) / ((frames + 1.0) * (frames + 2.0))
    return RateEstimate(
        current_A=current_A,
        quantisation_A=np.hypot(locked, edges) / gate_s,
        clock_A=np.abs(current_A) * converters.ratio_std(records),
        white_A=np.asarray(converters.white_A_rtHz) * np.sqrt(widened / (2.0 * gate_s)),
        start_s=start_s,
        end_s=end_s,
        continues=continues,
    )


def slope(pulses: Pulses, frames: NDArray[np.int64]) -> Array:
    """Least-squares slope of the cumulative count, (m, c), pulses per frame, from exact integers.

    Args:    pulses: one polarity.   frames: n of each record, (m,).
    Returns: 6 ((n + 1) moment1 - moment2) / (n (n + 1) (n + 2)).
    Raises:  nothing.
    Source:  sum over k of (k - n/2) Y_k over sum of (k - n/2)^2, the sums exchanged.
    """
    n = frames[:, None]
    below = np.maximum(n, 1).astype(np.float64)
    weighted = (n + 1) * pulses.moment1 - pulses.moment2
    return np.asarray(6.0 * weighted / (below * (below + 1.0) * (below + 2.0)))


def _leak(rate: Array, frames: Array) -> Array:
    """Standard deviation of the slope by a saw-tooth of height 1 and ``rate`` teeth a frame, times the frames."""
    order = np.arange(1.0, _HARMONICS + 1.0)
    turns = np.remainder(order * rate[..., None], 1.0)
    distance = np.maximum(np.minimum(turns, 1.0 - turns) - _UNSURE / frames[..., None], 0.0)
    x = frames[..., None] * np.sin(np.pi * distance)
    with np.errstate(divide="ignore"):
        envelope = np.minimum(np.sqrt(1.0 + x**2) / (2.0 * x**2), _PEAK)
    return np.asarray(np.sqrt(72.0 / np.pi**2 * np.sum((envelope / order) ** 2, axis=-1)))
