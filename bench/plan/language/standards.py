"""The register of standards in a station file: certificates, uncertainties and specifications by range and age."""

from __future__ import annotations

from datetime import date
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from bench.model.declaration import stated
from bench.model.units import quantity, read_stated
from bench.model.yamlio import Name, StrictModel, characters

Words = Annotated[str, characters(200)]
Current = Annotated[float, *quantity("A", -10.0, 10.0)]
Fraction = Annotated[float, *quantity("1", -1.0, 1.0)]
Share = Annotated[float, *quantity("1", 0.0, 1.0)]  # of an uncertainty: never negative


def _date(value: object) -> date:
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is not a date; write YYYY-MM-DD")
    try:
        return date.fromisoformat(value)
    except ValueError as error:
        raise ValueError(f"{value!r} is not a date; write YYYY-MM-DD") from error


Date = Annotated[date, BeforeValidator(_date), WithJsonSchema({"type": "string", "format": "date"})]


Stated = Annotated[
    tuple[float, str],
    BeforeValidator(lambda text: read_stated(text, "100.02 ohm")),
    WithJsonSchema({"type": "string"}),
]


class RangeUncertainty(StrictModel):
    """Expanded uncertainty of one range, 95 % (k = 2): ``relative`` of the reading plus ``floor``.

    A relative specification is one against the standards of the calibration: the certificate's own U comes on top.
    """

    range: Current
    relative: Share
    floor: Annotated[float, *quantity("A", 0.0, 10.0)]
    specification: Literal["relative", "absolute"] | None = Field(
        None, description="whether the uncertainty of the instrument's own calibration is in it (absolute) or not"
    )
    age: Annotated[float, *quantity("s", 0.0)] | None = Field(
        None, description="after the calibration, up to which it holds"
    )
    certificate_U: Share | None = Field(
        None, description="expanded uncertainty that the certificate states, of the reading"
    )
    k: Annotated[float, Field(gt=0.0, le=20.0)] = Field(2.0, description="coverage factor of certificate_U")
    degrees_of_freedom: Annotated[float, Field(ge=1.0)] | None = Field(
        None, description="of certificate_U; without it those of the standard"
    )
    common_with: Words | None = Field(
        None, description="name of the error of calibration; ranges and standards with the same name share it in full"
    )

    @model_validator(mode="after")
    def _calibration_once(self) -> RangeUncertainty:
        if self.specification == "relative" and self.certificate_U is None:
            raise ValueError("a relative specification needs certificate_U, the uncertainty of the calibration itself")
        if self.specification != "relative" and self.certificate_U is not None:
            raise ValueError("certificate_U comes on top of a relative specification only; an absolute one holds it")
        if self.specification is None and self.common_with is not None:
            raise ValueError("common_with names the error of a specification that is 'relative' or 'absolute'")
        return self

    def told(self) -> dict[str, Any]:
        """Return it for the session's manifest, in base units."""
        more: dict[str, Any] = {
            "specification": self.specification,
            "age_s": self.age,
            "certificate_U": self.certificate_U,
            "k": None if self.certificate_U is None else self.k,
            "dof": self.degrees_of_freedom,
            "common_with": self.common_with,
        }
        return {"range_A": self.range, "relative": self.relative, "floor_A": self.floor, **stated(more)}


class RangeCorrection(StrictModel):
    """Known error of one range from the certificate: true = (1 + gain) x nominal + offset."""

    range: Current
    gain: Fraction
    offset: Current


class Specification(StrictModel):
    """Expanded uncertainty of what an action reads, 95 % (k = 2): ``relative`` of the reading plus ``floor``.

    It holds up to ``range``, where the instrument has ranges, and up to an ``age`` after the calibration.
    """

    reads: Name = Field(description="action of the driver, such as measure_voltage")
    range: Stated | None = None
    relative: Share = 0.0
    floor: Stated
    age: Annotated[float, *quantity("s", 0.0)] | None = None

    @model_validator(mode="after")
    def _one_dimension(self) -> Specification:
        if self.range is not None and self.range[1] != self.floor[1]:
            raise ValueError(f"the range is in {self.range[1]} and the floor in {self.floor[1]}")
        if self.floor[0] < 0.0:
            raise ValueError("an uncertainty is not negative")
        return self

    def told(self) -> dict[str, Any]:
        """Return it for the session's manifest, in base units."""
        more = {"range": None if self.range is None else self.range[0], "age_s": self.age}
        told = {"reads": self.reads, "unit": self.floor[1], "relative": self.relative, "floor": self.floor[0]}
        return told | stated(more)


class Standard(StrictModel):
    """Traceability of an instrument, or of a standard without an interface."""

    model: Words
    serial: Words
    certificate: Words
    calibrated: Date
    due: Date
    laboratory: Words | None = Field(None, description="who calibrated it; reports name it")
    uncertainty: list[RangeUncertainty] = Field(default_factory=list)
    corrections: list[RangeCorrection] = Field(default_factory=list)
    specifications: list[Specification] = Field(
        default_factory=list, description="what its readings are uncertain by, by action, range and age"
    )
    traceability: Share | None = Field(None, description="uncertainty of the calibrator's own calibration, 95 %")
    degrees_of_freedom: Annotated[float, Field(ge=1.0)] | None = Field(
        None, description="of the uncertainties that the certificate states; they are taken as exact without it"
    )
    drift: Share | None = Field(None, description="change over a campaign that must be expected, 95 %")
    stated: dict[Name, Stated] = Field(
        default_factory=dict, description="what else the certificate says, by name, each with its unit"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Standard:
        if self.due <= self.calibrated:
            raise ValueError(f"due {self.due} is not after calibrated {self.calibrated}")
        if self.traceability is not None and any(line.specification for line in self.uncertainty):
            raise ValueError("traceability stands for certificate_U of every range; state one of them")
        return self


def told_standard(driver: str, standard: Standard) -> dict[str, Any]:
    """Return the entry of a standard for the session's manifest, in SI base units."""
    entry: dict[str, Any] = {
        "driver": driver,
        "model": standard.model,
        "serial": standard.serial,
        "certificate": standard.certificate,
        "calibrated": standard.calibrated.isoformat(),
        "due": standard.due.isoformat(),
        "uncertainty": [line.told() for line in standard.uncertainty],
        "corrections": [{"range_A": c.range, "gain": c.gain, "offset_A": c.offset} for c in standard.corrections],
        "laboratory": standard.laboratory,
        "specifications": [specification.told() for specification in standard.specifications] or None,
        "traceability_relative": standard.traceability,
        "dof": standard.degrees_of_freedom,
        "drift_relative": standard.drift,
        "stated": {name: {"value": value, "unit": unit} for name, (value, unit) in standard.stated.items()} or None,
    }
    return stated(entry)
