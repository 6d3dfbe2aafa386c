"""Declaration of GNC modules and inertial measurement units.

Sections of a sequence about a GNC module, the sensors of its data sheet, and of a mapping about the log of an
inertial measurement unit: its sensors, its named stretches, its site.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from bench.model.declaration import (
    AnalysisDeclaration,
    CoefficientsDeclaration,
    Hint,
    Limit,
    Log,
    LogColumn,
    LogSections,
    System,
    UnitSections,
)
from bench.model.units import known_unit, quantity
from bench.model.yamlio import Name, StrictModel

Shown = str | tuple[str, int]  # by a record of a calibration: the axis that is up, or an axis and the sense of its turn
AXES = ("x", "y", "z")
UPS = tuple(f"{sign}{axis}" for axis in AXES for sign in "+-")
TURNS = tuple((axis, sign) for axis in AXES for sign in (1, -1))
SIX_POSITION, MULTI_POSITION, STRAPDOWN = "imu_six_position", "imu_multi_position", "imu_strapdown"
BIAS, MAGNETOMETER = "bias_log", "magnetometer_log"
_UNITS = {"gyro": ("deg/s", "1"), "accelerometer": ("m/s2", "g", "1"), "magnetometer": ("gauss", "1")}
_IN_NAMES = {"deg/s": "deg_s", "m/s2": "m_s2", "g": "g", "gauss": "gauss", "1": "counts"}
_LOGS: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...]], ...] = (  # module, methods, triads
    (SIX_POSITION, "six_position", ("least_squares",), ("accelerometer",)),
    (MULTI_POSITION, "multi_position", ("norm",), ("accelerometer",)),
    (STRAPDOWN, "strapdown", ("indicated", "calibrated"), ("gyro", "accelerometer")),
    (BIAS, "bias", ("allan",), ()),
    (MAGNETOMETER, "magnetometer", ("ellipsoid", "turn_about_z"), ("magnetometer",)),
)
_DUE = {name: triads for name, *_, triads in _LOGS}
ANALYSES = tuple(_DUE)


@dataclass(frozen=True)
class Sensor:
    """Three sensors of a kind. ``prefix``: of columns and quantities.   ``unit``: of the outputs.

    ``range``, ``resolution``, ``walk``: constants of the campaign.   ``small_unit``: of biases in tables and figures,
    so many in a ``unit`` as ``small`` says.   Calibration: ``item`` of its records, ``due``: what those of a set show,
    ``bias_unit`` of its results, so many in a ``unit`` as ``bias_factor`` says; input = K N + ``bias_sign`` bias.
    """

    kind: str
    prefix: str
    unit: str
    range: str
    resolution: str
    walk: str = ""
    small_unit: str = ""
    small: float = 1.0
    item: str = ""
    due: Sequence[Shown] = ()
    bias_unit: str = ""
    bias_factor: float = 1.0
    bias_sign: int = 1


GYRO = Sensor(
    kind="gyro",
    prefix="gyro",
    unit="deg/s",
    range="gyro_range_deg_s",
    resolution="gyro_resolution_deg_s",
    walk="gyro_random_walk_deg_rt_s",
    small_unit="deg/h",
    small=3600.0,
    item="rotation",
    due=TURNS,
    bias_unit="deg/h",
    bias_factor=3600.0,
    bias_sign=-1,
)
ACCELEROMETER = Sensor(
    kind="accelerometer",
    prefix="accel",
    unit="g",
    range="accel_range_g",
    resolution="accel_resolution_g",
    walk="accel_random_walk_g_rt_s",
    small_unit="mg",
    small=1e3,
    item="position",
    due=UPS,
    bias_unit="g",
)
_OF_FIELD = Sensor("magnetometer", "mag", "gauss", "mag_range_gauss", "mag_resolution_gauss")
SENSORS: Mapping[str, Sensor] = {sensor.kind: sensor for sensor in (GYRO, ACCELEROMETER, _OF_FIELD)}
CALIBRATED = (ACCELEROMETER, GYRO)  # in the order of a report


class Wandering(StrictModel):
    """A part of a bias that wanders and returns: its standard deviation, and the time over which it is forgotten."""

    over: Annotated[float, *quantity("s", 1e-3, 1e7)]


class GyroWandering(Wandering):
    """Of a gyroscope."""

    size: Annotated[float, *quantity("deg/s", 0.0, 100.0)]


class AccelerometerWandering(Wandering):
    """Of an accelerometer."""

    size: Annotated[float, *quantity("g", 0.0, 10.0)]


class Imu(StrictModel):
    """Sensors of a GNC module, as its data sheet declares them; their noise is needed for predictions only."""

    gyro_range: Annotated[float, *quantity("deg/s", 1e-3, 1e5)]
    gyro_resolution: Annotated[float, *quantity("deg/s", 0.0, 100.0)]
    accelerometer_range: Annotated[float, *quantity("g", 1e-3, 1e5)]
    accelerometer_resolution: Annotated[float, *quantity("g", 0.0, 10.0)]
    magnetometer_range: Annotated[float, *quantity("gauss", 1e-3, 1e3)]
    magnetometer_resolution: Annotated[float, *quantity("gauss", 0.0, 10.0)]
    gyro_random_walk: Annotated[float, *quantity("deg/sqrt(s)", 0.0, 100.0)] | None = Field(
        None, description="white noise of the rate, such as 0.3 deg/sqrt(h)"
    )
    accelerometer_random_walk: Annotated[float, *quantity("g/sqrt(Hz)", 0.0, 10.0)] | None = Field(
        None, description="white noise of the specific force, such as 100 ug/sqrt(Hz)"
    )
    magnetometer_noise: Annotated[float, *quantity("gauss", 0.0, 10.0)] | None = Field(
        None, description="standard deviation of a reading"
    )
    gyro_wandering: list[GyroWandering] = Field(default=[], description="slow noise of the bias, by part")
    accelerometer_wandering: list[AccelerometerWandering] = Field(default=[], description="slow noise of the bias")

    def constants(self) -> dict[str, Any]:
        """Return them with their units in the names; noise that is not declared is left out."""
        noise = {
            "gyro_random_walk_deg_rt_s": self.gyro_random_walk,
            "accel_random_walk_g_rt_s": self.accelerometer_random_walk,
            "mag_noise_gauss": self.magnetometer_noise,
            "gyro_wandering": [[part.size, part.over] for part in self.gyro_wandering] or None,
            "accel_wandering": [[part.size, part.over] for part in self.accelerometer_wandering] or None,
        }
        return {name: value for name, value in noise.items() if value is not None} | {
            "gyro_range_deg_s": self.gyro_range,
            "gyro_resolution_deg_s": self.gyro_resolution,
            "accel_range_g": self.accelerometer_range,
            "accel_resolution_g": self.accelerometer_resolution,
            "mag_range_gauss": self.magnetometer_range,
            "mag_resolution_gauss": self.magnetometer_resolution,
        }


class ModuleUnit(UnitSections):
    """Sections of ``uut``."""

    imu: Imu | None = Field(None, description="inertial measurement unit and magnetometer of a GNC module")


class SensorColumn(LogColumn):
    """A column of numbers of one axis of a triad of gyroscopes, accelerometers or magnetometers."""

    role: Literal["gyro", "accelerometer", "magnetometer"]
    axis: Literal["x", "y", "z"]
    unit: Annotated[str, AfterValidator(known_unit)] = Field(description="of the numbers in the file; 1 for raw counts")

    @property
    def quantity(self) -> str:
        """Name of the column in series and results, such as ``gyro_x_deg_s`` or ``accel_z_counts``."""
        return f"{SENSORS[self.role].prefix}_{self.axis}_{_IN_NAMES.get(self.dimension, self.dimension)}"

    def more(self) -> dict[str, str]:
        """Return what the manifest says of the column beside header, quantity, role and unit."""
        return {"axis": self.axis}


HINTS = (
    Hint(
        "gyro",
        r"gyr|angular_velocity|omega|(^|_|\.)w_?(rs_s_)?[xyz](?![a-z])|(^|_)g[xyz]$|(^|\.)wb\[",
        by_axis=True,
        analysis="bias_log",
    ),
    Hint(
        "accelerometer",
        r"acc|specific_force|(^|_|\.)a_?(rs_s_)?[xyz](?![a-z])|(^|\.)fb\[",
        units=(("g", 0.5, 2.0), ("m/s2", 5.0, 20.0), ("mg", 500.0, 2000.0)),
        by_axis=True,
        analysis="bias_log",
    ),
    Hint(
        "magnetometer",
        r"(?<!i)mag|(^|_)m_?[xyz](?![a-z])|(^|_)b_?[xyz]$",
        units=(("gauss", 0.1, 0.8), ("uT", 8.0, 80.0), ("mgauss", 100.0, 800.0), ("nT", 8e3, 8e4)),
        by_axis=True,
        analysis="magnetometer_log",
    ),
)


class Segment(StrictModel):
    """A stretch of rows in which something was done: rest with one axis up, or a turn about one axis."""

    rows: tuple[Annotated[int, Field(strict=True, ge=0)], Annotated[int, Field(strict=True, ge=0)]] = Field(
        description="first and last row, both included; rows are counted from 0"
    )
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None = Field(
        None, description="axis that points up in this rest, so that it reads +g (or -g)"
    )
    axis: Literal["x", "y", "z"] | None = Field(None, description="axis about which the unit is turned")
    turn: Annotated[float, *quantity("deg", -360_000.0, 360_000.0)] | None = Field(
        None, description="angle of the turn, right-handed about the axis, such as -360 deg"
    )

    def campaign(self, label: str) -> dict[str, Any]:
        """As it stands in the manifest of an imported session."""
        entry: dict[str, Any] = {"label": label, "first": self.rows[0], "last": self.rows[1]}
        if self.up is not None:
            return entry | {"item": "position", "up": self.up}
        return entry | {"item": "rotation", "axis": self.axis, "turn_deg": self.turn}


class LogSite(StrictModel):
    """Where the log was taken."""

    gravity: Annotated[float, *quantity("m/s2", 9.7, 9.9)] = Field(description="local gravity, such as 9.80665 m/s2")
    latitude: Annotated[float, *quantity("deg", -90.0, 90.0)] | None = None
    azimuth: Annotated[float, *quantity("deg", -360.0, 360.0)] | None = None

    def campaign(self) -> dict[str, float | None]:
        """As it stands in the manifest of an imported session."""
        return {"gravity_m_s2": self.gravity, "latitude_deg": self.latitude, "azimuth_deg": self.azimuth}


class SensorLog(LogSections):
    """Sections of a mapping."""

    analyses: ClassVar[tuple[str, ...]] = ANALYSES

    segments: dict[Name, Segment] = Field(default_factory=dict, description="named stretches of rows of an IMU's log")
    site: LogSite | None = None

    def check_log(self, log: Log) -> None:
        """Check that sensors and segments fit together, and that the analysis has what it needs. Raises: ValueError."""
        sensors = _sensors(log)
        _check_sensors(sensors)
        _check_segments(self.segments, sensors.values())
        if log.analysis in ANALYSES:
            _check_needs(self, log.analysis, sensors.values())

    def log_constants(self, log: Log) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign", none for a log without sensors."""
        if not _sensors(log):
            return {}
        return {
            "segments": [segment.campaign(label) for label, segment in self.segments.items()],
            "site": {} if self.site is None else self.site.campaign(),
            "rate_Hz": log.rate_Hz,
        }

    def beyond(self, rows: int) -> tuple[tuple[str, ...], str, str] | None:
        """Return the first segment that ends outside of a log of so many rows: its place, what is wrong, what to do."""
        for label, segment in self.segments.items():
            if segment.rows[1] >= rows:
                message = f"the segment {label!r} ends at row {segment.rows[1]}, the last row of the log is {rows - 1}"
                cure = "count rows from 0, without the line of column names; both ends are included"
                return ("segments", label, "rows"), message, cure
        return None


