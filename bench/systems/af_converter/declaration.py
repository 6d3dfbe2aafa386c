"""Declaration of the calibration of AF converters, and the part of a sequence on a unit with such converters: its
clocks, its temperature sensor, its kinds of channels.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from bench.model.declaration import (
    AnalysisDeclaration,
    ChannelKind,
    CoefficientsDeclaration,
    Count,
    Hint,
    Rule,
    Section,
    System,
    UnitSections,
    stated,
)
from bench.model.units import quantity, read_quantity
from bench.model.yamlio import StrictModel

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


def _sensor(text: str) -> str:
    quantity = read_quantity(text)
    if quantity is None or quantity[1] not in ("deg/s", "g") or quantity[0] <= 0:
        raise ValueError(f"{text!r} is not a positive rate or acceleration, for example '83 deg/s' or '20 g'")
    return text


class Typical(Section):
    """What the data sheet says of the bias of a kind of channel: a prediction holds for such a one."""

    in_manifest = ("bias_A", "bias_tc1_A_degC", "hysteresis_width_A", "play_half_width_degC")

    bias: Annotated[float, *quantity("A", -1.0, 1.0)] = Field(description="at the reference temperature")
    bias_tc1: Annotated[float, *quantity("A/degC", -1.0, 1.0)] = Field(description="its temperature coefficient")
    hysteresis_width: Annotated[float, *quantity("A", -1.0, 1.0)] = Field(description="falling minus rising branch")
    play_half_width: Annotated[float, *quantity("degC", 0.01, 50.0)]


class Kind(ChannelKind):
    """Declared constants of one kind of converter channel (AF-converter design table)."""

    k0: Annotated[float, *quantity("C", 1e-12, 1.0)] = Field(description="nominal charge per pulse")
    full_scale: Annotated[float, *quantity("A", 1e-9, 10.0)]
    sensor_full_scale: Annotated[str, AfterValidator(_sensor)] = Field(description="sensor's full scale in deg/s or g")
    stability_limit: Annotated[float, *quantity("1", 0.0, 1.0)]
    bias_stability_limit: Annotated[float, *quantity("A", 0.0, 1.0)] | None = Field(
        None, description="how far the bias may be from what compensates it"
    )
    plausible_error: Annotated[float, *quantity("1", 0.0, 1.0)] | None = Field(
        None, description="scale-factor error that a sound converter may have at most; 5 % if not stated"
    )
    white_noise_per_rtHz: Annotated[float, *quantity("A", 0.0, 1.0)] | None = Field(
        None, description="white noise of the input current, one sigma, per root hertz"
    )
    bias_walk_per_rth: Annotated[float, *quantity("A", 0.0, 1.0)] | None = Field(
        None, description="random walk of the bias, one sigma, per root hour"
    )
    typical: Typical | None = Field(None, description="for a prediction of a bias ramp")

    @model_validator(mode="after")
    def _bias_is_within_full_scale(self) -> Kind:
        if self.typical is not None and abs(self.typical.bias) > self.full_scale:
            raise ValueError(
                f"a typical bias of {self.typical.bias:g} A is above the full scale of {self.full_scale:g} A"
            )
        return self

    def channel_constants(self, levels_A: list[float]) -> dict[str, Any]:
        """Return the constants of one channel for the manifest."""
        full_scale, unit = read_quantity(self.sensor_full_scale) or (0.0, "")
        entry: dict[str, Any] = {
            "k0_C": self.k0,
            "full_scale_A": self.full_scale,
            "sensor_full_scale": full_scale,
            "sensor_unit": unit,
            "levels_A": levels_A,
            "stability_limit_ppm": round(self.stability_limit * 1e6, 6),
        }
        if self.plausible_error is not None:
            entry["plausible_error"] = self.plausible_error
        if self.bias_stability_limit is not None:
            entry["bias_stability_limit_A"] = self.bias_stability_limit
        if self.white_noise_per_rtHz is not None and self.bias_walk_per_rth is not None:
            entry["noise"] = {"white_A_rtHz": self.white_noise_per_rtHz, "walk_A_rth": self.bias_walk_per_rth}
        if self.typical is not None:
            entry["typical"] = self.typical.constants()
        return entry


class MasterCurve(StrictModel):
    """Typical error of a master oscillator over temperature, about the reference temperature, by powers."""

    tc1: Annotated[float, *quantity("1/degC", -1e-3, 1e-3)]
    tc2: Annotated[float, *quantity("1/degC2", -1e-3, 1e-3)]
    tc3: Annotated[float, *quantity("1/degC3", -1e-3, 1e-3)]

    def constants(self) -> list[float]:
        """Return them for the manifest, in ppm by powers of degC."""
        return [1e6 * self.tc1, 1e6 * self.tc2, 1e6 * self.tc3]


class ConverterUnit(UnitSections):
    """Sections of ``uut``."""

    af_clock: Annotated[float, *quantity("Hz", 1.0, 1e9)] | None = Field(None, description="of an AF converter")
    master_clock: Annotated[float, *quantity("Hz", 1.0, 1e10)] | None = None
    function_generator: Annotated[float, *quantity("Hz", 1.0, 1e10)] | None = None
    temperature_sensor_uncertainty: Annotated[float, *quantity("degC", 0.0, 10.0)] | None = Field(
        None, description="expanded uncertainty of the unit's own temperature sensor, 95 %"
    )
    thermal_lag: Annotated[float, *quantity("s", 1.0, 1e5)] | None = Field(
        None, description="typical lag of the unit behind the air, for a prediction of a bias ramp"
    )
    master_curve: MasterCurve | None = Field(
        None, description="typical curve of the master oscillator, for a prediction of its temperature coefficients"
    )
    kinds: dict[Literal["gyro", "accelerometer"], Kind] = Field(default_factory=dict)

    @classmethod
    def constants(cls, unit: Any) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign", in base units; what is not stated is left out."""
        constants = {
            "temperature_sensor_u95_degC": unit.temperature_sensor_uncertainty,
            "thermal_lag_s": unit.thermal_lag,
            "af_clock_Hz": unit.af_clock,
            "fg_Hz": unit.function_generator,
            "master_Hz": unit.master_clock,
        }
        curve = {} if unit.master_curve is None else {"master_curve_ppm": unit.master_curve.constants()}
        return {**stated(constants), **curve}

    def channel_kind(self, name: str) -> ChannelKind | None:
        """Return what the data sheet says of a kind of channel, None if it says nothing."""
        return next((kind for word, kind in self.kinds.items() if word == name), None)


