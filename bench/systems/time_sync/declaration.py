"""The time offset between two navigation units as the engine knows it: analysis, study, and sections of the unit."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from bench.model.declaration import AnalysisDeclaration, Limit, Log, LogColumn, LogSections, System, UnitSections
from bench.model.units import known_unit, quantity
from bench.model.yamlio import Name, StrictModel


class Inertial(StrictModel):
    """Noise and biases of an inertial measurement unit, one sigma, as its data sheet declares them."""

    accelerometer_bias: Annotated[float, *quantity("g", 1e-9, 1.0)]
    velocity_walk_per_rtHz: Annotated[float, *quantity("g", 1e-9, 1.0)] = Field(description="density of the noise")
    gyro_bias: Annotated[float, *quantity("deg/s", 1e-9, 10.0)]
    angle_walk_per_rth: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="after one hour")

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {
            "accel_bias_g": self.accelerometer_bias,
            "velocity_walk_g_rtHz": self.velocity_walk_per_rtHz,
            "gyro_bias_deg_s": self.gyro_bias,
            "angle_walk_deg_rth": self.angle_walk_per_rth,
        }


class Egi(StrictModel):
    """Errors of the solution of an EGI, one sigma per axis; that of its position is in its frames."""

    velocity: Annotated[float, *quantity("m/s", 1e-6, 100.0)]
    level: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="of roll and pitch")
    heading: Annotated[float, *quantity("deg", 1e-6, 90.0)]
    wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a velocity is off by the same")
    heading_wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a heading is")

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {
            "velocity_m_s": self.velocity,
            "level_deg": self.level,
            "heading_deg": self.heading,
            "wander_s": self.wander,
            "heading_wander_s": self.heading_wander,
        }


class Latency(StrictModel):
    """From the validity of a sample to the first byte of its frame, as the makers of both units state it."""

    egi: Annotated[float, *quantity("s", 0.0, 1.0)]
    imu: Annotated[float, *quantity("s", 0.0, 1.0)]
    uncertainty: Annotated[float, *quantity("s", 1e-9, 1.0)] = Field(description="standard uncertainty of either")

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {"egi_s": self.egi, "imu_s": self.imu, "std_s": self.uncertainty}


class NavigationUnits(UnitSections):
    """Sections of ``uut``."""

    inertial: Inertial | None = Field(None, description="what a navigation filter is told of the inertial sensors")
    egi: Egi | None = Field(None, description="what is known of the errors of an EGI that serves as reference")
    latency: Latency | None = Field(None, description="of two units that stream side by side")

    def constants(self) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"; what is not stated is left out."""
        sections = {"inertial": self.inertial, "egi": self.egi, "latency": self.latency}
        return {name: section.constants() for name, section in sections.items() if section is not None}


class StreamColumn(LogColumn):
    """A column of one of two streams in a log: the unit's own stamp, or a motion that both units saw."""

    role: Literal["stamp", "motion"]
    stream: Literal["one", "other"]
    of: Name | None = Field(None, description="what is measured, such as yaw_rate; the same word in both streams")
    unit: Annotated[str, AfterValidator(known_unit)] = Field(description="of the numbers in the file")

    @property
    def quantity(self) -> str:
        """Name of the column in series, such as ``one_stamp`` or ``other_yaw_rate``."""
        return f"{self.stream}_{self.of or self.role}"

    def more(self) -> dict[str, str]:
        """Return what the manifest says of the column beside header, quantity, role and unit."""
        return {"stream": self.stream, "of": self.of or self.role}


class StreamLog(LogSections):
    """Two streams in one log have no section of their own; their columns must fit together."""

    analyses: ClassVar[tuple[str, ...]] = ("stream_offset",)

    def check_log(self, log: Log) -> None:
        """Check that both streams have the same motions. Raises: ValueError."""
        columns = {header: column for header, column in log.values.items() if isinstance(column, StreamColumn)}
        for header, column in columns.items():
            if column.role == "stamp" and column.dimension != "s":
                raise ValueError(f"column {header!r}: the role stamp needs a unit of time, not {column.unit!r}")
        motions = {
            stream: {(c.of, c.dimension) for c in columns.values() if c.stream == stream and c.role == "motion"}
            for stream in ("one", "other")
        }
        if motions["one"] != motions["other"] or (log.analysis in StreamLog.analyses and not motions["one"]):
            raise ValueError(
                "the streams 'one' and 'other' need columns of the role motion with the same 'of' and kind of unit"
            )


DECLARATION = System(
    name="time_sync",
    analyses=(
        AnalysisDeclaration(
            "time_sync",
            "bench.systems.time_sync.analysis",
            ("augmented_loose", "augmented_tight"),
            made_of="samples",
            conditions=("item", "manoeuvre"),
            beside="egi",
            assumptions="bench.systems.time_sync.assumptions:assumptions",
            limits={
                "time_offset_uncertainty": Limit("s", above_zero=True),
                "stamps_difference": Limit("s", above_zero=True),
            },
        ),
        AnalysisDeclaration(
            "stream_offset",
            "bench.systems.time_sync.logs",
            ("common_motion",),
            "logs",
            roles=("time", "stamp", "motion"),
        ),
    ),
    unit=NavigationUnits,
    log=StreamLog,
    log_columns=(StreamColumn,),
    studies={"time_sync": "bench.systems.time_sync.study"},
)
