"""Fits of one reading of an imported temperature ramp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Floats
from bench.systems.af_converter.estimators.drift_ramp import (
    Blocks,
    BranchDifference,
    DriftFit,
    branch_differences,
    fit_drift,
)
from bench.systems.af_converter.estimators.ramp_hysteresis import RampHysteresis, fit_ramp_hysteresis
from bench.systems.af_converter.estimators.thermal_lag import usable_drive
from bench.systems.af_converter.temperature_ramp.columns import RampColumns, minute_means


@dataclass(frozen=True)
class ReadingFit:
    """Everything fitted to one reading; ``differences`` and ``after_drift`` by name of the sensor."""

    name: str
    readings: Floats  # block means
    drift: DriftFit
    differences: dict[str, list[BranchDifference]]
    after_drift: dict[str, DriftFit]
    joint: RampHysteresis | None


def fit_reading(name: str, columns: RampColumns, blocks: Blocks, reference_degC: float, method: str) -> ReadingFit:
    """Fit one reading: drift and up/down term by every sensor and, with the method "joint", lag and hysteresis."""
    readings, branch = blocks.mean(columns.readings[name]), blocks.mean(columns.branch / 2.0)
    sensors = {sensor: blocks.mean(values) for sensor, values in columns.sensors.items()}
    main = next(iter(sensors.values()))
    drift = fit_drift(blocks, main, readings, branch, reference_degC)
    others = {
        sensor: drift if values is main else fit_drift(blocks, values, readings, branch, reference_degC, drift.noise)
        for sensor, values in sensors.items()
    }
    ramps = columns.main_ramps()
    indices = tuple(
        np.flatnonzero((blocks.start_s >= ramps[kind].start_s) & (blocks.end_s <= ramps[kind].end_s))
        for kind in ("up", "down")
    )
    differences = {
        sensor: branch_differences(drift, values, readings, (indices[0], indices[1]), _whole_degrees(values, indices))
        for sensor, values in sensors.items()
    }
    joint = None
    if method == "joint":
        drive = usable_drive(*minute_means(columns.t_s, columns.temperature_degC))
        joint = fit_ramp_hysteresis(blocks, readings, drive, drift.noise, reference_degC)
    return ReadingFit(name, readings, drift, differences, others, joint)


def _whole_degrees(values: Floats, ramps: tuple[NDArray[np.int64], ...]) -> list[float]:
    """Whole degrees that both ramps reach."""
    low = max(float(values[ramp].min()) for ramp in ramps if ramp.size)
    high = min(float(values[ramp].max()) for ramp in ramps if ramp.size)
    return [float(at) for at in range(int(np.ceil(low)), int(np.floor(high)) + 1)]