def _sensors(log: Log) -> Mapping[str, SensorColumn]:
    return {header: column for header, column in log.values.items() if isinstance(column, SensorColumn)}


def _check_sensors(sensors: Mapping[str, SensorColumn]) -> None:
    for header, sensor in sensors.items():
        if sensor.dimension not in _UNITS[sensor.role]:
            due = ", ".join(_UNITS[sensor.role])
            raise ValueError(f"column {header!r}: a {sensor.role} needs a unit of {due}, not {sensor.unit!r}")
    for role in SENSORS:
        units = {sensor.dimension for sensor in sensors.values() if sensor.role == role}
        if len(units) > 1:
            raise ValueError(f"the columns of the role {role} have different units: {', '.join(sorted(units))}")


def _check_segments(segments: Mapping[str, Segment], sensors: Collection[SensorColumn]) -> None:
    for label, segment in segments.items():
        first, last = segment.rows
        if last < first:
            raise ValueError(f"segment {label!r}: the last row {last} stands before the first one {first}")
        turned = segment.axis is not None
        if turned == (segment.up is not None) or turned != (segment.turn is not None) or segment.turn == 0.0:
            raise ValueError(f"segment {label!r} needs either 'up', or 'axis' and a 'turn' other than 0 deg")
    if segments and not sensors:
        raise ValueError("segments need columns of the role gyro or accelerometer")


