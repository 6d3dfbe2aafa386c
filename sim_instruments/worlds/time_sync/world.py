"""The world of the time-offset bench: EGI, inertial unit and radar of one vehicle, and the table that turns it."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from bench.model.clock import Clock
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.model.units import parse_quantity
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.time_sync.flight.flights import Flight, Flights, TableAxis
from sim_instruments.worlds.time_sync.options import SyncOptions
from sim_instruments.worlds.time_sync.truth import estimates
from sim_instruments.worlds.time_sync.unit import PORTS, SyncUnit

START_V, CURRENT_A = 14.0, 1.6
MOST_SPEED_M_S, MOST_ACCELERATION_M_S2 = 400.0, 50.0
_RADAR = ("off", "on")


class SyncWorld(World):
    """One simulated bench of an EGI and an inertial unit whose clocks disagree.

    Args: clock, seed: as of every world.   options: checked ones of ``sync_options``; the others are as by default.
    Attributes: motion: of the table's axes; the first one, right-handed about up, turns the vehicle.
        flights: all flights so far; for tests, which know the truth.
    """

    ports = PORTS
    operations: ClassVar[tuple[str, ...]] = ("speed", "acceleration", "radar")

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        table = TableAxis()
        self.motion: tuple[AxisMotion, ...] = (table, AxisMotion(), AxisMotion())
        self.sync_options = SyncOptions.of(options)
        self.flights = Flights(seed, clock.now_ns(), table)
        self.units = SyncUnit(clock, seed, self.sync_options, self.flights)
        super().__init__(clock=clock, seed=seed, unit=self.units, thermal=Thermal(), options=options)
        self.units.lock = self.lock

    @property
    def flight(self) -> Flight:
        """The flight of now: path, draws and beginning; for tests, which know the truth."""
        return self.flights.newest

    def operate(self, name: str, value: Any) -> None:
        """Fly anew: ``speed`` (m/s, 0 stands still), go on with another ``acceleration`` (m/s2), ``radar`` on or off.

        Raises: InputError B-SIM-018 for another name, B-SIM-019 for a value that cannot be.
        """
        self.check_operation(name, value)
        with self.lock:
            if name == "speed":
                self.units.begin_flight(_number(value, "m/s"))
            elif name == "acceleration":
                self.units.accelerate(_number(value, "m/s2"))
            else:
                self.units.set_radar(value == "on")

    @classmethod
    def check_operation(cls, name: str, value: Any) -> None:
        """Raises: InputError B-SIM-018, B-SIM-019."""
        super().check_operation(name, value)
        if name == "radar":
            if value not in _RADAR:
                raise _impossible(name, value, "on or off")
        elif name == "speed" and not 0.0 <= _number(value, "m/s") <= MOST_SPEED_M_S:
            raise _impossible(name, value, f"0 to {MOST_SPEED_M_S:g} m/s")
        elif name == "acceleration" and not abs(_number(value, "m/s2")) <= MOST_ACCELERATION_M_S2:
            raise _impossible(name, value, f"-{MOST_ACCELERATION_M_S2:g} to {MOST_ACCELERATION_M_S2:g} m/s2")

    @property
    def load(self) -> tuple[float, float]:
        return START_V, CURRENT_A

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return estimates(self.units.powers, self.flights, self.sync_options.noise, windows)


def _number(value: Any, unit: str) -> float:
    """Return a number of that unit, or a quantity as text; nan if it is neither."""
    with contextlib.suppress(TypeError, ValueError):
        return float(value)
    with contextlib.suppress(ValueError):
        return parse_quantity(value, unit)
    return math.nan


def _impossible(name: str, value: Any, due: str) -> InputError:
    return InputError("B-SIM-019", f"{name} cannot be {value!r}", where="sets of a prompt", next_step=f"give {due}")


WORLD = SyncWorld
