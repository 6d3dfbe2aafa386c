"""How a run opens a simulated bench: ``open_world`` builds the world a simulated station describes."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from pyvisa import rname

from bench.model.clock import Clock
from bench.model.errors import InputError
from sim_instruments.live import LiveDevice
from sim_instruments.thermal import Thermal
from sim_instruments.world import Unit, World

WORLDS = ("af_converter",)
WORLD_OPTIONS = {
    "calibrator_gain": "common gain error of the calibrator, N(0, 10 ppm)",
    "calibrator_floor": "range offsets and level errors of the calibrator, N(0, floor/2) of Table 2",
    "dmm_errors": "gain, zero and linearity of the multimeter's current ranges",
}
WORLD_NUMBERS = {
    "calibrator_drift_ppm": "rise of the calibrator's gain per day",
    "time_constants": "divides the lags of chamber and unit and the settling of the calibrator, 1 to 1000",
}
IDENTITY_FIELDS = 4  # manufacturer, model, serial number, firmware
MOST = 1000.0
LEAST = {"time_constants": 1.0}
UNIT_OPTIONS = ("noise", "hysteresis", "master_error_ppm", "af_clock_error_ppm")
UnitFactory = Callable[[Clock, int, Callable[[Any], Any], Mapping[str, str]], Unit]


def open_world(
    name: str,
    *,
    clock: Clock,
    seed: int,
    station: Mapping[str, Any],
    options: Mapping[str, str] | None = None,
    unit_factory: UnitFactory | None = None,
) -> World:
    """Build a simulated bench and register it under an id of its own.

    Args:
        name: kind of world; "af_converter" is the one there is.
        clock: clock of the run.
        seed: seed of every random draw, 0 or positive.
        station: {"instruments": {role: {"driver", "resource", "options"}}, "links": {...}}.
        options: the world's own options (``WORLD_OPTIONS``, each on or off, ``WORLD_NUMBERS``) and the unit's
            (``UNIT_OPTIONS``), as text.
        unit_factory: makes the unit under test from (clock, seed, unit temperature function, options); the
            simulated NGU by default.
    Raises:
        InputError: B-SIM-001 unknown world, B-SIM-002 bad option, B-SIM-003 no simulator of that driver,
            B-SIM-004 bad or doubled VISA address.
    """
    if name not in WORLDS:
        raise InputError(
            "B-SIM-001", f"no simulated world is called {name!r}", next_step=f"use one of: {', '.join(WORLDS)}"
        )
    own, rest = _split_options(options or {})
    make_unit = unit_factory or _simulated_ngu
    thermal = Thermal(float(own.get("time_constants", 1.0)))
    unit = make_unit(clock, seed, thermal.unit, rest)
    world = World(clock=clock, seed=seed, unit=unit, thermal=thermal, options=own)
    try:
        for role, entry in station.get("instruments", {}).items():
            _connect(world, role, entry)
    except InputError:
        world.close()
        raise
    return world


def _simulated_ngu(clock: Clock, seed: int, thermal: Callable[[Any], Any], options: Mapping[str, str]) -> Unit:
    module = importlib.import_module("sim_instruments.ngu")
    return module.Ngu(clock, seed, thermal, options)


def _split_options(options: Mapping[str, str]) -> tuple[dict[str, bool | float], dict[str, str]]:
    own: dict[str, bool | float] = dict.fromkeys(WORLD_OPTIONS, True)
    rest = {}
    for key, value in options.items():
        if key in UNIT_OPTIONS:
            rest[key] = value
        elif key in WORLD_NUMBERS:
            own[key] = _number(key, value)
        elif key not in WORLD_OPTIONS:
            known = ", ".join((*WORLD_OPTIONS, *WORLD_NUMBERS, *UNIT_OPTIONS))
            raise InputError("B-SIM-002", f"no world option is called {key!r}", next_step=f"use one of: {known}")
        elif value not in ("on", "off"):
            raise InputError("B-SIM-002", f"world option {key} is {value!r}", next_step=f"write {key}=on or {key}=off")
        else:
            own[key] = value == "on"
    return own, rest


def _number(key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    least = LEAST.get(key, -MOST)
    if not least <= number <= MOST:
        raise InputError(
            "B-SIM-002", f"world option {key} is {value!r}", next_step=f"write a number from {least:g} to {MOST:g}"
        )
    return number


def _connect(world: World, role: str, entry: Mapping[str, Any]) -> None:
    resource = str(entry["resource"])
    try:
        canonical = rname.to_canonical_name(resource)
    except rname.InvalidResourceName as error:
        raise InputError("B-SIM-004", f"{resource!r} is not a VISA address", where=role) from error
    if canonical in world.devices.list_resources():
        raise InputError(
            "B-SIM-004", f"two instruments stand at {canonical}", where=role, next_step="give each its own address"
        )
    simulator = _simulator(str(entry["driver"]), role)
    device = simulator(world, role, entry.get("options") or {})
    device.identity = _with_serial(device.identity, str(entry.get("serial") or ""))
    world.connect(canonical, device)


def _with_serial(identity: str, serial: str) -> str:
    """An identity of four fields with the serial number of the register; models that tell none stay as they are."""
    fields = identity.split(",")
    if len(fields) != IDENTITY_FIELDS or fields[2] == "0" or not serial:
        return identity
    return ",".join([*fields[:2], serial, fields[3]])


def _simulator(driver: str, role: str) -> type[LiveDevice]:
    module_name = f"sim_instruments.{driver}"
    found: Any = None
    if re.fullmatch("[a-z0-9_]+", driver):
        try:
            found = getattr(importlib.import_module(module_name), "SIMULATOR", None)
        except ModuleNotFoundError as error:
            if error.name != module_name:
                raise
    if found is None:
        raise InputError(
            "B-SIM-003",
            f"there is no simulator of the driver {driver!r}",
            where=role,
            next_step="add sim_instruments/<driver>.py, or use a driver that has one",
        )
    return found