def _check_needs(log: SensorLog, name: str, sensors: Collection[SensorColumn]) -> None:
    for role in _DUE[name]:
        there = {sensor.axis for sensor in sensors if sensor.role == role}
        if missing := [axis for axis in AXES if axis not in there]:
            article = "an" if role == "accelerometer" else "a"
            raise ValueError(f"the analysis {name!r} needs {article} {role} column of the axis {missing[0]}")
    if name == BIAS and not any(sensor.role in ("gyro", "accelerometer") for sensor in sensors):
        raise ValueError(f"the analysis {name!r} needs a column of the role gyro or accelerometer")
    if name in (BIAS, MAGNETOMETER):
        return
    if log.site is None:
        raise ValueError(f"the analysis {name!r} needs 'site' with the local gravity")
    if name == SIX_POSITION:
        ups = {segment.up for segment in log.segments.values()}
        if absent := [up for up in UPS if up not in ups]:
            raise ValueError(f"the analysis {name!r} needs a segment with 'up: {absent[0]}'")


_HERE = "bench.systems.gnc"
_TAKEN = f"{_HERE}.assumptions"
_POSE = ("item", "mounting", "outer_deg", "middle_deg", "inner_deg")
_TRIADS = ("tick", "gyro", "accel", "temperature")
_FOUND = ("accel_bias", "accel_scale_error", "gyro_bias", "gyro_scale_error")
_INERTIAL = ("time", "gyro", "accelerometer")
_ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")
_DIMENSIONS = {
    "width": "m",
    "depth": "m",
    "height": "m",
    "supply_voltage": "V",
    "supply_voltage_deviation": "1",
    "supply_current": "A",
    "supply_current_deviation": "1",
    "timer_interval_error": "1",
    "timer_ticks": "1",
    "gyro_at_rest": "deg/s",
    "acceleration_error": "g",
    "imu_temperature_low": "degC",
    "imu_temperature_high": "degC",
    "horizontal_error": "m",
    "height_error": "m",
    "gps_satellites": "1",
    "ad_tolerance": "1",
    "ad_ground": "V",
    "ad_field_low": "gauss",
    "ad_field_high": "gauss",
    "gyro_bias_stability": "deg/s",
    "accel_bias_stability": "g",
    "gyro_cross_coupling": "1",
    "accel_cross_coupling": "1",
    "gyro_scale_repeatability": "1",
    "accel_scale_repeatability": "1",
    "roll_error": "deg",
}

