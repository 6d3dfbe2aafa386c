"""Simulated truth of two inertial units with clocks of their own: what a perfect analysis of the records would find.

Nothing of the product reads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.world import entry
from sim_instruments.worlds.time_sync.clocks import Clocks
from sim_instruments.worlds.time_sync.flight.earth import STANDARD_GRAVITY_M_S2
from sim_instruments.worlds.time_sync.flight.flights import Flight, Flights

ITEM = "time_sync"  # condition of the records that count
S_PER_H = 3600.0


def estimates(
    powers: Sequence[Clocks], flights: Flights, noise: bool, windows: Sequence[RecordWindow]
) -> list[dict[str, Any]]:
    """True values in the contract's form: offset of the clocks at the middle of the records, its drift, IMU biases.

    The time offset is the EGI's clock minus the IMU's at the same moment; biases are what the sensors indicate minus
    what they feel, about the body's axes. The middle is that between the beginning of the first record and the end of
    the last one.
    """
    own = [window for window in windows if window.conditions.get("item") == ITEM]
    if not own:
        return []
    begin_ns, end_ns = own[0].t_start_ns, own[-1].t_end_ns
    clocks = next((one for one in reversed(powers) if one.imu.on_ns <= begin_ns), None)
    if clocks is None:
        return []
    about = {"manoeuvre": own[0].conditions["manoeuvre"]} if "manoeuvre" in own[0].conditions else {}
    found = [
        entry("time_offset", "s", clocks.offset_s((begin_ns + end_ns) // 2), {**about, "at": "middle"}),
        entry("time_offset", "s", clocks.offset_s(begin_ns), {**about, "at": "begin"}),
        entry("time_offset", "s", clocks.offset_s(end_ns), {**about, "at": "end"}),
        entry("time_offset_drift", "ppm", clocks.drift_ppm, about),
    ]
    return found + (_biases(flights.at(begin_ns), about) if noise else [])


def _biases(flight: Flight, about: dict[str, Any]) -> list[dict[str, Any]]:
    accel_ug = 1e6 * flight.imu.accel_bias / STANDARD_GRAVITY_M_S2
    gyro_deg_h = np.degrees(flight.imu.gyro_bias) * S_PER_H
    rows = [
        entry("accel_bias", "ug", value, {**about, "kind": "accelerometer", "axis": axis})
        for axis, value in zip("xyz", accel_ug, strict=True)
    ]
    return rows + [
        entry("gyro_bias", "deg/h", value, {**about, "kind": "gyro", "axis": axis})
        for axis, value in zip("xyz", gyro_deg_h, strict=True)
    ]
