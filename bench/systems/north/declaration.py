"""Declaration of north finding with a fibre-optic gyroscope."""

from __future__ import annotations

from bench.model.declaration import AnalysisDeclaration, Limit, System

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
            limits={"azimuth_error": Limit("deg", above_zero=True)},
            assumptions="bench.systems.north.assumptions:assumptions",
        ),
    ),
)
