"""Declaration of the lock-in of a dithered ring laser."""

from __future__ import annotations

from bench.model.declaration import AnalysisDeclaration, Limit, System

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
    ),
)
