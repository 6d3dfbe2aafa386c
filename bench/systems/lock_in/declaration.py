"""Declaration of the lock-in of a dithered ring laser."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

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
)
from bench.model.units import quantity
from bench.model.yamlio import StrictModel


class DeclaredLaser(Section):
    """Laser block and dither, for predictions; lock-in rate and quantum noise fall with the square of the path."""

    in_manifest = ("path_length_m", "lock_in_deg_s", "quantum_deg_rt_s", "dither_deg_s", "dither_Hz", "pick_off_s")

    path_length: Annotated[float, *quantity("m", 1e-3, 1e3)] = Field(description="that the rates are of, such as 28 cm")
    lock_in_rate: Annotated[float, *quantity("deg/s", 1e-9, 100.0)]
    quantum_random_walk: Annotated[float, *quantity("deg/sqrt(s)", 1e-12, 1.0)] = Field(
        description="angle random walk that is left without lock-in, such as 1.15e-4 deg/sqrt(h)"
    )
    dither_rate: Annotated[float, *quantity("deg/s", 1e-3, 1e4)] = Field(description="amplitude of the dither's rate")
    dither_frequency: Annotated[float, *quantity("Hz", 1.0, 1e5)]
    pick_off_noise: Annotated[float, *quantity("s", 0.0, 1e-3)] = Field(
        description="standard deviation of the time at which the dither's pick-off switches"
    )


class LaserUnit(UnitSections):
    """Sections of ``uut``."""

    laser: DeclaredLaser | None = Field(None, description="for predictions of a ring laser")

    @classmethod
    def constants(cls, unit: Any) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"; what is not stated is left out."""
        return {} if unit.laser is None else {"declared_laser": unit.laser.constants()}


class LaserColumn(LogColumn):
    """A column of numbers without a unit, one of each role."""

    @property
    def quantity(self) -> str:
        """Name of the column in series and results."""
        return self.role

    @property
    def unit(self) -> str:
        """Counts have none."""
        return "1"


class CountColumn(LaserColumn):
    """A column of counts of a ring laser: as the counter stands, or what it advanced by since the row before."""

    role: Literal["count", "count_increment"]


class EdgeColumn(LaserColumn):
    """Level behind the edges of one comparator of a ring laser, 0 or 1; empty in rows that are edges of another one."""

    role: Literal["beat", "cosine", "pickoff"]


class Laser(StrictModel):
    """What a log of edges does not hold of the laser and of the alignment that it is for."""

    path_length: Annotated[float, *quantity("m", 1e-3, 1e3)] = Field(description="optical path, such as 28 cm")
    latitude: Annotated[float, *quantity("deg", -89.0, 89.0)] = Field(description="of the site of the alignment")


class RingLaserLog(LogSections):
    """Sections of a mapping."""

    analyses: ClassVar[tuple[str, ...]] = ("rlg_count_log", "rlg_edge_log")

    laser: Laser | None = Field(None, description="of a log of edges: path length, and latitude of the alignment")

    count_scale: Annotated[float, *quantity("deg", 1e-12, 1.0)] | None = Field(
        None, description="angle of one count of a ring laser, such as 1.11 arcsec"
    )

    def check_log(self, log: Log) -> None:
        """Check that there are counts and their scale, or all edges and the laser. Raises: ValueError."""
        counts = [column for column in log.values.values() if isinstance(column, CountColumn)]
        if log.analysis == "rlg_count_log" and (len(counts) != 1 or self.count_scale is None):
            raise ValueError(
                f"the analysis {log.analysis!r} needs one column of the role count or count_increment, and "
                "'count_scale'"
            )
        edges = [column for column in log.values.values() if isinstance(column, EdgeColumn)]
        if log.analysis == "rlg_edge_log" and (len(edges) != 3 or self.laser is None):
            raise ValueError(
                f"the analysis {log.analysis!r} needs columns of the roles beat, cosine and pickoff, and 'laser' with "
                "path_length and latitude"
            )

    def log_constants(self, log: Log) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"."""
        constants: dict[str, Any] = {} if self.count_scale is None else {"count_scale_deg": self.count_scale}
        if self.laser is not None:
            constants["laser"] = {"path_length_m": self.laser.path_length, "latitude_deg": self.laser.latitude}
        return constants


COMPENSATORS = ("global_constants", "fresnel", "dither_shape_16", "dither_shape", "parabolas")
DECLARATION = System(
    name="lock_in",
    analyses=(
        AnalysisDeclaration(
            "rlg_lock_in",
            "bench.systems.lock_in.analysis",
            COMPENSATORS,
            made_of="samples",
            conditions=("path_length_m", "clock_Hz"),
            main=("lock_in_rate", "angle_random_walk", "alignment_time"),
            sizes=("alignment_time",),
            assumptions="bench.systems.lock_in.assumptions:assumptions",
            predicted="bench.systems.lock_in.predicted:predicted",
            limits={"alignment_error": Limit("deg", above_zero=True), "alignment_time": Limit("s", above_zero=True)},
        ),
        AnalysisDeclaration(
            "rlg_count_log",
            "bench.systems.lock_in.logs",
            ("allan",),
            "logs",
            roles=("time", "count", "count_increment"),
        ),
        AnalysisDeclaration(
            "rlg_edge_log",
            "bench.systems.lock_in.edge_log",
            COMPENSATORS,
            "logs",
            roles=("time", "beat", "cosine", "pickoff"),
        ),
    ),
    unit=LaserUnit,
    log=RingLaserLog,
    log_columns=(CountColumn, EdgeColumn),
    log_hints=(
        Hint("beat", r"(^|[^a-z])beat", None, analysis="rlg_edge_log"),
        Hint("cosine", r"cosine", None),
        Hint("pickoff", r"pick_?off", None),
        Hint("count", r"(?<!packet)count|pulses|ticks", None, analysis="rlg_count_log"),
    ),
)