DECLARATION = System(
    name="gnc",
    analyses=(
        AnalysisDeclaration(
            "gnc_unit_test",
            f"{_HERE}.unit_test.analysis",
            ("exchanges",),
            made_of="tests",
            items=_ITEMS,
            page="docs/method-gnc.md",
            predicted=f"{_HERE}.predicted:of_unit_test",
        ),
        AnalysisDeclaration(
            "imu_calibration",
            f"{_HERE}.calibration.analysis",
            ("least_squares",),
            made_of="samples",
            conditions=_POSE,
            fields=_TRIADS,
            main=(*_FOUND, "accel_cross_coupling", "gyro_cross_coupling"),
            assumptions=f"{_TAKEN}:of_calibration",
            predicted=f"{_HERE}.predicted:of_calibration",
            design=f"{_HERE}.calibration.design:design",
        ),
        AnalysisDeclaration(
            "imu_bias",
            f"{_HERE}.bias",
            ("ten_second_means",),
            made_of="samples",
            conditions=_POSE,
            fields=_TRIADS,
            main=("gyro_bias", "accel_bias", "gyro_bias_stability", "accel_bias_stability"),
            sizes=("gyro_bias_stability", "accel_bias_stability"),
            assumptions=f"{_TAKEN}:of_bias",
            predicted=f"{_HERE}.predicted:of_bias",
        ),
        AnalysisDeclaration(
            "magnetometer",
            f"{_HERE}.magnetometer",
            ("ellipse", "extremes"),
            made_of="samples",
            conditions=(*_POSE, "rate_deg_s"),
            main=("mag_offset", "mag_gain", "mag_angle"),
            assumptions=f"{_TAKEN}:of_magnetometer",
            predicted=f"{_HERE}.predicted:of_magnetometer",
            fields=("tick", "mag", "temperature"),
        ),
        *(
            AnalysisDeclaration(
                name,
                f"{_HERE}.logs.{module}",
                methods,
                "logs",
                roles=("time", "magnetometer") if name == MAGNETOMETER else _INERTIAL,
                triads=triads,
            )
            for name, module, methods, triads in _LOGS
        ),
    ),
    limits={name: Limit(dimension) for name, dimension in _DIMENSIONS.items()},
    unit=ModuleUnit,
    log=SensorLog,
    log_columns=(SensorColumn,),
    log_hints=HINTS,
    coefficients=CoefficientsDeclaration("an IMU", f"{_HERE}.coefficients", f"{_HERE}.coefficients:header_text"),
)
