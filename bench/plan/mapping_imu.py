"""What a mapping says of the log of an inertial measurement unit: its sensors, its named stretches, its site."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from bench.model.units import quantity, read_quantity
from bench.model.yamlio import StrictModel

AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
UPS: tuple[str, ...] = ("+x", "-x", "+y", "-y", "+z", "-z")
SIX_POSITION, MULTI_POSITION, STRAPDOWN = "imu_six_position", "imu_multi_position", "imu_strapdown"
ANALYSES = (SIX_POSITION, MULTI_POSITION, STRAPDOWN)
_WORDS = {"gyro": "gyro", "accelerometer": "accel"}
_UNITS = {"gyro": ("deg/s", "1"), "accelerometer": ("m/s2", "g", "1")}
_IN_NAMES = {"deg/s": "deg_s", "m/s2": "m_s2", "g": "g", "1": "counts"}


def _unit(text: str) -> str:
    if read_quantity(f"1 {text}") is None:
        raise ValueError(f"{text!r} is no unit; write one such as deg/s, deg/h, m/s2, g, mg, or 1 for counts")
    return text


class SensorColumn(StrictModel):
    """A column of numbers of one axis of a gyroscope or an accelerometer triad."""

    role: Literal["gyro", "accelerometer"]
    axis: Literal["x", "y", "z"]
    unit: Annotated[str, AfterValidator(_unit)] = Field(description="of the numbers in the file; 1 for raw counts")

    @property
    def factor(self) -> float:
        """What a number of the file is multiplied by."""
        return _read(self.unit)[0]

    @property
    def dimension(self) -> str:
        """Base unit of the values."""
        return _read(self.unit)[1]

    @property
    def quantity(self) -> str:
        """Name of the column in series and results, such as ``gyro_x_deg_s`` or ``accel_z_counts``."""
        return f"{_WORDS[self.role]}_{self.axis}_{_IN_NAMES.get(self.dimension, self.dimension)}"


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
        found: dict[str, Any] = {"label": label, "first": self.rows[0], "last": self.rows[1]}
        if self.up is not None:
            return found | {"item": "position", "up": self.up}
        return found | {"item": "rotation", "axis": self.axis, "turn_deg": self.turn}


class LogSite(StrictModel):
    """Where the log was taken."""

    gravity: Annotated[float, *quantity("m/s2", 9.7, 9.9)] = Field(description="local gravity, such as 9.80665 m/s2")
    latitude: Annotated[float, *quantity("deg", -90.0, 90.0)] | None = None
    azimuth: Annotated[float, *quantity("deg", -360.0, 360.0)] | None = None

    def campaign(self) -> dict[str, float | None]:
        """As it stands in the manifest of an imported session."""
        return {"gravity_m_s2": self.gravity, "latitude_deg": self.latitude, "azimuth_deg": self.azimuth}


def check_sensors(sensors: Mapping[str, SensorColumn]) -> None:
    """Whether the sensors fit together. Raises ValueError."""
    for header, one in sensors.items():
        if one.dimension not in _UNITS[one.role]:
            due = ", ".join(_UNITS[one.role])
            raise ValueError(f"column {header!r}: a {one.role} needs a unit of {due}, not {one.unit!r}")
    for role in _WORDS:
        units = {one.dimension for one in sensors.values() if one.role == role}
        if len(units) > 1:
            raise ValueError(f"the columns of the role {role} have different units: {', '.join(sorted(units))}")


def check_segments(segments: Mapping[str, Segment], sensors: Collection[SensorColumn], bad_rows: float) -> None:
    """Whether segments can be meant as they are written. Raises ValueError."""
    for label, one in segments.items():
        if one.rows[1] < one.rows[0]:
            raise ValueError(f"segment {label!r}: the last row {one.rows[1]} stands before the first one {one.rows[0]}")
        if (one.up is None) == (one.axis is None) or (one.axis is None) != (one.turn is None) or one.turn == 0.0:
            raise ValueError(f"segment {label!r} needs either 'up', or 'axis' and a 'turn' other than 0 deg")
    if segments and not sensors:
        raise ValueError("segments need columns of the role gyro or accelerometer")
    if segments and bad_rows:
        raise ValueError("segments count rows, so no row may be left out; remove 'bad_rows'")


def check_analysis(
    name: str, sensors: Collection[SensorColumn], segments: Mapping[str, Segment], site: LogSite | None
) -> None:
    """Whether an analysis of an IMU has what it needs. Raises ValueError."""
    for role in _WORDS if name == STRAPDOWN else ("accelerometer",):
        there = {one.axis for one in sensors if one.role == role}
        if missing := [axis for axis in AXES if axis not in there]:
            what = f"{'a gyro' if role == 'gyro' else 'an accelerometer'} column of the axis {missing[0]}"
            raise ValueError(f"the analysis {name!r} needs {what}")
    if site is None:
        raise ValueError(f"the analysis {name!r} needs 'site' with the local gravity")
    if name == SIX_POSITION:
        ups = {one.up for one in segments.values()}
        if absent := [up for up in UPS if up not in ups]:
            raise ValueError(f"the analysis {name!r} needs a segment with 'up: {absent[0]}'")


def _read(unit: str) -> tuple[float, str]:
    found = read_quantity(f"1 {unit}")
    assert found is not None
    return found
