"""From readings to points: one per record, with the mean of every thermometer, of the reference and of the air."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from bench.analysis import Material, Reading

from resistance_thermometer.system.setup import CHAMBER, METER, SCANNER

TEMPERATURE = "temperature_degC"


@dataclass(frozen=True)
class Mean:
    """Mean of the readings of one record; ``std`` by their scatter, NaN of a single one; ``dropped`` gave no value."""

    value: float
    std: float
    n: int
    dropped: int


@dataclass(frozen=True)
class Point:
    """One record: the set-point, and the means in ohm by channel, of the reference, and of the air in degC."""

    setpoint_degC: float
    by_channel: Mapping[int, Mean]
    reference: Mean
    air: Mean


def points_of(material: Material) -> list[Point]:
    """Return the points in order of time."""
    return [
        _point(float(row.window.conditions[TEMPERATURE]), material.readings_of(row))
        for row in material.rows
        if not row.quality
    ]


def _point(setpoint_degC: float, readings: Iterable[Reading]) -> Point:
    values: dict[tuple[str, int], list[float]] = {}
    for reading in readings:
        number = int(reading.arguments.get("channel", 0))
        values.setdefault((reading.role, number), []).append(math.nan if reading.value is None else reading.value)
    return Point(
        setpoint_degC=setpoint_degC,
        by_channel={number: _mean(found) for (role, number), found in values.items() if role == SCANNER},
        reference=_mean(values.get((METER, 0), [])),
        air=_mean(values.get((CHAMBER, 0), [])),
    )


def _mean(values: list[float]) -> Mean:
    known = np.array([value for value in values if math.isfinite(value)])
    dropped = len(values) - known.size
    if known.size == 0:
        return Mean(math.nan, math.nan, 0, dropped)
    std = float(np.std(known, ddof=1)) / math.sqrt(known.size) if known.size > 1 else math.nan
    return Mean(float(known.mean()), std, known.size, dropped)
