"""The time offset between two navigation units as the engine knows it: analysis, study, and sections of the unit."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from bench.model.declaration import AnalysisDeclaration, Limit, System, UnitSections
from bench.model.units import quantity
from bench.model.yamlio import StrictModel


class Inertial(StrictModel):
    """Noise and biases of an inertial measurement unit, one sigma, as its data sheet declares them."""

    accelerometer_bias: Annotated[float, *quantity("g", 1e-9, 1.0)]
    velocity_walk_per_rtHz: Annotated[float, *quantity("g", 1e-9, 1.0)] = Field(description="density of the noise")
    gyro_bias: Annotated[float, *quantity("deg/s", 1e-9, 10.0)]
    angle_walk_per_rth: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="after one hour")

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {
            "accel_bias_g": self.accelerometer_bias,
            "velocity_walk_g_rtHz": self.velocity_walk_per_rtHz,
            "gyro_bias_deg_s": self.gyro_bias,
            "angle_walk_deg_rth": self.angle_walk_per_rth,
        }


class Egi(StrictModel):
    """Errors of the solution of an EGI, one sigma per axis; that of its position is in its frames."""

    velocity: Annotated[float, *quantity("m/s", 1e-6, 100.0)]
    level: Annotated[float, *quantity("deg", 1e-6, 10.0)] = Field(description="of roll and pitch")
    heading: Annotated[float, *quantity("deg", 1e-6, 90.0)]
    wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a velocity is off by the same")
    heading_wander: Annotated[float, *quantity("s", 0.1, 1e5)] = Field(description="how long a heading is")

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {
            "velocity_m_s": self.velocity,
            "level_deg": self.level,
            "heading_deg": self.heading,
            "wander_s": self.wander,
            "heading_wander_s": self.heading_wander,
        }


class Latency(StrictModel):
    """From the validity of a sample to the first byte of its frame, as the makers of both units state it."""

    egi: Annotated[float, *quantity("s", 0.0, 1.0)]
    imu: Annotated[float, *quantity("s", 0.0, 1.0)]
    uncertainty: Annotated[float, *quantity("s", 1e-9, 1.0)] = Field(description="standard uncertainty of either")

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {"egi_s": self.egi, "imu_s": self.imu, "std_s": self.uncertainty}


class NavigationUnits(UnitSections):
    """Sections of ``uut``."""

    inertial: Inertial | None = Field(None, description="what a navigation filter is told of the inertial sensors")
    egi: Egi | None = Field(None, description="what is known of the errors of an EGI that serves as reference")
    latency: Latency | None = Field(None, description="of two units that stream side by side")

    def constants(self) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"; what is not stated is left out."""
        sections = {"inertial": self.inertial, "egi": self.egi, "latency": self.latency}
        return {name: section.constants() for name, section in sections.items() if section is not None}


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
            assumptions="bench.systems.time_sync.assumptions:assumptions",
            limits={
                "time_offset_uncertainty": Limit("s", above_zero=True),
                "stamps_difference": Limit("s", above_zero=True),
            },
        ),
    ),
    unit=NavigationUnits,
    studies={"time_sync": "bench.systems.time_sync.study"},
)
