"""The world of the time-offset bench: EGI, inertial unit and radar of one vehicle, its table, its truth."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np

from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from bench.model.units import parse_quantity
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Operation, World, entry
from sim_instruments.worlds.time_sync.flight.flights import Flight, Flights, TableAxis
from sim_instruments.worlds.time_sync.flight.path import STANDARD_GRAVITY_M_S2
from sim_instruments.worlds.time_sync.options import SyncOptions
from sim_instruments.worlds.time_sync.stream import Clocks
from sim_instruments.worlds.time_sync.unit import PORTS, SyncUnit

ITEM = "time_sync"  # condition of the records that count
S_PER_H = 3600.0
START_V, CURRENT_A = 14.0, 1.6
MOST_SPEED_M_S, MOST_ACCELERATION_M_S2 = 400.0, 50.0


def estimates(
    powers: Sequence[Clocks], flights: Flights, noise: bool, windows: Sequence[RecordWindow]
) -> list[dict[str, Any]]:
    """Return true values as in the contract: offset of the clocks at the middle of the records, its drift, IMU biases.

    The time offset is the EGI's clock minus the IMU's at the same moment; biases are what the sensors indicate minus
    what they feel, about the body's axes. The middle is that between the beginning of the first record and the end of
    the last one.
    """
    own = [window for window in windows if window.conditions.get("item") == ITEM]
    if not own:
        return []
    begin_ns, end_ns = own[0].t_start_ns, own[-1].t_end_ns
    clocks = next((pair for pair in reversed(powers) if pair.imu.on_ns <= begin_ns), None)
    if clocks is None:
        return []
    about = {"manoeuvre": own[0].conditions["manoeuvre"]} if "manoeuvre" in own[0].conditions else {}
    entries = [
        entry("time_offset", "s", clocks.offset_s((begin_ns + end_ns) // 2), {**about, "at": "middle"}),
        entry("time_offset", "s", clocks.offset_s(begin_ns), {**about, "at": "begin"}),
        entry("time_offset", "s", clocks.offset_s(end_ns), {**about, "at": "end"}),
        entry("time_offset_drift", "ppm", clocks.drift_ppm, about),
    ]
    return entries + (_biases(flights.at(begin_ns), about) if noise else [])


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


def _number(unit: str, value: Any) -> float:
    """Return a number of that unit, or a quantity as text; nan if it is neither."""
    with contextlib.suppress(TypeError, ValueError):
        return float(value)
    with contextlib.suppress(ValueError):
        return parse_quantity(value, unit)
    return math.nan


class SyncWorld(World):
    """One simulated bench of an EGI and an inertial unit whose clocks disagree.

    Args: clock, seed: as of every world.   options: checked ones of ``sync_options``; the others are as by default.
    Attributes: motion: of the table's axes; the first one, right-handed about up, turns the vehicle.
        flights: all flights so far; for tests, which know the truth.
    """

    ports = PORTS
    load = START_V, CURRENT_A

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        table = TableAxis()
        self.motion: tuple[AxisMotion, ...] = (table, AxisMotion(), AxisMotion())
        self.sync_options = SyncOptions(**options)
        self.flights = Flights(seed, clock.now_ns(), table)
        self.units = SyncUnit(clock, seed, self.sync_options, self.flights)
        super().__init__(clock=clock, seed=seed, unit=self.units, thermal=Thermal(), options=options)
        self.units.lock = self.lock

    @property
    def flight(self) -> Flight:
        """The flight of now: path, draws and beginning; for tests, which know the truth."""
        return self.flights.newest

    operations: ClassVar[Mapping[str, Operation]] = {
        "speed": Operation.number(
            lambda world, speed_m_s: world.units.begin_flight(speed_m_s), 0.0, MOST_SPEED_M_S, "m/s",
            partial(_number, "m/s")),
        "acceleration": Operation.number(
            lambda world, m_s2: world.units.accelerate(m_s2), -MOST_ACCELERATION_M_S2, MOST_ACCELERATION_M_S2, "m/s2",
            partial(_number, "m/s2")),
        "radar": Operation.word(lambda world, word: world.units.set_radar(word == "on"), "on", "off", due="on or off"),
    }  # fmt: skip

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return estimates(self.units.powers, self.flights, self.sync_options.noise, windows)


WORLD = SyncWorld