DECLARATION = System(
    name="af_converter",
    analyses=(
        AnalysisDeclaration(
            "scale_factor",
            f"{_HERE}.scale_factor.analysis",
            ("gls", "paper", "ols"),
            main=_MAIN,
            standards={"dsf_n": "calibrator", "dsf_p": "calibrator"},
            assumptions=f"{_HERE}.constants:of_levels",
            predicted=f"{_HERE}.scale_factor.analysis:predicted",
            point=f"{_HERE}.groups",
            design=f"{_HERE}.scale_factor.design.campaign:design",
            **_AT_ONE_TEMPERATURE,
            **_DATA_SHEET,
        ),
        AnalysisDeclaration(
            "dmm_method",
            f"{_HERE}.dmm_method.analysis",
            ("joint", "as_printed"),
            reading="measure_current",
            main=_MAIN,
            assumptions=f"{_HERE}.constants:of_dmm_method",
            predicted=f"{_HERE}.dmm_method.analysis:predicted",
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
            assumptions=f"{_HERE}.constants:of_bias_ramp",
            predicted=f"{_HERE}.bias_ramp.predicted:predicted",
            design=f"{_HERE}.bias_ramp.design:design",
            **_DATA_SHEET,
        ),
        AnalysisDeclaration(
            "temperature_ramp",
            f"{_HERE}.temperature_ramp.analysis",
            ("joint", "drift"),
            made_of="logs",
            main=_MAIN,
            assumptions=f"{_HERE}.constants:of_log",
            roles=("time", "temperature", "set_point", "reading", "reference"),
        ),
    ),
    unit=ConverterUnit,
    coefficients=CoefficientsDeclaration("converters", f"{_HERE}.coefficients", f"{_HERE}.coefficients:header_text"),
    early=f"{_HERE}.early",
    count=Count("k0_C", "full_scale_A", "A"),  # coulomb a pulse, ampere of pulses in a second
    log_hints=(Hint("temperature", r"temp|degc", (("degC", 0.0, 200.0),), more={"quantity": "sensor"}),),
)
