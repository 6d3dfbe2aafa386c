"""A step in time that all channels share: then it is not the units but the standard, or the clock, that changed.

What a polynomial in temperature leaves over may be the unit's own; a pattern in time that is the same in every counter
of every channel is not.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy import special

from bench.analysis import Estimates, Evidence
from bench.systems.af_converter.group_fit import QUANTITIES, SCALE_FACTORS, Fitted
from bench.systems.af_converter.wording import say

Array = NDArray[np.float64]
COEFFICIENTS = {quantity: (f"{quantity}_tc1", f"{quantity}_tc2") for quantity in QUANTITIES}
_HOUR_S = 3600.0
_AGREED = 1e-3  # counters that scatter by chance no more often have steps of their own
_LEAST_SHARE = 1e-3  # of a step that the polynomial does not take in
_SMALLEST = 1e-300  # a chance that is lost in the arithmetic is still one


@dataclass(frozen=True)
class _Series:
    """DSF_N or DSF_P of a channel over its visits, (k,), in order of time, and what its polynomial makes of them.

    ``noise_ppm2`` (k, 2, 2): that of both counters, which share the rows of a visit.
    """

    quantity: str
    channel: int
    time_s: Array
    value_ppm: Array
    noise_ppm2: Array
    operator: Array
    design: Array

    def weights(self, at_s: float) -> Array | None:
        """Return what makes the step at a time of the values, (k,); None if the polynomial takes it in."""
        pattern = self._pattern(at_s)
        left = pattern - self.design @ (self.operator @ pattern)
        index = QUANTITIES.index(self.quantity)
        variance = self.noise_ppm2[:, index, index]
        information = float(left @ (left / variance))
        if information * variance.min() < _LEAST_SHARE:
            return None
        taken = left / variance / information
        return np.asarray(taken - (taken @ self.design) @ self.operator)

    def move(self, at_s: float, step_ppm: float, entries: Estimates) -> float:
        """Return how far a step moves a coefficient, in its expanded uncertainty; the constant goes with the values."""
        moved = np.abs(self.operator @ self._pattern(at_s)) * abs(step_ppm)
        stated = _stated(entries, COEFFICIENTS[self.quantity], self.channel)
        return float(np.max(moved[1:] / stated))

    def _pattern(self, at_s: float) -> Array:
        return np.asarray(self.time_s > at_s, dtype=np.float64)


def common_step(fitted: Fitted, entries: Estimates) -> list[Evidence]:
    """Return what the counters of all channels say of one step in time between their visits.

    Of the values, and of their temperature coefficients, which a smaller step moves; ``entries`` state both.
    Source: the noise of the visits, or Student's t over the channels where these scatter more; union bound over times.
    """
    series = _all_series(fitted)
    times_s = np.unique(np.concatenate([np.zeros(1), *(entry.time_s for entry in series)]))[1:]
    found = [(at_s, *_judged(series, at_s)) for at_s in (times_s[1:] + times_s[:-1]) / 2.0]
    if not found:
        return []
    at_s, step_ppm, chance = min(found, key=lambda each: each[2])
    probability = min(1.0, max(chance * len(found), _SMALLEST))
    hours = (at_s - times_s.min(initial=at_s)) / _HOUR_S
    of_values = max((abs(step_ppm) / U_ppm for U_ppm in _stated(entries, QUANTITIES)), default=0.0)
    of_slopes = max((entry.move(at_s, step_ppm, entries) for entry in series), default=0.0)
    return [
        Evidence(
            "common_step",
            say("evidence.common_step", step=step_ppm, hours=hours, move=move),
            step_ppm,
            probability,
            move,
            quantities,
        )
        for quantities, move in ((SCALE_FACTORS, of_values), (tuple(chain(*COEFFICIENTS.values())), of_slopes))
    ]


def _stated(entries: Estimates, quantities: Collection[str], channel: int | None = None) -> list[float]:
    """Return the expanded uncertainties of some estimates, in their order."""
    return [
        entry["expanded_uncertainty"]
        for entry in entries
        if entry["quantity"] in quantities and channel in (None, entry["conditions"].get("channel"))
    ]


def _all_series(fitted: Fitted) -> list[_Series]:
    series = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        if quantity in QUANTITIES and len(visits) > polynomial.coefficients.size:
            warmth = np.array([visit.fit.unit_temperature_degC for visit in visits]) - polynomial.reference_degC
            series.append(
                _Series(
                    quantity=quantity,
                    channel=channel,
                    time_s=np.array([visit.fit.time_s for visit in visits]),
                    value_ppm=np.array([visit.fit.dsf_ppm[QUANTITIES.index(quantity)] for visit in visits]),
                    noise_ppm2=np.array([visit.fit.noise_ppm2 for visit in visits]),
                    operator=polynomial.operator,
                    design=np.vander(warmth, polynomial.coefficients.size, increasing=True),
                )
            )
    return series


def _judged(series: list[_Series], at_s: float) -> tuple[float, float]:
    """Return the common step at a time, ppm, and its probability by chance; a channel is the mean of its counters."""
    of_channel: dict[int, list[tuple[_Series, Array]]] = {}
    for entry in series:
        weights = entry.weights(at_s)
        if weights is not None:
            of_channel.setdefault(entry.channel, []).append((entry, weights))
    if len(of_channel) < 2:
        return 0.0, 1.0
    values, variances = (np.array(column) for column in zip(*map(_mean_step, of_channel.values()), strict=True))
    mean = float(values.mean())
    if special.chdtrc(values.size - 1, float(np.sum((values - mean) ** 2 / variances))) > _AGREED:
        return mean, float(2.0 * special.ndtr(-abs(mean) * values.size / float(np.sqrt(np.sum(variances)))))
    return mean, float(2.0 * special.stdtr(values.size - 1, -abs(mean) * values.size**0.5 / values.std(ddof=1)))


def _mean_step(counters: list[tuple[_Series, Array]]) -> tuple[float, float]:
    """Return the step of a channel, ppm, and its variance: its counters share the noise of their rows."""
    step_ppm = float(np.mean([weights @ entry.value_ppm for entry, weights in counters]))
    variance = sum(
        float(
            np.sum(
                one * other * entry.noise_ppm2[:, QUANTITIES.index(entry.quantity), QUANTITIES.index(beside.quantity)]
            )
        )
        for entry, one in counters
        for beside, other in counters
    )
    return step_ppm, variance / len(counters) ** 2
