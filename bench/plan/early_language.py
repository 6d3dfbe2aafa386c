"""What a sequence may say about early verdicts: when they are given, by which limits, and what a failed one does."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bench.model.units import quantity
from bench.model.yamlio import StrictModel

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
