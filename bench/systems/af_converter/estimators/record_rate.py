"""Current of each record by the best of three estimators: gated count, slope of the cumulative count, reciprocal.

The gated count takes pulses over gate, as the paper does. In the slope of the cumulative count (the omega counter of
frequency metrology) every frame counts, those in the middle most. Reciprocal counting takes whole pulses over the time
between the first and the last of them, with the frames as its clock.
Source: AF-converter paper equations (1), (2); JCGM 100:2008 section 5.1 (independent parts of a standard uncertainty
add in squares); formulas below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.maths.arrays import Flags, Floats, Integers
from bench.systems.af_converter.estimators.readings import PulseConverters, PulseRecords, Pulses

_UNSETTLED_PULSES = np.sqrt(6.0)  # u = one pulse in the gate: half of the largest error, see gated
_SETTLED_PULSES = 2
_HARMONICS = 64  # of the saw-tooth of the integrator; the locked error by the last one is under 1 % of a pulse
_PEAK = 0.2181  # largest value of (sin x - x cos x) / (2 x^2)
_UNSURE = 1.0  # by how much the pulses of a record may be off while the saw-tooth is locked to the frames
_LEAST_PULSES = 2
GATED, OMEGA, RECIPROCAL = "gated", "omega", "reciprocal"


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

    current_A: Floats
    quantisation_A: Floats
    clock_A: Floats
    white_A: Floats
    start_s: Floats
    end_s: Floats
    continues: Flags

    @property
    def std_uncertainty_A(self) -> Floats:
        """Standard uncertainty of the mean current over the interval, (m, c), ampere."""
        return np.sqrt(self.quantisation_A**2 + self.clock_A**2 + self.white_A**2)

    @property
    def length_s(self) -> Floats:
        """Length of the interval, (m, c), second."""
        return self.end_s - self.start_s

    @property
    def quantum_C(self) -> Floats:
        """Charge of the pulse that would give a gated count this quantisation: (quantum / length)^2 / 6; (m, c)."""
        return np.asarray(self.quantisation_A * self.length_s * np.sqrt(6.0))


def on_whole_records(records: PulseRecords, shape: tuple[int, ...], *, continues: bool) -> tuple[Floats, Floats, Flags]:
    """Start, end and ``continues`` of an estimator that takes each record from end to end, (m, c) each.

    Args:    records: m records.   shape: (m, c).   continues: neighbours share the error of their common cut.
    Returns: start_s, end_s, continues.
    Raises:  nothing.
    Source:  definition of RateEstimate.
    """
    end_s = (records.frames + records.lost) * records.frame_s
    joined = records.follows[:, None] & np.full(shape, continues)
    return np.zeros(shape), np.broadcast_to(end_s[:, None], shape).copy(), joined


def gated(records: PulseRecords, converters: PulseConverters) -> RateEstimate:
    """Return current from the pulses counted in the gate.

    The integrator holds a part of a pulse at each end. While one polarity pulses that part is uniform over one pulse,
    so u = q / (t sqrt(6)), on average over all rates: at a given rate the error takes two values one pulse apart, and
    a 95 % interval holds 80 % to 100 % of them. A record with both polarities or fewer than two pulses may begin and
    end anywhere between the thresholds, which are two pulses apart: u = q / t, half of the largest error. Each lost
    frame cuts the count once more. The counted AF clock brings no error of its own: whole clocks are what pulses wait
    for.

    Args:    records: m records of c channels.   converters: their constants.
    Returns: RateEstimate; NaN without a gate or an AF clock.
    Raises:  nothing.
    Source:  AF-converter paper equation (1); docs/method-af-converter.md (quantisation); JCGM 100:2008 4.3.7.
    """
    gate_s = np.where(records.gate_s > 0, records.gate_s, np.nan)[:, None]
    n, p = records.n.count, records.p.count
    quantum_C = np.where(n > 0, converters.k_n_C, converters.k_p_C)
    largest_C = _UNSETTLED_PULSES * np.maximum(converters.k_n_C, converters.k_p_C)
    quantum_C = np.where(((n == 0) | (p == 0)) & (n + p >= _SETTLED_PULSES), quantum_C, largest_C)
    ratio = converters.ratio(records)
    current_A = ratio / gate_s * (np.asarray(converters.k_n_C) * n - np.asarray(converters.k_p_C) * p)
    start_s, end_s, continues = on_whole_records(records, n.shape, continues=True)
    known = np.where(np.isfinite(current_A), 1.0, np.nan)
    return RateEstimate(
        current_A=current_A,
        quantisation_A=quantum_C / gate_s * np.sqrt((1.0 + records.lost[:, None]) / 6.0),
        clock_A=0.0 * known,
        white_A=known * np.asarray(converters.white_A_rtHz) / np.sqrt(2.0 * gate_s),
        start_s=start_s,
        end_s=end_s,
        continues=continues,
    )


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


def slope(pulses: Pulses, frames: Integers) -> Floats:
    """Least-squares slope of the cumulative count, (m, c), pulses per frame, from exact integers.

    Args:    pulses: one polarity.   frames: n of each record, (m,).
    Returns: 6 ((n + 1) moment1 - moment2) / (n (n + 1) (n + 2)).
    Raises:  nothing.
    Source:  sum over k of (k - n/2) Y_k over sum of (k - n/2)^2, the sums exchanged.
    """
    n = frames[:, None]
    below = np.maximum(n, 1).astype(np.float64)
    weighted = (n + 1) * pulses.moment1 - pulses.moment2
    return 6.0 * weighted / (below * (below + 1.0) * (below + 2.0))


def _leak(rate: Floats, frames: Floats) -> Floats:
    """Standard deviation of the slope by a saw-tooth of height 1 and ``rate`` teeth a frame, times the frames."""
    order = np.arange(1.0, _HARMONICS + 1.0)
    turns = np.remainder(order * rate[..., None], 1.0)
    distance = np.maximum(np.minimum(turns, 1.0 - turns) - _UNSURE / frames[..., None], 0.0)
    x = frames[..., None] * np.sin(np.pi * distance)
    with np.errstate(divide="ignore"):
        envelope = np.minimum(np.sqrt(1.0 + x**2) / (2.0 * x**2), _PEAK)
    return np.asarray(np.sqrt(72.0 / np.pi**2 * np.sum((envelope / order) ** 2, axis=-1)))


def reciprocal(records: PulseRecords, converters: PulseConverters) -> RateEstimate:
    """Return current from the charge of whole pulses over the time they took.

    The first pulse is the last one of the record before, if that one follows without a gap and the polarity is the
    same; otherwise the first of the record, so two are needed. It is never of the other polarity: the integrator
    first crosses both thresholds then. A pulse is taken to the middle of its frame, so both frames must hold one pulse
    only; the time is off by a frame at most, and by the rate alone if pulses and frames are locked: u = I frame / (2
    length), the worst case (over all rates it is 1 / sqrt(6)). White noise is averaged over the time between the
    pulses: white / sqrt(2 length).

    Args:    records: m records of c channels, in order of time.   converters: their constants.
    Returns: RateEstimate over the interval between the two pulses; NaN where there are no two such pulses.
    Raises:  nothing.
    Source:  variance d (1 - d) <= 1/4 of a difference of two counts of whole frames, d the fraction of a frame.
    """
    positive = _one_polarity(records, records.n, records.p, converters.k_n_C)
    negative = _one_polarity(records, records.p, records.n, converters.k_p_C)
    longer = np.nan_to_num(negative[1] - negative[0]) > np.nan_to_num(positive[1] - positive[0])
    first, last, charge_C, continues = (np.where(longer, b, a) for a, b in zip(positive, negative, strict=True))
    continues[1:] &= last[:-1] == first[1:]
    frame_s = records.frame_s[:, None]
    length_s = (last - first) * frame_s
    current_A = converters.ratio(records) * np.where(longer, -1.0, 1.0) * charge_C / length_s
    begin = records.first_counter[:, None] - 0.5  # the middle of a frame is half a frame after its beginning
    return RateEstimate(
        current_A=current_A,
        quantisation_A=np.abs(current_A) * frame_s / (2.0 * length_s),
        clock_A=np.abs(current_A) * converters.ratio_std(records),
        white_A=np.asarray(converters.white_A_rtHz) / np.sqrt(2.0 * length_s),
        start_s=(first - begin) * frame_s,
        end_s=(last - begin) * frame_s,
        continues=continues,
    )


def _one_polarity(
    records: PulseRecords, own: Pulses, other: Pulses, k_C: ArrayLike
) -> tuple[Floats, Floats, Floats, Flags]:
    """First and last counter (NaN: not usable), charge between them, and whether the first is of the record before.

    The pulse before the record serves only if it was the last of either polarity there, and none of the other
    polarity comes before the last own one here.
    """
    timed = np.broadcast_to(records.timed[:, None], own.count.shape)
    before = np.full_like(own.last, -1)
    handed_on = timed & (own.last > other.last) & (own.at_last == 1)
    before[1:] = np.where(handed_on[:-1] & records.follows[1:, None], own.last[:-1], -1)
    ends = timed & (own.count > 0) & (own.at_last == 1)
    later = (other.count == 0) | (other.first > own.last)
    earlier = (other.count > 0) & (other.last < own.first)
    from_before: Flags = ends & later & (before >= 0)
    inside = ends & (later | earlier) & (own.count > 1) & (own.at_first == 1) & ~from_before
    absent: Floats = np.where(from_before | inside, 0.0, np.nan)
    first = np.where(from_before, before, own.first) + absent
    pulses = np.where(from_before, own.count, own.count - 1) + absent
    return first, own.last + absent, pulses * np.asarray(k_C, dtype=np.float64), from_before


_ESTIMATORS = {GATED: gated, OMEGA: omega, RECIPROCAL: reciprocal}


@dataclass(frozen=True)
class RecordRates(RateEstimate):
    """Best estimate of each record and channel, (m, c); ``estimator`` names it ("gated", "omega", "reciprocal").

    ``joined``: the interval begins with the very cut that ended the one before, so that their quantisation errors
    telescope. For one channel ``gates.series_covariance`` takes the columns ``estimator``, ``length_s``, ``quantum_C``
    and ``joined`` beside the middles of the intervals; times there are those of the records plus these.
    """

    estimator: NDArray[np.str_]
    joined: Flags


def record_rates(records: PulseRecords, converters: PulseConverters, only: str | None = None) -> RecordRates:
    """Net current of every record and channel by the estimator with the smallest stated uncertainty.

    On a gyro channel that is the reciprocal below 1.2 pulses per second and the slope of the cumulative count above,
    or the reciprocal again where the pulses are all but locked to the frames. The gated count is taken only where
    neither can be: frames lost, no timing, fewer than two pulses to go by, or current that crosses zero.

    Args:    records: m records of c channels in order of time.   converters: their constants.
             only: name of one estimator to use throughout, NaN where it cannot be used; None: the best.
    Returns: RecordRates; current_A is the reading K_N C_N - K_P C_P, the bias i_AFbias is its negative; NaN where a
             record has no gate or no AF clock.
    Raises:  nothing.
    Source:  AF-converter paper equation (1); variances as each estimator states them.
    """
    names = list(_ESTIMATORS) if only is None else [only]
    estimates = [_ESTIMATORS[name](records, converters) for name in names]
    std = np.stack([estimate.std_uncertainty_A for estimate in estimates])
    std = np.where(np.isfinite(std), std, np.inf)
    if only is None:  # the count alone is the last resort
        std[0] = np.where(np.isfinite(std[1:]).any(axis=0), np.inf, std[0])
    best = np.argmin(std, axis=0)
    fields = {
        name: np.take_along_axis(np.stack([getattr(estimate, name) for estimate in estimates]), best[None], axis=0)[0]
        for name in RateEstimate.__dataclass_fields__
    }
    estimator = np.array(names)[best]
    return RecordRates(**fields, estimator=estimator, joined=_joined(fields["continues"], estimator))


def _joined(continues: Flags, estimator: NDArray[np.str_]) -> Flags:
    """An interval continues the one before only if that one was taken by the same estimator."""
    same = np.zeros(continues.shape, dtype=np.bool_)
    same[1:] = estimator[1:] == estimator[:-1]
    return same & continues
