"""Declaration of the lock-in of a dithered ring laser."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from bench.model.declaration import AnalysisDeclaration, Hint, Limit, Log, LogColumn, LogSections, System
from bench.model.units import quantity


class CountColumn(LogColumn):
    """A column of counts of a ring laser: as the counter stands, or what it advanced by since the row before."""

    role: Literal["count", "count_increment"]

    @property
    def quantity(self) -> str:
        """Name of the column in series and results."""
        return self.role

    @property
    def unit(self) -> str:
        """Counts have none."""
        return "1"


class CountLog(LogSections):
    """Section of a mapping."""

    analyses: ClassVar[tuple[str, ...]] = ("rlg_count_log",)

    count_scale: Annotated[float, *quantity("deg", 1e-12, 1.0)] | None = Field(
        None, description="angle of one count of a ring laser, such as 1.11 arcsec"
    )

    def check_log(self, log: Log) -> None:
        """Check that there are counts and their scale. Raises: ValueError."""
        counts = [column for column in log.values.values() if isinstance(column, CountColumn)]
        if log.analysis in CountLog.analyses and (len(counts) != 1 or self.count_scale is None):
            raise ValueError(
                f"the analysis {log.analysis!r} needs one column of the role count or count_increment, and "
                "'count_scale'"
            )

    def log_constants(self, log: Log) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"."""
        return {} if self.count_scale is None else {"count_scale_deg": self.count_scale}


DECLARATION = System(
    name="lock_in",
    analyses=(
        AnalysisDeclaration(
            "rlg_lock_in",
            "bench.systems.lock_in.analysis",
            ("global_constants", "fresnel", "dither_shape_16", "dither_shape", "parabolas"),
            made_of="samples",
            conditions=("path_length_m", "clock_Hz"),
            assumptions="bench.systems.lock_in.assumptions:assumptions",
            limits={"alignment_error": Limit("deg", above_zero=True), "alignment_time": Limit("s", above_zero=True)},
        ),
        AnalysisDeclaration(
            "rlg_count_log",
            "bench.systems.lock_in.logs",
            ("allan",),
            "logs",
            roles=("time", "count", "count_increment"),
        ),
    ),
    log=CountLog,
    log_columns=(CountColumn,),
    log_hints=(Hint("count", r"count|pulses|ticks", None, analysis="rlg_count_log"),),
)
