"""The time offset between two navigation units as the engine knows it: analysis, study, and sections of the unit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from bench.model.declaration import (
    AnalysisDeclaration,
    Hint,
    Limit,
    Log,
    LogColumn,
    LogSections,
    Section,
    System,
    UnitSections,
    stated,
)
from bench.model.units import known_unit, quantity
from bench.model.yamlio import Name, StrictModel


class Inertial(Section):
    """Noise and biases of an inertial measurement unit, one sigma, as its data sheet declares them."""

    in_manifest = ("accel_bias_g", "velocity_walk_g_rtHz", "gyro_bias_deg_s", "angle_walk_deg_rth")

    accelerometer_bias: Annotated[float, *quantity("g", 1e-9, 1.0)]
    velocity_walk_per_rtHz: Annotated[float, *quantity("g", 1e-9, 1.0)] = Field(description="density of the noise")
    gyro_bias: Annotated[float, *quantity("deg/s", 1e-9, 10.0)]
    angle_walk_per_rth: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="after one hour")


class Egi(Section):
    """Errors of the solution of an EGI, one sigma per axis; that of its position is in its frames, too."""

    in_manifest = ("velocity_m_s", "level_deg", "heading_deg", "wander_s", "heading_wander_s", "position_m")

    velocity: Annotated[float, *quantity("m/s", 1e-6, 100.0)]
    level: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="of roll and pitch")
    heading: Annotated[float, *quantity("deg", 1e-6, 90.0)]
    wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a velocity is off by the same")
    heading_wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a heading is")
    position: Annotated[float, *quantity("m", 1e-6, 1e4)] | None = Field(
        None, description="for a prediction; results take what the frames say"
    )


class Latency(Section):
    """From the validity of a sample to the first byte of its frame, as the makers of both units state it."""

    in_manifest = ("egi_s", "imu_s", "std_s")

    egi: Annotated[float, *quantity("s", 0.0, 1.0)]
    imu: Annotated[float, *quantity("s", 0.0, 1.0)]
    uncertainty: Annotated[float, *quantity("s", 1e-9, 1.0)] = Field(description="standard uncertainty of either")


class Stamps(Section):
    """Receive stamps of two units that stream side by side and their clocks; only a prediction needs them."""

    in_manifest = ("jitter_s", "clock")

    jitter: Annotated[float, *quantity("s", 1e-9, 1.0)] = Field(description="mean of what a latency is more than least")
    clock: Annotated[float, *quantity("1", 0.0, 1e-2)] = Field(description="as much as the rate of a clock may be off")


class NavigationUnits(UnitSections):
    """Sections of ``uut``."""

    inertial: Inertial | None = Field(None, description="what a navigation filter is told of the inertial sensors")
    egi: Egi | None = Field(None, description="what is known of the errors of an EGI that serves as reference")
    latency: Latency | None = Field(None, description="of two units that stream side by side")
    stamps: Stamps | None = Field(None, description="of their frames, for a prediction")


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


def _check_streams(log: Log) -> None:
    columns = {header: column for header, column in log.values.items() if isinstance(column, StreamColumn)}
    for header, column in columns.items():
        if column.role == "stamp" and column.dimension != "s":
            raise ValueError(f"column {header!r}: the role stamp needs a unit of time, not {column.unit!r}")
    motions = {
        stream: {(c.of, c.dimension) for c in columns.values() if c.stream == stream and c.role == "motion"}
        for stream in ("one", "other")
    }
    if motions["one"] != motions["other"] or (log.analysis == "stream_offset" and not motions["one"]):
        raise ValueError(
            "the streams 'one' and 'other' need columns of the role motion with the same 'of' and kind of unit"
        )


class AntennaColumn(LogColumn):
    """A coordinate of a radar's antenna at its pulses; z is up, the phases refer to the origin."""

    role: Literal["antenna"]
    axis: Literal["x", "y", "z"]
    unit: Annotated[str, AfterValidator(known_unit)] = Field(description="of the numbers in the file, such as m")

    @property
    def quantity(self) -> str:
        """Name of the column in series, such as ``antenna_x``."""
        return f"antenna_{self.axis}"

    def more(self) -> dict[str, str]:
        """Return what the manifest says of the column beside header, quantity, role and unit."""
        return {"axis": self.axis}


class UnitColumn(LogColumn):
    """A column of an EGI or an inertial unit in a log of both."""

    role: Literal[
        "imu_stamp", "delta_angle", "delta_velocity", "egi_stamp", "latitude", "longitude", "height", "velocity",
        "attitude", "position_sigma",
    ]  # fmt: skip
    axis: Literal["x", "y", "z", "north", "east", "down", "roll", "pitch", "heading"] | None = None
    unit: Annotated[str, AfterValidator(known_unit)] = Field(description="of the numbers in the file")

    @property
    def quantity(self) -> str:
        """Name of the column in series, such as ``egi_stamp`` or ``velocity_north``."""
        return self.role if self.axis is None else f"{self.role}_{self.axis}"


_OF_UNITS: Mapping[str, tuple[Sequence[str], Sequence[str]]] = {  # axes and base units by role
    "imu_stamp": ((), ("s",)),
    "delta_angle": ("xyz", ("deg", "deg/s")),
    "delta_velocity": ("xyz", ("m/s", "m/s2")),
    "egi_stamp": ((), ("s",)),
    "latitude": ((), ("deg",)),
    "longitude": ((), ("deg",)),
    "height": ((), ("m",)),
    "velocity": (("north", "east", "down"), ("m/s",)),
    "attitude": (("roll", "pitch", "heading"), ("deg",)),
    "position_sigma": ((), ("m",)),
}


