"""What the engine is told of platinum resistance thermometers."""

from __future__ import annotations

from bench.model.declaration import AnalysisDeclaration, System

from resistance_thermometer.system.sections import Thermometers

DECLARATION = System(
    name="resistance_thermometer",
    analyses=(
        AnalysisDeclaration(
            "resistance_thermometer",
            "resistance_thermometer.system.analysis",
            ("callendar_van_dusen",),
            made_of="readings",
            conditions=("temperature_degC",),
            main=("deviation", "r0"),
        ),
    ),
    unit=Thermometers,
)
