"""What a sequence says of a GNC module: the sensors of its data sheet."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from bench.model.declaration import UnitSections
from bench.model.units import quantity
from bench.model.yamlio import StrictModel


class Imu(StrictModel):
    """Ranges and resolutions of the sensors of a GNC module, as its data sheet declares them."""

    gyro_range: Annotated[float, *quantity("deg/s", 1e-3, 1e5)]
    gyro_resolution: Annotated[float, *quantity("deg/s", 0.0, 100.0)]
    accelerometer_range: Annotated[float, *quantity("g", 1e-3, 1e5)]
    accelerometer_resolution: Annotated[float, *quantity("g", 0.0, 10.0)]
    magnetometer_range: Annotated[float, *quantity("gauss", 1e-3, 1e3)]
    magnetometer_resolution: Annotated[float, *quantity("gauss", 0.0, 10.0)]

    def constants(self) -> dict[str, float]:
        """Return them with their units in the names."""
        return {
            "gyro_range_deg_s": self.gyro_range,
            "gyro_resolution_deg_s": self.gyro_resolution,
            "accel_range_g": self.accelerometer_range,
            "accel_resolution_g": self.accelerometer_resolution,
            "mag_range_gauss": self.magnetometer_range,
            "mag_resolution_gauss": self.magnetometer_resolution,
        }


class ModuleUnit(UnitSections):
    """Sections of ``uut``."""

    imu: Imu | None = Field(None, description="inertial measurement unit and magnetometer of a GNC module")

    def constants(self) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"; what is not stated is left out."""
        return {} if self.imu is None else {"imu": self.imu.constants()}