def _check_units(log: Log, said: str | None) -> None:
    columns = {column.quantity: column for column in log.values.values() if isinstance(column, UnitColumn)}
    for role, (axes, units) in _OF_UNITS.items():
        due = [f"{role}_{axis}" for axis in axes] or [role]
        found = [columns[name].dimension for name in due if name in columns]
        if len(found) < len(due) or found[0] not in units or len(set(found)) > 1:
            of_axes = f", axes {', '.join(axes)}," if axes else ""
            raise ValueError(
                f"the analysis {log.analysis!r} needs columns of the role {role}{of_axes} in units of "
                f"{' or '.join(units)}"
            )
    rates = [name for name, column in columns.items() if column.dimension in ("deg/s", "m/s2")]
    if rates and said is None:
        raise ValueError(
            f"columns of rates, such as {rates[0]}, need 'rates: mean' where a value is the mean over the interval "
            "that ends at its stamp, or 'rates: instant' where it holds at its stamp"
        )
    if said and not rates:
        raise ValueError(f"'rates: {said}' is for deg/s and m/s2, and the log has increments: leave it out")


class SampleColumn(LogColumn):
    """Columns of a part of a pulse's complex samples, one for each frequency."""

    numbered: ClassVar[bool] = True

    role: Literal["in_phase", "quadrature"]

    @property
    def quantity(self) -> str:
        """Name of the columns in series, such as ``in_phase_0`` of the first one."""
        return self.role if self._number is None else f"{self.role}_{self._number}"

    @property
    def unit(self) -> str:
        """Samples have none."""
        return "1"


class Frequencies(StrictModel):
    """Frequencies of the samples of each pulse, evenly spaced."""

    first: Annotated[float, *quantity("Hz", 1e6, 1e12)]
    last: Annotated[float, *quantity("Hz", 1e6, 1e12)]

    @model_validator(mode="after")
    def _rises(self) -> Frequencies:
        if not self.last > self.first:
            raise ValueError(f"the last frequency must be above the first, {self.last:g} Hz is not")
        return self


class TimeSyncLog(LogSections):
    """Sections of a mapping; the columns of two streams and of a phase history must fit together."""

    analyses: ClassVar[tuple[str, ...]] = ("stream_offset", "radar_image", "egi_offset")

    frequencies: Frequencies | None = Field(None, description="of the samples of a radar's pulses: first and last")
    inertial: Inertial | None = Field(None, description="what a navigation filter is told of the inertial sensors")
    egi: Egi | None = Field(None, description="what is known of the errors of an EGI that serves as reference")
    latency: Latency | None = Field(None, description="of two units that stream side by side")
    rates: Literal["mean", "instant"] | None = Field(
        None,
        description="deg/s and m/s2 of an inertial unit: means up to the stamp, or at the stamp",
    )

    def check_log(self, log: Log) -> None:
        """Check that both streams have the same motions, and that a phase history is whole. Raises: ValueError."""
        _check_streams(log)
        if log.analysis == "egi_offset":
            _check_units(log, self.rates)
        counts = Counter(column.role for column in log.values.values())
        whole = counts["antenna"] == 3 and counts["in_phase"] == counts["quadrature"] > 1 and self.frequencies
        if log.analysis == "radar_image" and not whole:
            raise ValueError(
                "the analysis 'radar_image' needs columns of the role antenna for x, y and z, as many columns of the "
                "role in_phase as of quadrature, and 'frequencies'"
            )
        for header, column in log.values.items():
            if column.role == "antenna" and column.dimension != "m":
                raise ValueError(f"column {header!r}: the role antenna needs a unit of length, not {column.unit!r}")

    def log_constants(self, log: Log) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"."""
        stated_units = NavigationUnits(inertial=self.inertial, egi=self.egi, latency=self.latency, stamps=None)
        units = stated_units.constants(stated_units) | stated({"rates": self.rates})
        if self.frequencies is None:
            return units
        return units | {"frequencies": {"first_Hz": self.frequencies.first, "last_Hz": self.frequencies.last}}


_SIZES = ("time_offset_uncertainty",)

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
            bench_clock=True,
            main=("time_offset", "time_offset_drift"),
            sizes=_SIZES,
            assumptions="bench.systems.time_sync.assumptions:assumptions",
            predicted="bench.systems.time_sync.predicted:predicted",
            predicts_long=True,
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
        AnalysisDeclaration(
            "egi_offset",
            "bench.systems.time_sync.egi_log",
            ("augmented_loose", "augmented_tight"),
            "logs",
            sizes=_SIZES,
            roles=("time", *_OF_UNITS),
        ),
        AnalysisDeclaration(
            "radar_image",
            "bench.systems.time_sync.phase_history",
            ("backprojection",),
            "logs",
            roles=("time", "antenna", "in_phase", "quadrature"),
        ),
    ),
    unit=NavigationUnits,
    log=TimeSyncLog,
    log_columns=(StreamColumn, UnitColumn, AntennaColumn, SampleColumn),
    log_hints=(
        Hint("in_phase", r"\.real$|in_?phase", None, analysis="radar_image", numbered=True),
        Hint("quadrature", r"\.imag$|quadrature", None, numbered=True),
        Hint("antenna", r"antenna", (("m", 0.0, 1e7),), by_axis=True),
    ),
    studies={"time_sync": "bench.systems.time_sync.study"},
)
