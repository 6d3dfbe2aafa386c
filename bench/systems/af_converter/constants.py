"""Converter constants, as a scale-factor analysis reads them from the manifest of a session.

The register of standards, as the analyses of AF converters read it from the manifest of a session.

Every standard enters once: each of its errors has one label, wherever it stands. What no data of a campaign can show
is named with the size that passes unseen and what would show it; the drift that a closing repeat leaves is computed
with the results.
Source: docs/method-uncertainty.md; AF-converter paper sections 3 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bench.analysis import Common, Document, Evidence, Material, outlived, outlived_text
from bench.model.errors import FitError
from bench.model.systems import Assumption, assumed
from bench.model.yamlio import first_wrong
from bench.systems.af_converter.estimators.readings import GAIN, Converter, RangeSpecification, RelativeError
from bench.systems.af_converter.wording import say

PLAUSIBLE_ERROR = 0.05  # of the nominal scale factor, where the sequence states nothing


_Positive = Annotated[float, Field(gt=0)]
_NotNegative = Annotated[float, Field(ge=0)]
Register = Mapping[str, Document]
CALIBRATOR = "calibrator"
FUNCTION_GENERATOR = "function_generator"
METER = "dmm"
FREQUENCY = "frequency"  # error of the function generator
DRIFT_UNKNOWN = say("standard.no_drift")
REGISTER = say("source.register")
_ALL_RANGES = "calibration of all ranges"  # where the register states it for the standard as a whole
_FG_RECTANGULAR_LIMIT = 3e-6  # paper section 4.1: stability of the function generator below 3 ppm


class _Tolerant(BaseModel):
    """Manifest sections may hold more than one analysis reads."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Noise(_Tolerant):
    """Declared noise of a converter; without it no uncertainty would be true, so there is no default."""

    white_A_rtHz: _NotNegative
    walk_A_rth: _NotNegative


class Typical(_Tolerant):
    """What the data sheet says of the bias of a channel; predictions of a bias ramp hold for such a one."""

    bias_A: float
    bias_tc1_A_degC: float
    hysteresis_width_A: float
    play_half_width_degC: _Positive


class Channel(_Tolerant):
    """One converter channel of the unit under test."""

    number: Annotated[int, Field(ge=1)]
    kind: str
    k0_C: _Positive
    full_scale_A: _Positive
    sensor_full_scale: _Positive
    sensor_unit: str
    noise: Noise
    levels_A: tuple[float, ...] = ()
    stability_limit_ppm: float | None = None
    bias_stability_limit_A: float | None = None
    plausible_error: _Positive = PLAUSIBLE_ERROR
    typical: Typical | None = None


class Campaign(_Tolerant):
    """Constants of the campaign.

    ``previous``: estimates of an earlier calibration in contract form; ``temperature_sensor_u95_degC``: expanded
    uncertainty (95 %, k = 2) of the unit's own temperature sensor, None if not stated; ``gradient_degC``: how far the
    converters of one of several units in a chamber may be from what its sensor says (95 %, k = 2), None if it is alone;
    ``thermal_lag_s``: typical lag of the unit behind the air, None if not stated; ``master_curve_ppm``: typical
    coefficients of the master oscillator from ppm/degC on.
    """

    analysis: str
    reference_temperature_degC: float = 20.0
    af_clock_Hz: _Positive
    fg_Hz: _Positive = 1e7
    master_Hz: _Positive
    uut: Document = Field(default_factory=dict)
    channels: tuple[Channel, ...]
    temperature_sensor_u95_degC: _NotNegative | None = None
    gradient_degC: _NotNegative | None = None
    thermal_lag_s: _Positive | None = None
    master_curve_ppm: tuple[float, float, float] | None = None
    previous: tuple[Document, ...] = ()

    def channel(self, number: int) -> Channel:
        """Constants of one channel. Raises FitError B-FIT-008 for a channel the campaign does not declare."""
        for channel in self.channels:
            if channel.number == number:
                return channel
        raise FitError(
            "B-FIT-008",
            f"the session has records of channel {number}, but the campaign declares no such channel",
            next_step="add the channel to the campaign's sequence file",
        )

    def converter(self, number: int) -> Converter:
        """Declared constants of one channel in the form the fit takes."""
        channel = self.channel(number)
        return Converter(channel.k0_C, self.af_clock_Hz, channel.noise.white_A_rtHz, channel.noise.walk_A_rth)

    @property
    def sensor_std_degC(self) -> float:
        """Standard uncertainty of the unit's temperature sensor; 0 if not stated."""
        return (self.temperature_sensor_u95_degC or 0.0) / 2.0

    @property
    def gradient_std_degC(self) -> float:
        """Standard uncertainty by the chamber's gradient and the heat of neighbours; 0 for a unit that is alone."""
        return (self.gradient_degC or 0.0) / 2.0

    @property
    def thermal_std_degC(self) -> float:
        """Standard uncertainty of the temperature that a result holds at: sensor and gradient, the same in all rows."""
        return math.hypot(self.sensor_std_degC, self.gradient_std_degC)


