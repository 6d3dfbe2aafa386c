"""What the calibration of a module has found: fits of both triads, and why the rest was not fitted."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from bench.model.errors import FitError
from bench.systems.gnc.estimators.rotations import RotationFit
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.estimators.unit_clock import UnitClock
from bench.systems.gnc.rows import SampledRow
from bench.systems.gnc.sets import Sets


@dataclass
class Calibration:
    """What was fitted, and why the rest was not. ``power_on``: its number by the number of the record."""

    sets: Sets
    clock: UnitClock
    power_on: Mapping[int, int]
    tilt_deg: float = 0.0
    accelerometer: TriadFit | None = None
    gyro: RotationFit | None = None
    accelerometer_check: TriadFit | None = None
    gyro_check: RotationFit | None = None
    missing: list[str] = field(default_factory=list)
    refused: list[FitError] = field(default_factory=list)

    def one_power_on(self, rows: Collection[SampledRow]) -> bool:
        """Return whether the unit was not switched off between these records."""
        return len({self.power_on[row.number] for row in rows}) <= 1
