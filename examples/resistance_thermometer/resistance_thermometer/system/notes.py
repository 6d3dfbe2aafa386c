"""Sentences for the reader of a report: what makes a result doubtful, and what the data do not tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from resistance_thermometer.system.comparison import Comparison, covariance_degC2, reference_degC, slope_ohm_degC
from resistance_thermometer.system.estimators.callendar import HELD
from resistance_thermometer.system.estimators.departure import ALLOY, SERIES, likeliest_departure
from resistance_thermometer.system.estimators.iec60751 import CLASSES, IEC_60751
from resistance_thermometer.system.points import Point
from resistance_thermometer.system.setup import Setup

_SURE = 4.0  # standard uncertainties
_FEWEST_ALIKE = 3  # thermometers that depart alike before the reference is doubted
_MOST_UNLIKE = 0.5  # scatter of their deviations, of the mean


def doubts_of(comparisons: Sequence[Comparison], points: Sequence[Point], setup: Setup) -> list[str]:
    """Return what seems not to be as stated: of the reference first, since all others rest on it."""
    departures = [note for comparison in comparisons for note in _departure_notes(comparison)]
    return [*_air_notes(points, setup), *_alike_notes(comparisons), *departures]


def missing_of(comparisons: Sequence[Comparison]) -> list[str]:
    """Return what the campaign promises and has no result, one sentence each."""
    missing = []
    for comparison in comparisons:
        name = f"{comparison.thermometer.serial} (channel {comparison.thermometer.channel})"
        missing += [f"{name}: deviation at {t:g} degC, nothing to compare there" for t in comparison.absent_degC]
        if comparison.refused:
            missing.append(f"{name}: coefficients, {comparison.refused}")
    return missing


def cold_notes(comparisons: Sequence[Comparison]) -> list[str]:
    """Say why the coefficient c was held, once for all thermometers."""
    fits = [c.fit for c in comparisons if c.fit is not None and not c.refused]
    held = [fit.cold_std_per_degC4 for fit in fits if fit.values.size == HELD]
    if not held:
        return []
    told = "nothing was measured below 0 degC"
    if np.isfinite(min(held)):
        told = f"the data give it with a standard uncertainty of {min(held):.2g} per degC4 at best"
    return [f"cvd_c is not determined: {told}. It was held at {IEC_60751.c:g} of IEC 60751."]


def _departure_notes(comparison: Comparison) -> list[str]:
    """Name the likeliest cause for a thermometer that is outside of class B somewhere, beyond doubt."""
    limit = np.array([CLASSES["B"].degC(t) for t in comparison.t_degC])
    if comparison.t_degC.size < 2 or not (np.abs(comparison.deviation_degC) - 2 * comparison.std_degC > limit).any():
        return []
    thermometer = comparison.thermometer
    slope = slope_ohm_degC(thermometer, comparison.t_degC)
    element_degC = comparison.t_degC + thermometer.self_heating_degC
    covariance = covariance_degC2(comparison.parts) * np.outer(slope, slope)
    found = likeliest_departure(element_degC, comparison.resistance_ohm, covariance, thermometer.nominal_ohm)
    as_if = f"its resistance at 0 degC were {1e2 * found.size:+.2f} % off"
    if found.cause == SERIES:
        as_if = f"{found.size:+.3f} ohm were in series with it: are its leads connected with two wires?"
    elif found.cause == ALLOY:
        own = 1e6 * (IEC_60751.a + found.size)
        as_if = f"its coefficient a were {own:.1f} ppm/degC: platinum of another alloy?"
    return [f"{thermometer.serial} is outside of class B, most likely as if {as_if}"]


def _air_notes(points: Sequence[Point], setup: Setup) -> list[str]:
    """Doubt a reference that does not read what the chamber's own sensor reads."""
    apart = reference_degC(points, setup) - np.array([point.air.value for point in points])
    due = _SURE * np.hypot(setup.air_std_degC, setup.reference_std_degC)
    far = np.flatnonzero(np.abs(apart) > due)
    if not far.size:
        return []
    worst = far[np.argmax(np.abs(apart[far]))]
    return [
        f"The reference probe reads {apart[worst]:+.2f} degC beside the chamber's air at "
        f"{points[worst].setpoint_degC:g} degC, {due:.2f} degC are due: is it in the chamber, and is it the one of the "
        "register? Every result rests on it."
    ]


def _alike_notes(comparisons: Sequence[Comparison]) -> list[str]:
    """Doubt what all thermometers have in common if all depart alike, far beyond their uncertainty."""
    means = np.array([c.deviation_degC.mean() for c in comparisons if c.deviation_degC.size])
    stds = np.array([c.std_degC.max() for c in comparisons if c.deviation_degC.size])
    if means.size < _FEWEST_ALIKE:
        return []
    mean_degC = abs(float(means.mean()))
    if np.std(means) > _MOST_UNLIKE * mean_degC or mean_degC < _SURE * stds.max():
        return []
    return [
        f"All {means.size} thermometers deviate by about {means.mean():+.3f} degC: look for the cause in what they "
        "have in common, the reference probe, the meter and the scanner."
    ]
