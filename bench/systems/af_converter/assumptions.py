"""What no data of a campaign of AF converters can show, with the size that passes unseen and what would show it.

Sizes that depend on the campaign come from its constants; the drift that a closing repeat leaves is computed with the
results and stands in their notes.
Source: docs/decisions/0025-doubt.md; AF-converter paper sections 3 and 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.systems import Assumption, assumed
from bench.systems.af_converter.wording import say

CLOCK_STEADY = 5e-6  # relative, within a visit of half an hour: a bad oscillator moves less
BETWEEN_VISITS_ppm = 1.0  # standard, at most: of a counter from visit to visit, its curve beyond a parabola included
_SEEN = 8.0  # times that, where they do differ so: one counter of one visit showed it in 9 of 10 campaigns
_SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_asymmetry")
_BY_DMM = ("dsf_n", "dsf_p", "dsf_mean")
_COEFFICIENTS = ("dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc1", "dsf_p_tc2")
_nA, _PPM = 1e9, 1e6


def of_levels(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what the scale factors of a campaign take for granted, from the section "campaign" of its plan."""
    return [
        _gain(campaign),
        assumed(say, "calibrator_drift", (*_SCALE_FACTORS, *_COEFFICIENTS)),
        _sensor(campaign),
        assumed(say, "converter_linearity", _SCALE_FACTORS),
        assumed(say, "clock_counts", _SCALE_FACTORS, ppm=_PPM * CLOCK_STEADY),
        assumed(say, "own_curve", _SCALE_FACTORS, ppm=BETWEEN_VISITS_ppm, least=_SEEN * BETWEEN_VISITS_ppm),
        assumed(say, "gradient_in_the_unit", (*_SCALE_FACTORS, *_COEFFICIENTS)),
        assumed(say, "all_current_through_the_unit", ("dsf_n", "dsf_p"), key="shunt"),
        assumed(say, "polarity_memory", ("dsf_asymmetry",)),
        *_bias(campaign),
    ]


def of_bias_ramp(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what the biases of a ramp take for granted, from the section "campaign" of its plan."""
    sensor = assumed(say, "temperature_sensor_gain", ("bias", "play_half_width"), key="ramp_sensor")
    shape = assumed(say, "shape_of_the_bias", ("bias", "hysteresis_width", "play_half_width", "thermal_lag"))
    return [sensor, shape, *_bias(campaign)]


def of_log(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a temperature ramp that another program recorded takes for granted."""
    return [assumed(say, "temperature_sensor_gain", key="log_sensor"), assumed(say, "steady_stimulus")]


def of_dmm_method(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign by the DMM method takes for granted, from the section "campaign" of its plan.

    Sizes were seen with a meter of 20 ppm and a gyro and an accelerometer channel at one temperature.
    Source: docs/decisions/0007-dmm-method.md.
    """
    bound = min((float(channel.get("plausible_error", 0.05)) for channel in campaign.get("channels", ())), default=0.05)
    percent = 100.0 * bound
    return [
        assumed(say, "meter_gain", _BY_DMM, percent=percent),
        assumed(say, "steady_meter", _BY_DMM),
        assumed(say, "all_current_through_the_unit", _BY_DMM, percent=percent),
        assumed(say, "linear_at_full_scale", (*_BY_DMM, "dsf_asymmetry")),
        assumed(say, "clock_of_polarity", ("dsf_asymmetry",)),
    ]


def _gain(campaign: Mapping[str, Any]) -> Assumption:
    levels_A = {level_A for channel in campaign.get("channels", ()) for level_A in channel.get("levels_A", ())}
    unseen = "unseen_levels" if levels_A else "unseen"
    return assumed(say, "calibrator_gain", ("dsf_n", "dsf_p"), unseen=unseen, count=len(levels_A))


def _sensor(campaign: Mapping[str, Any]) -> Assumption:
    u95_degC, reference_degC = campaign.get("temperature_sensor_u95_degC"), campaign.get("reference_temperature_degC")
    return assumed(
        say,
        "temperature_sensor_gain",
        (*_SCALE_FACTORS, *_COEFFICIENTS),
        unseen="unseen" if u95_degC is None else "unseen_stated",
        u95=u95_degC,
        reference=reference_degC or 20.0,
    )


def _bias(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what the bias and the clock errors take for granted."""
    generator_MHz = campaign.get("fg_Hz", 1e7) / 1e6
    return [
        assumed(say, "open_route_leakage", ("bias", "bias_residual")),
        assumed(say, "generator_frequency", ("master_clock_error",), MHz=generator_MHz),
    ]