def read_campaign(campaign: Document) -> Campaign:
    """Check the campaign section of a manifest. Raises FitError B-FIT-008 naming the first wrong field."""
    try:
        return Campaign.model_validate(campaign)
    except ValidationError as error:
        place, what = first_wrong(error)
        raise FitError(
            "B-FIT-008",
            f"the campaign constants are not usable: {what}",
            where=f"manifest: campaign.{place}",
            next_step="check the campaign section of the sequence the session was made with",
        ) from error


@dataclass(frozen=True)
class Standards:
    """Uncertainties (standard, relative or ampere) and corrections of the standards that matter here.

    ``drift``: of the calibrator over the campaign; ``drift_source`` says who knows it. ``calibrator_dof``,
    ``generator_dof``: degrees of freedom of what their certificates state.   ``register``: what they were read from.
    """

    ranges: Mapping[float, RangeSpecification]
    drift: float | None
    function_generator: float
    notes: tuple[str, ...] = field(default=())
    drift_source: str = REGISTER
    calibrator_dof: float = math.inf
    generator_dof: float = math.inf
    register: Register = field(default_factory=dict)

    @property
    def drift_ppm(self) -> float:
        """Return what the drift of the calibrator adds to each scale-factor error, standard, ppm; 0 if not known."""
        return (self.drift or 0.0) * 1e6

    def dof_of(self, label: str) -> float:
        """Return the degrees of freedom of an error of the calibrator."""
        calibrations = (entry.calibration for entry in self.ranges.values())
        known = [error.dof for error in calibrations if error is not None and error.label == label]
        return min(known, default=self.calibrator_dof)


