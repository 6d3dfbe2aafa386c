"""Choices at the simulated bench of a plain unit, and their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OPTIONS: Mapping[str, str] = {}
NUMBERS = {
    "rail_V": ("voltage of the regulated rail, default 5.01", 0.0, 20.0),
    "idle_A": ("current that the unit draws, default 0.12", 0.0, 5.0),
    "monitor_offset_V": ("offset of the monitor output, default 0.0006", -1.0, 1.0),
    "monitor_gain_ppm": ("error of its gain of one half, default 180", -1e6, 1e6),
    "monitor_bow_ppm": ("largest departure of it from a straight line, of 10 V, default 25", -1e5, 1e5),
    "thermistor_ppm": ("error of the thermistor's resistance, default 2000", -1e6, 1e6),
    "time_constants": ("all lags of the chamber are shorter by this factor, default 1", 1.0, 1000.0),
}
TEXTS: Mapping[str, Any] = {}


@dataclass(frozen=True)
class PlainOptions:
    """Options of one bench; names and meaning as in ``NUMBERS``."""

    rail_V: float = 5.01
    idle_A: float = 0.12
    monitor_offset_V: float = 6e-4
    monitor_gain_ppm: float = 180.0
    monitor_bow_ppm: float = 25.0
    thermistor_ppm: float = 2000.0
    time_constants: float = 1.0
