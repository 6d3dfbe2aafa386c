"""Declaration of north finding with a fibre-optic gyroscope."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from bench.model.declaration import (
    AnalysisDeclaration,
    Hint,
    Limit,
    Log,
    LogColumn,
    LogSections,
    System,
    UnitSections,
)
from bench.model.units import known_unit, quantity
from bench.model.yamlio import StrictModel

_SAMPLES, _READINGS = {"output", "encoder"}, {"lock_in_1", "lock_in_2", "index"}


class Fog(StrictModel):
    """A fibre-optic gyroscope and the table that turns it, as their data sheets declare them."""

    output_per_deg_h: Annotated[float, *quantity("V", 1e-9, 1e3)] = Field(description="for 1 deg/h along its axis")
    angle_walk_per_rth: Annotated[float, *quantity("deg", 1e-9, 10.0)] = Field(description="after one hour")
    table_swing: Annotated[float, *quantity("deg", 0.0, 10.0)] | None = Field(
        None, description="of the turning table about a steady rotation, RMS"
    )

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names; a table that is not stated turns steadily."""
        return {
            "output_V_per_deg_h": self.output_per_deg_h,
            "angle_walk_deg_rth": self.angle_walk_per_rth,
            "table_swing_deg": self.table_swing or 0.0,
        }


class FogUnit(UnitSections):
    """Section of ``uut``."""

    fog: Fog | None = Field(None, description="gyroscope of a north finder; what is predicted rests on it")


class NorthColumn(LogColumn):
    """A column of a north finder: output and table angle of each sample, or both lock-ins at each index position."""

    role: Literal["output", "encoder", "lock_in_1", "lock_in_2", "index"]
    unit: Annotated[str, AfterValidator(known_unit)] = Field("1", description="of the numbers in the file")

    @property
    def quantity(self) -> str:
        """Name of the column in series and results."""
        return self.role


class NorthLog(LogSections):
    """Section of a mapping."""

    analyses: ClassVar[tuple[str, ...]] = ("north_log",)

    turntable: Literal["counter_clockwise", "clockwise"] | None = Field(
        None, description="sense of rotation from above; of readings of lock-ins, which do not show it"
    )

    def check_log(self, log: Log) -> None:
        """Check that samples or readings are complete. Raises: ValueError."""
        roles = {column.role for column in log.values.values() if isinstance(column, NorthColumn)}
        for header, column in log.values.items():
            if column.role == "encoder" and column.dimension != "deg":
                raise ValueError(f"column {header!r}: an encoder needs a unit of angle, not {column.unit!r}")
        if log.analysis in NorthLog.analyses and not (roles >= _SAMPLES or roles >= _READINGS):
            raise ValueError(
                f"the analysis {log.analysis!r} needs columns of the roles output and encoder, or lock_in_1, lock_in_2 "
                "and index"
            )
        if log.analysis in NorthLog.analyses and roles >= _READINGS and self.turntable is None:
            raise ValueError("readings of lock-ins need 'turntable: counter_clockwise' or clockwise")

    def log_constants(self, log: Log) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"."""
        return {} if self.turntable is None else {"turntable": self.turntable}


DECLARATION = System(
    name="north",
    analyses=(
        AnalysisDeclaration(
            "fog_north",
            "bench.systems.north.analysis",
            ("least_squares", "likelihood", "quadrant", "literal"),
            made_of="samples",
            conditions=("item", "head_deg", "index", "repeat", "rate_deg_s"),
            fields=("output", "encoder"),
            main=("azimuth_rms_error", "azimuth_error", "azimuth", "time_to_accuracy"),
            limits={"azimuth_error": Limit("deg", above_zero=True)},
            assumptions="bench.systems.north.predicted:assumptions",
            predicted="bench.systems.north.predicted:predicted",
        ),
        AnalysisDeclaration(
            "north_log",
            "bench.systems.north.logs",
            ("as_mapped",),
            "logs",
            roles=("time", "output", "encoder", "lock_in_1", "lock_in_2", "index"),
        ),
    ),
    unit=FogUnit,
    log=NorthLog,
    log_columns=(NorthColumn,),
    log_hints=(
        Hint("encoder", r"encod|table_angle|theta", units=(), analysis="north_log"),
        Hint("output", r"output|fog"),
    ),
)
