"""What explains the estimates of a scale-factor campaign in the report: coefficients, residuals, budget."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bench.analysis import estimate
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.temperature import TemperaturePolynomial
from bench.systems.af_converter.group_estimates import common_relative_ppm, conditions_of, sensor_effect_ppm
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted, GroupFit

_UNITS = {"dsf_n": "ppm", "dsf_p": "ppm", "bias": "A"}


def coefficient_estimates(fitted: Fitted, campaign: Campaign, standards: Standards) -> list[dict[str, Any]]:
    """<quantity>_tc0, _tc1, _tc2: value and coefficients about the reference temperature of the campaign."""
    found = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        temperatures = [one.fit.unit_temperature_degC for one in visits]
        conditions = {
            "channel": channel,
            "kind": campaign.channel(channel).kind,
            "reference_temperature_degC": campaign.reference_temperature_degC,
        }
        for order, value in enumerate(polynomial.coefficients):
            std = float(np.hypot(polynomial.std_uncertainty(order), _sensor_effect(polynomial, order, campaign)))
            if quantity in QUANTITIES:
                std = float(np.hypot(std, _standard_ppm(order, temperatures, standards)))
            unit = _UNITS[quantity] + ("", "/degC", "/degC2")[order]
            found.append(estimate(f"{quantity}_tc{order}", unit, value, std, conditions, n=len(visits)))
    return found


def _sensor_effect(polynomial: TemperaturePolynomial, order: int, campaign: Campaign) -> float:
    """One standard deviation of the unit's sensor in a coefficient, the error being the same at all temperatures.

    It moves the polynomial along the axis: tc0 by tc1, tc1 by 2 tc2. A gain error of the sensor of 0.1 % would change
    tc1 by as much, and is left to the sensor's own certificate.
    """
    later = polynomial.coefficients[order + 1 :]
    return float((order + 1) * later[0] * campaign.sensor_std_degC) if later.size else 0.0


def _standard_ppm(order: int, temperatures: list[float], standards: Standards) -> float:
    """Traceability and drift of the calibrator in a coefficient: a drift in time looks like one in temperature.

    The temperatures come in rising order, so a drift that is linear in time is a slope over their span.
    """
    if order == 0:
        return common_relative_ppm(standards)
    return (standards.drift or 0.0) * 1e6 / (max(temperatures) - min(temperatures)) if order == 1 else 0.0


def residuals(groups: Iterable[GroupFit], campaign: Campaign) -> list[dict[str, Any]]:
    """One entry per closed row of the first visits and repeats: what the fit left over, ampere and ppm of the level.

    ``current_A`` is signed; ``residual_ppm`` and ``std_ppm`` are NaN for zero rows.
    """
    found = []
    for one in groups:
        conditions = conditions_of(one, campaign)
        rows = one.group.closed
        for index, number in enumerate(one.group.numbers):
            level_A = float(rows.level_A[index])
            to_ppm = 1e6 / level_A if level_A else float("nan")
            found.append(
                {
                    "number": number,
                    "channel": one.group.channel,
                    "kind": conditions["kind"],
                    "temperature_degC": one.group.temperature_degC,
                    "repeat": one.group.repeat,
                    "current_A": float(rows.polarity[index]) * level_A,
                    "range_A": float(rows.range_A[index]),
                    "residual_A": float(one.fit.residual_A[index]),
                    "residual_ppm": float(one.fit.residual_A[index]) * to_ppm,
                    "std_ppm": float(one.fit.std_A[index]) * to_ppm,
                }
            )
    return found


def components(fitted: Fitted, campaign: Campaign, standards: Standards) -> list[dict[str, Any]]:
    """Budget of dsf_n and dsf_p per kind of channel: largest standard uncertainty over channels and temperatures."""
    largest: dict[tuple[str, str], float] = {}
    for one in fitted.groups:
        kind = campaign.channel(one.group.channel).kind
        sensor_ppm = sensor_effect_ppm(one, fitted, campaign)
        parts = {name: float(np.max(values)) for name, values in one.fit.parts_ppm.items()}
        parts["calibrator gain, common to all rows"] = float(np.max(np.abs(one.fit.gain_ppm)))
        parts["calibrator traceability"] = (standards.traceability or 0.0) * 1e6
        parts["calibrator drift over the campaign"] = (standards.drift or 0.0) * 1e6
        parts["temperature sensor of the unit"] = float(np.max(np.abs(sensor_ppm)))
        variance = np.diag(one.fit.covariance_ppm2) + one.fit.gain_ppm**2 + common_relative_ppm(standards) ** 2
        parts["combined"] = float(np.sqrt(np.max(variance + sensor_ppm**2)))
        for name, value in parts.items():
            largest[kind, name] = max(largest.get((kind, name), 0.0), value)
    stated = {name for (_, name), value in largest.items() if value > 0}
    return [
        {
            "kind": kind,
            "quantity": "dsf_n, dsf_p",
            "component": name,
            "evaluation": "" if name == "combined" else "B",
            "distribution": "triangular" if name.startswith("quantisation") else "normal",
            "std_uncertainty_ppm": value,
        }
        for (kind, name), value in largest.items()
        if name in stated
    ]
