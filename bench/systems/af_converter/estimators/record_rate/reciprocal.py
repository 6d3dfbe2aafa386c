"""Reciprocal counting of a record: whole pulses over the time between the first and the last of them.

Source: reciprocal counter of frequency metrology, with the frames as its clock.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.systems.af_converter.estimators.record_rate.estimate import RateEstimate
from bench.systems.af_converter.estimators.record_rate.pulses import PulseConverters, PulseRecords, Pulses

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]
Mask = NDArray[np.bool_]


def reciprocal(records: PulseRecords, converters: PulseConverters) -> RateEstimate:
    """Current from the charge of whole pulses over the time they took.

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
) -> tuple[Array, Array, Array, Mask]:
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
    from_before: Mask = ends & later & (before >= 0)
    inside = ends & (later | earlier) & (own.count > 1) & (own.at_first == 1) & ~from_before
    absent: Array = np.where(from_before | inside, 0.0, np.nan)
    first = np.where(from_before, before, own.first) + absent
    pulses = np.where(from_before, own.count, own.count - 1) + absent
    return first, own.last + absent, pulses * np.asarray(k_C, dtype=np.float64), from_before
