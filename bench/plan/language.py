"""The sequence language: what a file in sequences/ may say (docs/sequences.md is the user's description)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, model_validator

from bench.model.units import quantity, read_quantity
from bench.model.yamlio import StrictModel
from bench.plan.interlock_language import Interlock
from bench.plan.language_steps import Step_, TimelineEntry
from bench.plan.templated import Name, Scalar

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


def _sensor(text: str) -> str:
    found = read_quantity(text)
    if found is None or found[1] not in ("deg/s", "g") or found[0] <= 0:
        raise ValueError(f"{text!r} is not a positive rate or acceleration, for example '83 deg/s' or '20 g'")
    return text


def _limit(text: object) -> object:
    if not isinstance(text, str) or read_quantity(text) is None:
        raise ValueError(f"{text!r} is not a quantity with its unit, for example '10 deg/h'")
    return text


class Imu(StrictModel):
    """Ranges and resolutions of the sensors of a GNC module, as its data sheet declares them."""

    gyro_range: Annotated[float, *quantity("deg/s", 1e-3, 1e5)]
    gyro_resolution: Annotated[float, *quantity("deg/s", 0.0, 100.0)]
    accelerometer_range: Annotated[float, *quantity("g", 1e-3, 1e5)]
    accelerometer_resolution: Annotated[float, *quantity("g", 0.0, 10.0)]
    magnetometer_range: Annotated[float, *quantity("gauss", 1e-3, 1e3)]
    magnetometer_resolution: Annotated[float, *quantity("gauss", 0.0, 10.0)]


class Inertial(StrictModel):
    """Noise and biases of an inertial measurement unit, one sigma, as its data sheet declares them."""

    accelerometer_bias: Annotated[float, *quantity("g", 1e-9, 1.0)]
    velocity_walk_per_rtHz: Annotated[float, *quantity("g", 1e-9, 1.0)] = Field(description="density of the noise")
    gyro_bias: Annotated[float, *quantity("deg/s", 1e-9, 10.0)]
    angle_walk_per_rth: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="after one hour")


class Egi(StrictModel):
    """Errors of the solution of an EGI, one sigma per axis; that of its position is in its frames."""

    velocity: Annotated[float, *quantity("m/s", 1e-6, 100.0)]
    level: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="of roll and pitch")
    heading: Annotated[float, *quantity("deg", 1e-6, 90.0)]
    wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a velocity is off by the same")
    heading_wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a heading is")


class Latency(StrictModel):
    """From the validity of a sample to the first byte of its frame, as the makers of both units state it."""

    egi: Annotated[float, *quantity("s", 0.0, 1.0)]
    imu: Annotated[float, *quantity("s", 0.0, 1.0)]
    uncertainty: Annotated[float, *quantity("s", 1e-9, 1.0)] = Field(description="standard uncertainty of either")


class Kind(StrictModel):
    """Declared constants of one kind of converter channel (AF-converter design table)."""

    k0: Annotated[float, *quantity("C", 1e-12, 1.0)] = Field(description="nominal charge per pulse")
    full_scale: Annotated[float, *quantity("A", 1e-9, 10.0)]
    sensor_full_scale: Annotated[str, AfterValidator(_sensor)] = Field(description="sensor's full scale in deg/s or g")
    stability_limit: Annotated[float, *quantity("1", 0.0, 1.0)]
    bias_stability_limit: Annotated[float, *quantity("A", 0.0, 1.0)] | None = Field(
        None, description="how far the bias may be from what compensates it"
    )
    white_noise_per_rtHz: Annotated[float, *quantity("A", 0.0, 1.0)] | None = Field(
        None, description="white noise of the input current, one sigma, per root hertz"
    )
    bias_walk_per_rth: Annotated[float, *quantity("A", 0.0, 1.0)] | None = Field(
        None, description="random walk of the bias, one sigma, per root hour"
    )


class UnitUnderTest(StrictModel):
    """The unit under test as its data sheet declares it."""

    model: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")]
    serial: Title = Field(description="serial number, or a parameter such as '{serial}'")
    af_clock: Annotated[float, *quantity("Hz", 1.0, 1e9)] | None = Field(None, description="of an AF converter")
    master_clock: Annotated[float, *quantity("Hz", 1.0, 1e10)] | None = None
    function_generator: Annotated[float, *quantity("Hz", 1.0, 1e10)] | None = None
    temperature_sensor_uncertainty: Annotated[float, *quantity("degC", 0.0, 10.0)] | None = Field(
        None, description="expanded uncertainty of the unit's own temperature sensor, 95 %"
    )
    kinds: dict[Literal["gyro", "accelerometer"], Kind] = Field(default_factory=dict)
    imu: Imu | None = Field(None, description="inertial measurement unit and magnetometer of a GNC module")
    inertial: Inertial | None = Field(None, description="what a navigation filter is told of the inertial sensors")
    egi: Egi | None = Field(None, description="what is known of the errors of an EGI that serves as reference")
    latency: Latency | None = Field(None, description="of two units that stream side by side")
    limits: dict[Name, Annotated[str, BeforeValidator(_limit)]] = Field(
        default_factory=dict, description="limits of the data sheet by name, each with its unit"
    )


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


class Sequence(StrictModel):
    """One campaign."""

    sequence: Name
    title: Title = ""
    station: Name
    frame: dict[Name, Name] = Field({}, description="link: frame definition; records count the first link")
    analysis: Name = "none"
    reference_temperature: Annotated[float, *quantity("degC", -273.15, 1000.0)] = 20.0
    decision: Decision = Decision()
    duration: Annotated[float, *quantity("s", 0.0)] | None = Field(None, description="the plan must last exactly this")
    records: int | None = Field(None, ge=0, description="the campaign must hold exactly this many records")
    uut: UnitUnderTest | None = None
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

    @model_validator(mode="before")
    @classmethod
    def _one_form(cls, value: Any) -> Any:
        if isinstance(value, dict) and bool(value.get("steps")) == bool(value.get("timeline")):
            raise ValueError("a sequence has either 'steps' (structured form) or 'timeline' (flat form)")
        return value
