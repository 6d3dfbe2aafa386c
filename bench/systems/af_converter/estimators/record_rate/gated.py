"""Gated count of a record: pulses over gate, the estimator of the paper.

Source: AF-converter paper equations (1), (2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.record_rate.estimate import RateEstimate, on_whole_records
from bench.systems.af_converter.estimators.record_rate.pulses import PulseConverters, PulseRecords

Array = NDArray[np.float64]
_UNSETTLED_PULSES = np.sqrt(6.0)  # u = one pulse in the gate: half of the largest error, see gated
_SETTLED_PULSES = 2


def gated(records: PulseRecords, converters: PulseConverters) -> RateEstimate:
    """Current from the pulses counted in the gate.

    The integrator holds a part of a pulse at each end. While one polarity pulses that part is uniform over one pulse,
    so u = q / (t sqrt(6)), on average over all rates: at a given rate the error takes two values one pulse apart, and
    a 95 % interval holds 80 % to 100 % of them. A record with both polarities or fewer than two pulses may begin and
    end anywhere between the thresholds, which are two pulses apart: u = q / t, half of the largest error. Each lost
    frame cuts the count once more. The counted AF clock brings no error of its own: whole clocks are what pulses wait
    for.

    Args:    records: m records of c channels.   converters: their constants.
    Returns: RateEstimate; NaN without a gate or an AF clock.
    Raises:  nothing.
    Source:  AF-converter paper equation (1); docs/decisions/0004 (quantisation); JCGM 100:2008 4.3.7.
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
