"""What no data of a campaign of AF converters can show, with the size that passes unseen and what would show it.

Sizes that depend on the campaign come from its constants; the drift that a closing repeat leaves is computed with the
results and stands in their notes.
Source: docs/decisions/0025-doubt.md; AF-converter paper sections 3 and 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption

CLOCK_STEADY = 5e-6  # relative, within a visit of half an hour: a bad oscillator moves less
_SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_asymmetry")
_COEFFICIENTS = ("dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc1", "dsf_p_tc2")
_nA, _PPM = 1e9, 1e6


def of_levels(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what the scale factors of a campaign take for granted, from the section "campaign" of its plan."""
    return [_gain(campaign), _drift(), _sensor(campaign), _linear(), _clock_of_polarity(), *_bias(campaign)]


def of_bias_ramp(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what the biases of a ramp take for granted, from the section "campaign" of its plan."""
    sensor = Assumption(
        "temperature_sensor_gain",
        "The temperature sensor of the unit has no error of its gain.",
        "An error of any size leaves no residual.",
        "1 % of gain is 1 % of bias_tc1, 2 % of bias_tc2 and 1 % of the play half-width.",
        "A calibrated thermometer beside the sensor at both ends of the ramp.",
        ("bias", "play_half_width"),
    )
    shape = Assumption(
        "shape_of_the_bias",
        "Over temperature the bias is a cubic and one loop of one width, behind one lag, and steady otherwise.",
        "Another shape, or a change in time, of up to a tenth of the loop's width passes.",
        "A tenth of the loop in another shape moves width, half-width, lag and temperature coefficients by up to 4 U.",
        "A second ramp at another rate, or one that turns back in its middle.",
        ("bias", "hysteresis_width", "play_half_width", "thermal_lag"),
    )
    return [sensor, shape, *_bias(campaign)]


def of_log(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a temperature ramp that another program recorded takes for granted."""
    return [
        Assumption(
            "temperature_sensor_gain",
            "The temperature column has no error of its gain.",
            "An error of any size leaves no residual.",
            "1 % of gain is 1 % of the first temperature coefficient, 2 % of the second and 3 % of the third.",
            "A calibrated thermometer beside the sensor at both ends of the ramp.",
        ),
        Assumption(
            "steady_stimulus",
            "What the readings were taken of did not change with the temperature.",
            "A change in step with the temperature leaves no residual, at any size.",
            "It enters the temperature coefficients one to one, as if it were of the unit.",
            "A second unit or a check standard in the same log, outside the chamber.",
        ),
    ]


def _gain(campaign: Mapping[str, Any]) -> Assumption:
    levels_A = [level_A for channel in campaign.get("channels", ()) for level_A in channel.get("levels_A", ())]
    common = f"at all {len(set(levels_A))} levels and " if levels_A else ""
    return Assumption(
        "calibrator_gain",
        "The calibrator delivers what its certificate says.",
        f"An error of gain that is the same {common}at all temperatures leaves no residual, at any size.",
        "1 ppm of gain is 1 ppm of dsf_n and dsf_p; U holds what the certificate allows, and no more.",
        "A check standard in every campaign, or the same channel by another calibrator.",
        ("dsf_n", "dsf_p"),
    )


def _drift() -> Assumption:
    return Assumption(
        "calibrator_drift",
        "The calibrator drifts steadily, if at all, and not in step with the temperatures.",
        "The closing repeat sees its last hours only. The drift that it leaves open over the whole campaign stands in "
        "the notes of the results and is in U as a steady one; without a repeat any drift passes.",
        "1 ppm from the first temperature to the last, over 60 degC, is 0.017 ppm/degC of tc1; a step of 1 ppm in "
        "between is 0.0003 ppm/degC2 of tc2.",
        "A repeat of the first temperature in the middle and at the end, or temperatures not in order.",
        (*_SCALE_FACTORS, *_COEFFICIENTS),
    )


def _sensor(campaign: Mapping[str, Any]) -> Assumption:
    u95_degC, reference_degC = campaign.get("temperature_sensor_u95_degC"), campaign.get("reference_temperature_degC")
    stated = "" if u95_degC is None else f" Its stated {u95_degC:g} degC counts as an offset."
    return Assumption(
        "temperature_sensor_gain",
        "The temperature sensor of the unit has no error of its gain.",
        f"An error of any size leaves no residual.{stated}",
        f"1 % of gain is 0.3 degC at 30 degC from the reference of {reference_degC or 20.0:g} degC: with 10 ppm/degC "
        "dsf_n, dsf_p and, where N and P differ by as much, dsf_asymmetry move by 3 ppm there; tc1 moves by 1 %, tc2 "
        "by 2 %.",
        "A calibrated thermometer beside the sensor at the lowest and the highest temperature.",
        (*_SCALE_FACTORS, *_COEFFICIENTS),
    )


def _linear() -> Assumption:
    return Assumption(
        "converter_linearity",
        "Below what the residuals show the converter is linear.",
        "A bend that takes less than 10 ppm from the largest level passes; 20 ppm are seen.",
        "dsf_n and dsf_p move by at most these 10 ppm.",
        "More levels near full scale.",
        _SCALE_FACTORS,
    )


def _clock_of_polarity() -> Assumption:
    return Assumption(
        "clock_counts",
        "The AF clock is counted rightly in every record.",
        f"A visit in which records of one polarity miscount it by less than {_PPM * CLOCK_STEADY:g} ppm passes.",
        "1 ppm in the records of one polarity is 1 ppm of dsf_asymmetry and of dsf_n or dsf_p.",
        "The same visit again, with the polarities in another order.",
        _SCALE_FACTORS,
    )


def _bias(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what the bias and the clock errors take for granted."""
    return [
        Assumption(
            "open_route_leakage",
            "The route of an open input carries no current of its own.",
            "A leakage of any size leaves no residual.",
            "1 nA of leakage is 1 nA of bias; scale factors do not move.",
            "The open record again with the plug of the channel pulled.",
            ("bias", "bias_residual"),
        ),
        Assumption(
            "generator_frequency",
            "The function generator runs at its stated frequency.",
            f"An error of any size leaves no residual at {campaign.get('fg_Hz', 1e7) / 1e6:g} MHz.",
            "1 ppm of frequency is 1 ppm of master_clock_error; biases and scale factors do not move.",
            "The generator against a second frequency standard.",
            ("master_clock_error",),
        ),
    ]
