"""Sentences a reader of the results of a bias campaign must know."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from bench.systems.af_converter.bias_ramp.estimates import DSF_STD
from bench.systems.af_converter.bias_ramp.fit import JOINT, ChannelFit
from bench.systems.af_converter.bias_ramp.records import RampRecords
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.hysteresis.fit import LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH

_CHI2_PROBABILITY = 1e-4


def notes(fits: Sequence[ChannelFit], records: RampRecords, campaign: Campaign, method: str) -> list[str]:
    """Notes on windows left out, estimators, what was not determined, and what the uncertainties do not hold."""
    driver = "the chamber's air" if method == JOINT else "the unit's own sensor"
    found = [f"{count} windows left out of the fits: {reason}." for reason, count in sorted(records.left_out.items())]
    found.append(
        f"Hysteresis, thermal lag and the polynomial were fitted together, the unit driven by {driver}. The bias is "
        "that in the middle of the loop, its random walk averaged over the campaign"
        + ("." if any(one.sensor_problem for one in fits) else "; temperatures are those of the unit's own sensor.")
    )
    found += _estimators(fits) + _naive(fits, campaign, method)
    for one in fits:
        found += _undetermined(one) + _chi_square(one)
    found.append(
        f"The scale factors are taken as nominal: {DSF_STD * 1e6:g} ppm of every bias and width is in its uncertainty."
    )
    if campaign.temperature_sensor_u95_degC is None:
        found.append("The uncertainty of the unit's temperature sensor is not stated; it is not included.")
    return found


def _estimators(fits: Sequence[ChannelFit]) -> list[str]:
    by_use: dict[str, list[int]] = {}
    for one in fits:
        use = ", ".join(f"{name} {count}" for name, count in one.readings.estimators.items())
        by_use.setdefault(use, []).append(one.readings.channel.number)
    return [f"Windows by estimator, channel {', '.join(map(str, numbers))}: {use}." for use, numbers in by_use.items()]


def _naive(fits: Sequence[ChannelFit], campaign: Campaign, method: str) -> list[str]:
    """What separate polynomials make of the lag, on the channel where it matters most, and how much they leave out."""
    at = np.array([campaign.reference_temperature_degC])
    found = []
    apart = [(one, float(one.naive(one.air_degC, at)[0])) for one in fits]
    known = [(one, value) for one, value in apart if np.isfinite(value)]
    if known:
        one, value = max(known, key=lambda pair: abs(pair[1] - pair[0].fit.value(WIDTH)))
        lag = f": the unit lags the air by {one.fit.value(LAG) / 60:.0f} min" if method == JOINT else ""
        found.append(
            f"Separate polynomials of the branches against the chamber's temperature would give a hysteresis width of "
            f"{value * 1e9:.1f} nA for channel {one.readings.channel.number} at {at[0]:g} degC instead of "
            f"{one.fit.value(WIDTH) * 1e9:.1f} nA{lag}."
        )
        masked = sorted({one.masked for one in fits})
        span = f"{masked[0]}" if len(masked) == 1 else f"{masked[0]} to {masked[-1]}"
        found.append(f"{span} windows per channel, in which the play crosses after a reversal, are masked there.")
    return found


def _undetermined(one: ChannelFit) -> list[str]:
    number, fit = one.readings.channel.number, one.fit
    found = []
    if not fit.half_width_determined:
        found.append(
            f"Channel {number}: no play half-width. A hysteresis width of {fit.value(WIDTH) * 1e9:.2f} nA with a "
            f"standard uncertainty of {fit.std(WIDTH) * 1e9:.2f} nA does not tell it; width and bias are averages over "
            "all half-widths possible."
        )
    if not fit.lag_determined:
        found.append(
            f"Channel {number}: no thermal lag. {fit.value(LAG) / 60:.1f} min with a standard uncertainty of "
            f"{fit.std(LAG) / 60:.1f} min is not apart from the limits of the search."
        )
    return found


def _chi_square(one: ChannelFit) -> list[str]:
    fit = one.fit
    if special.chdtrc(fit.dof, fit.chi2) >= _CHI2_PROBABILITY:
        return []
    return [
        f"Channel {one.readings.channel.number}: reduced chi-square {fit.reduced_chi2:.2f}; the residuals exceed the "
        "declared noise."
    ]
