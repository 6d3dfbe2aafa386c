"""The sequence language: what a file in sequences/ may say (docs/sequences.md is the user's description)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, create_model, model_validator

from bench.model.declaration import System, UnitSections
from bench.model.systems import fields_of, systems, systems_named, with_sections
from bench.model.units import quantity, read_stated
from bench.model.yamlio import NAME_PATTERN, Name, StrictModel
from bench.plan.language.expect import Fit
from bench.plan.language.interlocks import Interlock
from bench.plan.language.steps import Step_, TimelineEntry
from bench.plan.values import Scalar

Title = Annotated[str, StringConstraints(max_length=200)]
ChannelNumbers = int | str
Share = Annotated[float, *quantity("1", 0.0, 1.0)]


class Early(StrictModel):
    """The section ``early`` of a sequence. Durations in second, shares as numbers."""

    after: Annotated[float, *quantity("s", 1.0, 1e6)] = Field(3600.0, description="first verdict after this time")
    every: Annotated[float, *quantity("s", 1.0, 1e6)] = Field(3600.0, description="then one each")
    on_fail: Literal["warn", "hold", "abort"] = "warn"
    max_lost: Share = Field(0.001, description="largest share of frames that may be missing")
    max_bad: Share = Field(0.001, description="largest share of frames that may be damaged")
    max_dispersion: float = Field(5.0, gt=0, description="largest change of a repeated point, in its own sigma")
    max_residual: float = Field(6.0, gt=0, description="largest residual of a partial fit, in its own sigma")


def _limit(text: object) -> object:
    read_stated(text, "10 deg/h")
    return text


def _spread(text: object) -> object:
    if not 0.0 < read_stated(text, "10 deg/h")[0] < math.inf:
        raise ValueError(f"{text!r} is no standard deviation: it is above zero, for example '25 ppm'")
    return text


class UnitUnderTest(StrictModel):
    """The unit under test as its data sheet declares it; the systems that are installed add their sections."""

    model: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")]
    serial: Title = Field(description="serial number, or a parameter such as '{serial}'")
    limits: dict[Name, Annotated[str, BeforeValidator(_limit)]] = Field(
        default_factory=dict, description="limits of the data sheet by name, each with its unit"
    )
    spread: dict[Name, Annotated[str, BeforeValidator(_spread)]] = Field(
        default_factory=dict,
        description="standard deviation of the true values of such units, by quantity, each with its unit",
    )


class CheckStandard(StrictModel):
    """A unit of known history on a channel of its own: its results are charted and are not those of the unit."""

    model: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")]
    serial: Title
    channel: int = Field(ge=1)


class MagneticField(StrictModel):
    """The magnetic field of the place, as a model of the Earth's field or a survey gives it."""

    size: Annotated[float, *quantity("gauss", 0.01, 100.0)]
    inclination: Annotated[float, *quantity("deg", -90.0, 90.0)] = Field(description="positive below the horizon")
    declination: Annotated[float, *quantity("deg", -180.0, 180.0)] = Field(description="positive east of north")


class Site(StrictModel):
    """Where the bench stands: what the Earth does to gyroscopes and accelerometers there."""

    latitude: Annotated[float, *quantity("deg", -90.0, 90.0)] = Field(description="positive north")
    longitude: Annotated[float, *quantity("deg", -180.0, 180.0)] | None = Field(None, description="positive east")
    height: Annotated[float, *quantity("m", -500.0, 9000.0)] | None = None
    gravity: Annotated[float, *quantity("m/s2", 9.7, 9.9)]
    azimuth: Annotated[float, *quantity("deg", -360.0, 360.0)] = Field(
        description="of the turntable's inner axis with all axes at zero, from north, positive east"
    )
    azimuth_uncertainty: Annotated[float, *quantity("deg", 0.0, 90.0)] | None = Field(
        None, description="standard uncertainty of the azimuth, as surveyed"
    )
    tilt: Annotated[float, *quantity("deg", 0.0, 5.0)] | None = Field(
        None, description="standard uncertainty of the unit's attitude in a pose, about each axis: table and fixture"
    )
    magnetic_field: MagneticField | None = Field(None, description="needed for predictions of a magnetometer only")


def _hexadecimal(text: str) -> str:
    bytes.fromhex(text)
    return text


class UnitCommand(StrictModel):
    """A command the unit under test takes: its number and its payload, bytes in hexadecimal."""

    code: int = Field(ge=0, le=255)
    payload: Annotated[str, StringConstraints(max_length=400), AfterValidator(_hexadecimal)] = ""


