"""Simulated truth of a north finder: what a perfect analysis would find. Nothing of the product reads it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.world import entry
from sim_instruments.worlds.north.sensor import FogSensor

_PLACE = ("item", "place", "head_deg")
UNKNOWN = ("test", "search")  # items whose azimuth an analysis finds; that of a calibration is stated


def estimates(
    sensor: FogSensor, heading_deg: Callable[[NDArray[np.int64]], NDArray[np.float64]], windows: Sequence[RecordWindow]
) -> list[dict[str, Any]]:
    """True values in the contract's form: azimuth of each heading, index marks, amplitude, noise of a sample."""
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for window in windows:
        if window.conditions.get("item") in UNKNOWN:
            conditions = {key: window.conditions[key] for key in _PLACE if key in window.conditions}
            middle_ns = np.array([(window.t_start_ns + window.t_end_ns) // 2])
            azimuth_deg = float(heading_deg(middle_ns)[0])
            found.setdefault(tuple(conditions.items()), entry("azimuth", "deg", azimuth_deg, conditions))
    if not found:
        return []
    marks = [entry("index_placement", "deg", at_deg, {"index": mark}) for mark, at_deg in sensor.placement_deg.items()]
    about = {"source": "waveform"}
    signal = [entry("scale", "V", sensor.amplitude_V, about), entry("noise", "V", sensor.noise_V, about)]
    return [*found.values(), *marks, *signal]
