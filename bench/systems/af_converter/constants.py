"""Converter constants and standards, as a scale-factor analysis reads them from the manifest of a session."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.readings import Converter, RangeSpecification

CALIBRATOR = "calibrator"
FUNCTION_GENERATOR = "function_generator"
METER = "dmm"
DRIFT_UNKNOWN = (
    "The uncertainty of the calibrator is for 24 hours; a drift over the campaign is not included, "
    "so the temperature coefficients (tc1, tc2) and the drift of channels are stated without it."
)
PLAUSIBLE_ERROR = 0.05  # of the nominal scale factor, where the sequence states nothing
_FG_RECTANGULAR_LIMIT = 3e-6  # paper section 4.1: stability of the function generator below 3 ppm


_Positive = Annotated[float, Field(gt=0)]
_NotNegative = Annotated[float, Field(ge=0)]


class _Tolerant(BaseModel):
    """Manifest sections may hold more than one analysis reads."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Noise(_Tolerant):
    """Declared noise of a converter; without it no uncertainty would be true, so there is no default."""

    white_A_rtHz: _NotNegative
    walk_A_rth: _NotNegative


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
    plausible_error: _Positive = PLAUSIBLE_ERROR


class Campaign(_Tolerant):
    """Constants of the campaign.

    ``previous``: estimates of an earlier calibration in contract form; ``temperature_sensor_u95_degC``: expanded
    uncertainty (95 %, k = 2) of the unit's own temperature sensor, None if not stated.
    """

    analysis: str
    reference_temperature_degC: float = 20.0
    af_clock_Hz: _Positive
    fg_Hz: _Positive = 1e7
    master_Hz: _Positive
    uut: Mapping[str, Any] = Field(default_factory=dict)
    channels: tuple[Channel, ...]
    temperature_sensor_u95_degC: _NotNegative | None = None
    previous: tuple[Mapping[str, Any], ...] = ()

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


@dataclass(frozen=True)
class Standards:
    """Uncertainties (standard, relative or ampere) and corrections of the standards that matter here.

    ``drift``: of the calibrator over the campaign; ``drift_source`` says who knows it. ``calibrator_dof``,
    ``generator_dof``: degrees of freedom of what their certificates state.
    """

    ranges: Mapping[float, RangeSpecification]
    traceability: float | None  # standard, relative; None = not stated
    drift: float | None
    function_generator: float
    notes: tuple[str, ...] = field(default=())
    drift_source: str = "standards register"
    calibrator_dof: float = math.inf
    generator_dof: float = math.inf

    @property
    def common_relative_ppm(self) -> float:
        """Return what stated traceability and drift of the calibrator add to each scale-factor error, standard, ppm."""
        return math.hypot(self.traceability or 0.0, self.drift or 0.0) * 1e6


def read_campaign(campaign: Mapping[str, Any]) -> Campaign:
    """Check the campaign section of a manifest. Raises FitError B-FIT-008 naming the first wrong field."""
    try:
        return Campaign.model_validate(campaign)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise FitError(
            "B-FIT-008",
            f"the campaign constants are not usable: {first['msg']}",
            where="manifest: campaign." + ".".join(str(part) for part in first["loc"]),
            next_step="check the campaign section of the sequence the session was made with",
        ) from error


def read_ranges(standards: Mapping[str, Mapping[str, Any]], role: str) -> dict[float, RangeSpecification]:
    """Return uncertainty (95 %, k = 2) and correction of each range of a standard, by full scale in ampere.

    Raises: FitError B-FIT-009 if the register has no such standard or one of its numbers is missing.
    """
    try:
        entry = standards[role]
        corrections = {float(correction["range_A"]): correction for correction in entry.get("corrections") or ()}
        return {
            float(uncertainty["range_A"]): RangeSpecification(
                relative=float(uncertainty["relative"]),
                floor_A=float(uncertainty["floor_A"]),
                gain=float(corrections.get(float(uncertainty["range_A"]), {}).get("gain", 0.0)),
                offset_A=float(corrections.get(float(uncertainty["range_A"]), {}).get("offset_A", 0.0)),
            )
            for uncertainty in entry["uncertainty"]
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _register_error(role, error) from error


def _register_error(role: str, error: Exception) -> FitError:
    return FitError(
        "B-FIT-009",
        f"the standards register does not say what the fit needs of the {role} ({error!r})",
        where=f"manifest: standards.{role}",
        next_step="give range, relative and floor of each range in the station file",
    )


def read_standards(standards: Mapping[str, Mapping[str, Any]]) -> Standards:
    """Read the register as it stood when the session was made; stated uncertainties are 95 %, k = 2.

    Raises: FitError B-FIT-009 if the calibrator or one of its numbers is missing.
    """
    ranges, generator = read_ranges(standards, CALIBRATOR), read_generator(standards)
    calibrator = standards[CALIBRATOR]
    traceability, drift = read_traceability(standards, CALIBRATOR), _half(calibrator, "drift_relative")
    notes = []
    if traceability is None:
        notes.append("The uncertainty of the calibrator is relative to its own calibration; that one is not included.")
    if drift is None:
        notes.append(DRIFT_UNKNOWN)
    degrees = read_dof(standards, CALIBRATOR), read_dof(standards, FUNCTION_GENERATOR)
    return Standards(ranges, traceability, drift, generator, tuple(notes), "standards register", *degrees)


def read_generator(standards: Mapping[str, Mapping[str, Any]]) -> float:
    """Relative standard uncertainty of the function generator; where the register states none, that of the paper.

    Raises: FitError B-FIT-009 if what it states is not usable.
    """
    try:
        return _function_generator(standards.get(FUNCTION_GENERATOR, {}))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise _register_error(FUNCTION_GENERATOR, error) from error


def read_traceability(standards: Mapping[str, Mapping[str, Any]], role: str) -> float | None:
    """Relative standard uncertainty of a standard's own calibration, None if the register does not state it."""
    return _half(standards[role], "traceability_relative")


def read_dof(standards: Mapping[str, Mapping[str, Any]], role: str) -> float:
    """Return degrees of freedom of what a standard's certificate states; infinite where the register states none.

    Raises: FitError B-FIT-009 for fewer than one, or what is no number.
    """
    stated = standards.get(role, {}).get("dof")
    try:
        degrees = math.inf if stated is None else float(stated)
        if not degrees >= 1.0:
            raise ValueError(f"{degrees:g} degrees of freedom, at least 1 is due")
    except (TypeError, ValueError) as error:
        raise _register_error(role, error) from error
    return degrees


def _half(entry: Mapping[str, Any], key: str) -> float | None:
    return None if entry.get(key) is None else float(entry[key]) / 2.0


def _function_generator(entry: Mapping[str, Any]) -> float:
    stated = entry.get("uncertainty") or ()
    own = float(stated[0]["relative"]) / 2.0 if stated else _FG_RECTANGULAR_LIMIT / math.sqrt(3.0)
    return math.hypot(own, _half(entry, "traceability_relative") or 0.0)
