"""What the engine is told of the time offset between two navigation units."""

from __future__ import annotations

from bench.model.declaration import AnalysisDeclaration, Limit, System
from bench.systems.time_sync.sections import NavigationUnits

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
            limits={
                "time_offset_uncertainty": Limit("s", above_zero=True),
                "stamps_difference": Limit("s", above_zero=True),
            },
        ),
    ),
    unit=NavigationUnits,
    studies={"time_sync": "bench.systems.time_sync.study"},
)
