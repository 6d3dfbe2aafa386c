"""Estimates of every channel and temperature: scale-factor errors, asymmetry, bias."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis import estimate
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted, GroupFit

_PPM = 1e6


def conditions_of(one: GroupFit, campaign: Campaign) -> dict[str, Any]:
    """Return conditions of an estimate: nominal and measured temperature of a channel."""
    return {
        "channel": one.group.channel,
        "kind": campaign.channel(one.group.channel).kind,
        "temperature_degC": one.group.temperature_degC,
        "unit_temperature_degC": one.fit.unit_temperature_degC,
    }


def common_relative_ppm(standards: Standards) -> float:
    """Return what a stated traceability and drift of the calibrator add to every scale-factor error, standard, ppm."""
    return float(np.hypot(standards.traceability or 0.0, standards.drift or 0.0)) * _PPM


def sensor_effect_ppm(one: GroupFit, fitted: Fitted, campaign: Campaign) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Signed effect (2,) on DSF_N, DSF_P of one standard deviation of the unit's temperature sensor, ppm.

    A result says at which unit temperature it holds; a wrong thermometer makes it the result of another temperature.
    Zero while the coefficients of the channel or the uncertainty of the sensor are not known; a note says so.
    """
    slopes = fitted.slopes_ppm_degC(one.group.channel, one.fit.unit_temperature_degC)
    return np.array(slopes) * campaign.sensor_std_degC


def scale_factor_std_ppm(one: GroupFit, standards: Standards, index: int) -> float:
    """Standard uncertainty of DSF_N (index 0) or DSF_P (1) with the calibrator's gain, without the sensor's part."""
    variance = (
        one.fit.covariance_ppm2[index, index] + one.fit.gain_ppm[index] ** 2 + common_relative_ppm(standards) ** 2
    )
    return float(np.sqrt(variance))


def scale_factor_estimates(
    one: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards
) -> list[dict[str, Any]]:
    """dsf_n, dsf_p with the calibrator's common gain added, and dsf_asymmetry, where the gain cancels."""
    conditions, fit = conditions_of(one, campaign), one.fit
    sensor_ppm = sensor_effect_ppm(one, fitted, campaign)
    counted = {"n": fit.n, "dropped": one.group.dropped + fit.dropped}
    found = []
    for index, quantity in enumerate(QUANTITIES):
        std_ppm = float(np.hypot(scale_factor_std_ppm(one, standards, index), sensor_ppm[index]))
        found.append(estimate(quantity, "ppm", fit.dsf_ppm[index], std_ppm, conditions, **counted))
    contrast = np.array([1.0, -1.0])
    variance = contrast @ fit.covariance_ppm2 @ contrast + (contrast @ fit.gain_ppm) ** 2 + (contrast @ sensor_ppm) ** 2
    value_ppm = float(contrast @ fit.dsf_ppm)
    found.append(estimate("dsf_asymmetry", "ppm", value_ppm, float(np.sqrt(variance)), conditions, **counted))
    return found


def bias_estimates(one: GroupFit, fitted: Fitted, campaign: Campaign) -> list[dict[str, Any]]:
    """Bias of the open row: diagnostic only, it never enters the compensation (paper, end of section 3.3)."""
    if one.bias is None:
        return []
    at_degC = one.bias.unit_temperature_degC
    polynomial = fitted.polynomials.get(("bias", one.group.channel))
    slope_A_degC = polynomial.slope(at_degC) if polynomial else 0.0
    thermal_degC = np.hypot(campaign.sensor_std_degC, np.max(one.group.opened.temperature_std_degC))
    std_A = float(np.hypot(one.bias.std_uncertainty_A, slope_A_degC * thermal_degC))
    conditions = conditions_of(one, campaign) | {"unit_temperature_degC": at_degC}
    rows = one.group.opened.gate_s.size
    return [estimate("bias", "A", one.bias.value_A, std_A, conditions, n=rows, dropped=one.group.open_planned - rows)]