def read_ranges(standards: Register, role: str) -> dict[float, RangeSpecification]:
    """Return uncertainty (95 %, k = 2) and correction of each range of a standard, by full scale in ampere.

    Raises: FitError B-FIT-009 if the register has no such standard or one of its numbers is missing.
    """
    try:
        entry = standards[role]
        corrections = {float(correction["range_A"]): correction for correction in entry.get("corrections") or ()}
        return {
            float(line["range_A"]): _range(line, corrections.get(float(line["range_A"]), {}), entry)
            for line in entry["uncertainty"]
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _register_error(role, error) from error


def _range(line: Document, correction: Document, entry: Document) -> RangeSpecification:
    kind, common = line.get("specification"), line.get("common_with")
    calibration = _calibration(line, entry)
    return RangeSpecification(
        relative=float(line["relative"]),
        floor_A=float(line["floor_A"]),
        gain=float(correction.get("gain", 0.0)),
        offset_A=float(correction.get("offset_A", 0.0)),
        label=str(common) if kind == "absolute" and common else GAIN,
        calibration=calibration,
        traced=kind == "absolute" or calibration is not None,
    )


def _calibration(line: Document, entry: Document) -> RelativeError | None:
    """Return the error of a range that its certificate states beside a relative specification, None if it does not."""
    dof = _at_least_one(line.get("dof", entry.get("dof")))
    if line.get("certificate_U") is not None:
        label = line.get("common_with") or f"calibration of the range {float(line['range_A']):g} A"
        return RelativeError(str(label), float(line["certificate_U"]) / float(line.get("k", 2.0)), dof)
    traceability = _half(entry, "traceability_relative")
    return None if traceability is None else RelativeError(_ALL_RANGES, traceability, dof)


def _register_error(role: str, error: Exception) -> FitError:
    return FitError(
        "B-FIT-009",
        f"the standards register does not say what the fit needs of the {role} ({error!r})",
        where=f"manifest: standards.{role}",
        next_step="give range, relative and floor of each range in the station file",
    )


def read_standards(standards: Register) -> Standards:
    """Read the register as it stood when the session was made; uncertainties without a factor are 95 %, k = 2.

    Raises: FitError B-FIT-009 if the calibrator or one of its numbers is missing.
    """
    ranges, generator = read_ranges(standards, CALIBRATOR), read_generator(standards)
    drift = _half(standards[CALIBRATOR], "drift_relative")
    notes = untraced(ranges, CALIBRATOR)
    if drift is None:
        notes.append(DRIFT_UNKNOWN)
    degrees = read_dof(standards, CALIBRATOR), read_dof(standards, FUNCTION_GENERATOR)
    return Standards(ranges, drift, generator, tuple(notes), REGISTER, *degrees, standards)


def untraced(ranges: Mapping[float, RangeSpecification], role: str) -> list[str]:
    """Return a note if the uncertainty of a standard does not hold that of its own calibration."""
    name = say("name.meter") if role == METER else say("name.calibrator") if role == CALIBRATOR else role
    return [] if all(entry.traced for entry in ranges.values()) else [say("standard.untraced", name=name)]


def read_generator(standards: Register) -> float:
    """Relative standard uncertainty of the function generator; where the register states none, that of the paper.

    Raises: FitError B-FIT-009 if what it states is not usable.
    """
    try:
        return _function_generator(standards.get(FUNCTION_GENERATOR, {}))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise _register_error(FUNCTION_GENERATOR, error) from error


def read_dof(standards: Register, role: str) -> float:
    """Return degrees of freedom of what a standard's certificate states; infinite where the register states none.

    Raises: FitError B-FIT-009 for fewer than one, or what is no number.
    """
    try:
        return _at_least_one(standards.get(role, {}).get("dof"))
    except (TypeError, ValueError) as error:
        raise _register_error(role, error) from error


def _at_least_one(stated: Any) -> float:
    degrees = math.inf if stated is None else float(stated)
    if not degrees >= 1.0:
        raise ValueError(f"{degrees:g} degrees of freedom, at least 1 is due")
    return degrees


def _half(entry: Document, key: str) -> float | None:
    return None if entry.get(key) is None else float(entry[key]) / 2.0


def _function_generator(entry: Document) -> float:
    stated = entry.get("uncertainty") or ()
    if not stated:
        own = _FG_RECTANGULAR_LIMIT / math.sqrt(3.0)
        return math.hypot(own, _half(entry, "traceability_relative") or 0.0)
    calibration = _calibration(stated[0], entry)
    return math.hypot(float(stated[0]["relative"]) / 2.0, calibration.std if calibration else 0.0)


def common_errors(standards: Register, role: str, parts: Mapping[str, float], campaign: Mapping[str, float]) -> Common:
    """Return what a result shares with others: signed parts of a standard's errors, and of errors of the campaign.

    An error that the register names ``common_with`` keeps that name; any other is named after model, serial number and
    certificate of its standard, and without these no other session can know it: it is one of the campaign then.
    """
    entry = standards.get(role, {})
    named = {str(line["common_with"]) for line in entry.get("uncertainty") or () if line.get("common_with")}
    known = bool(entry.get("serial") and entry.get("certificate"))
    of_standards, of_campaign = {}, dict(campaign)
    for label, part in parts.items():
        if label in named:
            of_standards[label] = part
        elif known:
            of_standards[f"{entry.get('model', '')} {entry['serial']} {entry['certificate']}: {label}".strip()] = part
        else:
            of_campaign[f"{role}: {label}"] = part
    return Common(standards=of_standards, campaign=of_campaign)


def expired(material: Material, role: str, ranges_A: Collection[float], quantities: Collection[str]) -> list[Evidence]:
    """Return evidence against what was measured with ranges whose specification did not hold until the end.

    Nothing where a session does not say when it was taken, or a register states no age.
    """
    if material.utc_offset_s is None or not material.rows:
        return []
    end_s = material.utc_offset_s + 1e-9 * max(row.window.t_end_ns for row in material.rows)
    gone = [
        entry
        for entry in outlived(material.standards, role, end_s)
        if any(math.isclose(entry.range_A, range_A, rel_tol=1e-6) for range_A in ranges_A)
    ]
    if not gone:
        return []
    days = gone[0].had_s / 86_400.0 if math.isfinite(gone[0].had_s) else None
    sentence = say("standard.expired", what=outlived_text(gone))
    return [Evidence("specification_expired", sentence, days, 0.0, quantities=quantities)]  # no chance makes a date


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
    Source: docs/method-af-converter.md.
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