class ChannelGroup(StrictModel):
    """Channels that are alike: the same kind and the same levels, if they have any."""

    numbers: ChannelNumbers | list[ChannelNumbers] = Field(description="a number, a range such as 1-6, or a list")
    kind: Literal["gyro", "accelerometer"]
    levels: Name | None = Field(None, description="name of a table of currents; none for channels that stay open")


class Procedure(StrictModel):
    """Steps with a name. Arguments have a default, or ``required``."""

    arguments: dict[Name, Scalar] = Field(default_factory=dict)
    do: list[Step_] = Field(min_length=1)


class Decision(StrictModel):
    """How a value is judged against its limit (ILAC-G8:09/2019)."""

    rule: Literal["simple", "guard_band", "non_binary"] = "non_binary"


StationName = Annotated[str, StringConstraints(pattern=rf"^({NAME_PATTERN}|[^\x00-\x1f]{{1,400}}\.yaml)$")]


class Sequence(StrictModel):
    """One campaign."""

    sequence: Name
    title: Title = ""
    station: StationName = Field(description="name of a station, or path of its file from the folder of this one")
    frame: dict[Name, Name] = Field({}, description="link: frame definition; records count the first link")
    analysis: Name = "none"
    reference_temperature: Annotated[float, *quantity("degC", -273.15, 1000.0)] = 20.0
    decision: Decision = Decision()
    duration: Annotated[float, *quantity("s", 0.0)] | None = Field(None, description="the plan must last exactly this")
    records: int | None = Field(None, ge=0, description="the campaign must hold exactly this many records")
    uut: UnitUnderTest | None = None
    units: list[Title] | Title | None = Field(
        None, description="serial numbers of the units in the station's slots A, B ..., '' for an empty slot"
    )
    check_standard: CheckStandard | None = Field(None, description="measured in every campaign beside the unit")
    site: Site | None = Field(None, description="where the bench stands, for the analyses of inertial sensors")
    unit_commands: dict[Name, UnitCommand] = Field(default_factory=dict)
    parameters: dict[Name, Scalar | list[Scalar]] = Field({}, description="what --set may change")
    tables: dict[Name, list[Scalar]] = Field(default_factory=dict)
    channels: list[ChannelGroup] = Field(default_factory=list)
    prepare: list[Step_] = Field(default_factory=list)
    steps: list[Step_] = Field(default_factory=list)
    timeline: list[TimelineEntry] = Field(default_factory=list)
    finally_: list[Step_] = Field([], alias="finally")
    procedures: dict[Name, Procedure] = Field(default_factory=dict)
    interlocks: dict[Name, Interlock] = Field({}, description="wins over one of the station with the same name")
    early: Early | None = None
    fits: list[Fit] = Field([], description="polynomials of the values that the sequence reads")

    @model_validator(mode="after")
    def _one_form(self) -> Sequence:
        if bool(self.steps) == bool(self.timeline):
            raise ValueError("a sequence has either 'steps' (structured form) or 'timeline' (flat form)")
        return self


def sequence_model() -> type[Sequence]:
    """Return the language with the sections of all systems that can be used; a key that nobody declares is refused.

    Raises: InstallationError B-PKG-001 if two systems declare one section.
    """
    return _language(_sections(systems()))


def language_of_sequence(tree: object) -> type[Sequence]:
    """Return the language of one sequence: with the sections of the bench and of the foreign systems that it names.

    Args:   tree: plain values of its file.
    Raises: InstallationError B-PKG-001 if two systems declare one section, or as ``systems_named``.
    """
    stated = tree if isinstance(tree, dict) else {}
    unit = stated.get("uut")
    keys = {*(unit if isinstance(unit, dict) else ())} - {*UnitUnderTest.model_fields}
    named = systems_named(stated.get("analysis"), keys, lambda system: fields_of(system.unit))
    return _language(_sections(named))


def _sections(systems: Iterable[System]) -> tuple[type[UnitSections], ...]:
    return tuple(system.unit for system in systems if system.unit is not None)


@cache
def _language(sections: tuple[type[UnitSections], ...]) -> type[Sequence]:
    bases = with_sections(UnitUnderTest, sections)
    unit: Any = create_model(
        "UnitUnderTest", __base__=bases, __doc__="The unit under test as its data sheet declares it."
    )
    return create_model("Sequence", __base__=Sequence, __doc__=Sequence.__doc__, uut=(unit | None, None))
