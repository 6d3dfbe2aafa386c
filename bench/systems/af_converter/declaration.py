"""What the engine is told of the calibration of AF converters."""

from __future__ import annotations

from typing import Any

from bench.model.declaration import AnalysisDeclaration, CoefficientsDeclaration, Rule, System
from bench.systems.af_converter.sections import ConverterUnit

_HERE = "bench.systems.af_converter"
_BRANCHES = ("hold_start", "up", "hold_top", "down", "hold_end")
_POINT = ("channel", "temperature_degC", "current_A", "polarity", "range_A")
_MAIN = ("dsf_n", "dsf_p", "bias", "hysteresis_width")
_DATA_SHEET: dict[str, Any] = {  # the uncertainty rests on it, and there is no default for it
    "of_unit": ("af_clock", "master_clock", "function_generator", "temperature_sensor_uncertainty"),
    "of_channel": ("white_noise_per_rtHz", "bias_walk_per_rth"),
}
_AT_ONE_TEMPERATURE: dict[str, Any] = {
    "made_of": "records",
    "conditions": _POINT,
    "conditions_of_open": ("channel", "temperature_degC"),  # an open input needs no level, polarity or range
    "problems": f"{_HERE}.groups:record_problems",
}

DECLARATION = System(
    name="af_converter",
    analyses=(
        AnalysisDeclaration(
            "scale_factor",
            f"{_HERE}.scale_factor.analysis",
            ("gls", "paper", "ols"),
            main=_MAIN,
            standards={"dsf_n": "calibrator", "dsf_p": "calibrator"},
            **_AT_ONE_TEMPERATURE,
            **_DATA_SHEET,
        ),
        AnalysisDeclaration(
            "dmm_method",
            f"{_HERE}.dmm_method.analysis",
            ("joint", "as_printed"),
            reading="measure_current",
            main=_MAIN,
            **_AT_ONE_TEMPERATURE,
            **_DATA_SHEET,
        ),
        AnalysisDeclaration(
            "bias_ramp",
            f"{_HERE}.bias_ramp.analysis",
            ("joint", "joint_unit_sensor"),
            made_of="records",
            conditions=("route", "branch"),
            words={"branch": _BRANCHES},
            rule=Rule(
                {"route": "open"},
                ("channel",),
                "an open input and for all channels at once",
                "write 'route: open' and no channel",
            ),
            main=_MAIN,
            **_DATA_SHEET,
        ),
        AnalysisDeclaration(
            "temperature_ramp", f"{_HERE}.temperature_ramp.analysis", ("joint", "drift"), made_of="logs", main=_MAIN
        ),
    ),
    unit=ConverterUnit,
    coefficients=CoefficientsDeclaration(
        "converters", f"{_HERE}.coefficients", f"{_HERE}.coefficients_header:header_text"
    ),
    early=f"{_HERE}.early",
)
