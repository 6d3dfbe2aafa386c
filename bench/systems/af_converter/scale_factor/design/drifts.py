"""How surely the repeats of a campaign show that the calibrator moved: steadily, or in one step, by what costs 1 U."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Estimates
from bench.design import Power
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.group_fit import QUANTITIES
from bench.systems.af_converter.scale_factor.design.rivals import power_of_change
from bench.systems.af_converter.scale_factor.design.tours import Stop

Array = NDArray[np.float64]


def drift_powers(
    stops: Sequence[Stop],
    at_s: Sequence[float],
    again: Sequence[tuple[int, int]],
    reference_degC: float,
    estimates: Estimates,
) -> list[Power]:
    """Return how surely a steady drift, and one step at the worst time, would be seen by the repeats.

    Args:    at_s: mean time of each stop, second.   again: stop and channel of each repeat.   estimates: of the
             campaign, which hold U and what a repeat resolves.
    """
    share = (np.array(at_s) - at_s[0]) / (at_s[-1] - at_s[0])
    steps = [np.asarray(np.arange(len(stops)) > last, float) for last in range(len(stops) - 1)]
    stds_ppm = [entry["std_uncertainty"] for entry in estimates if entry["quantity"] == "calibrator_drift"]
    resolved = [(_first(stops, number), number, std) for (number, _), std in zip(again, stds_ppm, strict=True)]
    powers = []
    for name, patterns in (("steady drift of the calibrator", [share]), ("one step of the calibrator", steps)):
        for quantity in (f"{QUANTITIES[0]}_tc1", f"{QUANTITIES[0]}_tc2"):
            sizes = [_size_ppm(pattern, stops, reference_degC, quantity, estimates) for pattern in patterns]
            worst = min(_power(size, pattern, resolved) for size, pattern in zip(sizes, patterns, strict=True))
            powers.append(Power(name, quantity, worst))
    return powers


def coefficients_at_least(
    stops: Sequence[Stop], at_s: Sequence[float], noise_ppm: float, resolved_ppm: float, reference_degC: float
) -> tuple[float, float]:
    """Return about what the coefficients of first and second order are uncertain by, 95 %: to choose what is fitted.

    Args:    noise_ppm: standard uncertainty of a visit.   resolved_ppm: that of the change between first and last stop.
    """
    visits = [number for number, stop in enumerate(stops) if not stop.repeat]
    warmth = np.array([stops[number].temperature_degC for number in visits]) - reference_degC
    operator = np.linalg.pinv(np.vander(warmth, 3, increasing=True))[1:]
    share = (np.array(at_s)[visits] - at_s[0]) / (at_s[-1] - at_s[0])
    noise = noise_ppm * np.sqrt(np.sum(operator**2, axis=1))
    drift = coverage_factor() * resolved_ppm / 2.0 * np.abs(operator @ share)
    first, second = coverage_factor() * np.hypot(noise, drift)
    return float(first), float(second)


def _first(stops: Sequence[Stop], number: int) -> int:
    return next(
        at
        for at, stop in enumerate(stops)
        if (stop.temperature_degC, stop.repeat) == (stops[number].temperature_degC, 0)
    )


def _size_ppm(
    pattern: Array, stops: Sequence[Stop], reference_degC: float, quantity: str, estimates: Estimates
) -> float:
    """Return how large a change of the calibrator in this pattern costs a coefficient 1 U, ppm."""
    visits = [number for number, stop in enumerate(stops) if not stop.repeat]
    warmth = np.array([stops[number].temperature_degC for number in visits]) - reference_degC
    operator = np.linalg.pinv(np.vander(warmth, 3, increasing=True))
    move = abs(float(operator[int(quantity[-1])] @ pattern[visits]))
    U = min(entry["expanded_uncertainty"] for entry in estimates if entry["quantity"] == quantity)
    return U / move if move > 1e-12 else np.inf


def _power(size_ppm: float, pattern: Array, resolved: Sequence[tuple[int, int, float]]) -> float:
    if size_ppm == np.inf:
        return 1.0
    changes = [(size_ppm * float(pattern[last] - float(pattern[first])), std_ppm) for first, last, std_ppm in resolved]
    return max((power_of_change(change, std_ppm) for change, std_ppm in changes), default=0.0)
