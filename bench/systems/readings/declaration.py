"""What the engine is told of the analysis of plain readings."""

from bench.model.declaration import AnalysisDeclaration, System

DECLARATION = System(
    name="readings",
    analyses=(
        AnalysisDeclaration(
            "readings",
            "bench.systems.readings.analysis",
            ("polynomial",),
            made_of="values",
            predicted="bench.systems.readings.analysis:predicted",
        ),
    ),
)
