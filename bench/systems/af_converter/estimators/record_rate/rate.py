"""Current of each record by the best of three estimators, whose name goes with the value.

Source: AF-converter paper equation (1) (gated count); ``estimate`` for the other two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.record_rate.estimate import RateEstimate, gated, omega, reciprocal
from bench.systems.af_converter.estimators.record_rate.pulses import PulseConverters, PulseRecords

GATED, OMEGA, RECIPROCAL = "gated", "omega", "reciprocal"
ESTIMATORS = {GATED: gated, OMEGA: omega, RECIPROCAL: reciprocal}


@dataclass(frozen=True)
class RecordRates(RateEstimate):
    """Best estimate of each record and channel, (m, c); ``estimator`` names it ("gated", "omega", "reciprocal").

    ``joined``: the interval begins with the very cut that ended the one before, so that their quantisation errors
    telescope. For one channel ``gates.series_covariance`` takes the columns ``estimator``, ``middle_s``,
    ``length_s``, ``quantum_C`` and ``joined``; times there are those of the records plus these.
    """

    estimator: NDArray[np.str_]
    joined: NDArray[np.bool_]


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
    names = list(ESTIMATORS) if only is None else [only]
    found = [ESTIMATORS[name](records, converters) for name in names]
    std = np.stack([one.std_uncertainty_A for one in found])
    std = np.where(np.isfinite(std), std, np.inf)
    if only is None:  # the count alone is the last resort
        std[0] = np.where(np.isfinite(std[1:]).any(axis=0), np.inf, std[0])
    best = np.argmin(std, axis=0)
    fields = {
        name: np.take_along_axis(np.stack([getattr(one, name) for one in found]), best[None], axis=0)[0]
        for name in RateEstimate.__dataclass_fields__
    }
    estimator = np.array(names)[best]
    return RecordRates(**fields, estimator=estimator, joined=_joined(fields["continues"], estimator))


def _joined(continues: NDArray[np.bool_], estimator: NDArray[np.str_]) -> NDArray[np.bool_]:
    """An interval continues the one before only if that one was taken by the same estimator."""
    same = np.zeros(continues.shape, dtype=np.bool_)
    same[1:] = estimator[1:] == estimator[:-1]
    return np.asarray(same & continues)
