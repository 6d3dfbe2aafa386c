"""What the engine is told of the probes."""

from bench.model.declaration import AnalysisDeclaration, System

DECLARATION = System(
    name="probes",
    analyses=(
        AnalysisDeclaration(
            "probe_means", "probe_system.analysis", ("mean",), made_of="readings", conditions=("temperature_degC",)
        ),
    ),
)
