"""How a run opens a simulated bench: ``open_world`` builds the world a simulated station describes."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping
from typing import Any

from pyvisa import rname

from bench.model.clock import Clock
from bench.model.errors import InputError
from bench.model.installed import offers, simulator_module
from sim_instruments.bus.live import LiveDevice
from sim_instruments.worlds.common.options import number_of, switch_of, unknown_option
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Unit, World
from sim_instruments.worlds.kinds import checked_options, kind_options, kind_world, world_class

_OWN_OPTIONS = ("af_converter", "gnc_module")  # worlds whose options stand here
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
MOST_TILT_ARCMIN = 60.0
UNIT_OPTIONS = ("noise", "hysteresis", "master_error_ppm", "af_clock_error_ppm")
GNC_OPTIONS = {
    "imu_errors": "scale, cross terms, biases and temperature effects of the sensors, iron at the magnetometer",
    "noise": "noise, bias instability and turn-on bias of the sensors",
}
GNC_NUMBERS = {"tilt_arcmin": "tilt of the unit on the table, standard deviation by axis and pose, 0 to 60"}
GNC_TEXTS = {"faults": "faults of units by serial number, GNC-02=flash_weak_cell,GNC-03=gps_silent+io_open"}
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
        name: of a world that is installed.
        clock: clock of the run.
        seed: seed of every random draw, 0 or positive.
        station: {"instruments": {role: {"driver", "resource", "options"}}, "links": {...}}.
        options: of the AF-converter bench its own (``WORLD_OPTIONS``, each on or off, ``WORLD_NUMBERS``) and the
            unit's (``UNIT_OPTIONS``), of the GNC bench ``GNC_OPTIONS``, ``GNC_NUMBERS`` and ``GNC_TEXTS``; as text.
        unit_factory: makes the unit under test of the AF-converter bench from (clock, seed, unit temperature
            function, options); the simulated NGU by default.
    Raises:
        InputError: B-SIM-001 unknown world, B-SIM-002 bad option, B-SIM-003 no simulator of that driver,
            B-SIM-004 bad or doubled VISA address.
    """
    worlds = offers("worlds")
    if name not in worlds:
        known = ", ".join(worlds)
        raise InputError("B-SIM-001", f"no simulated world is called {name!r}", next_step=f"use one of: {known}")
    if name == "gnc_module":
        world = _gnc_world(clock, seed, options or {})
    elif name not in _OWN_OPTIONS:
        world = kind_world(name, clock, seed, options or {})
    else:
        world = _af_world(clock, seed, options or {}, unit_factory or _simulated_ngu)
    try:
        for role, entry in station.get("instruments", {}).items():
            _connect(world, role, entry)
    except InputError:
        world.close()
        raise
    return world


def options_of(name: str) -> tuple[str, ...]:
    """Names of all options of a kind of world."""
    if name == "gnc_module":
        return (*GNC_OPTIONS, *GNC_NUMBERS, *GNC_TEXTS)
    if name not in _OWN_OPTIONS:
        return kind_options(name)
    return (*WORLD_OPTIONS, *WORLD_NUMBERS, *UNIT_OPTIONS)


def check_operation(name: str, what: str, value: Any) -> None:
    """Raises: InputError B-SIM-018, B-SIM-019 if no person can set this at a bench of the kind ``name``."""
    found: type[World] = World
    if name == "gnc_module":
        found = importlib.import_module("sim_instruments.worlds.gnc.world").GncWorld
    elif name not in _OWN_OPTIONS:
        found = world_class(name)
    found.check_operation(what, value)


def check_options(name: str, options: Mapping[str, str]) -> None:
    """Raises: InputError B-SIM-002 if a world of the kind ``name`` cannot be opened with these options."""
    if name == "gnc_module":
        _gnc_options(options)
    elif name not in _OWN_OPTIONS:
        checked_options(name, options)
    else:
        _split_options(options)


def _af_world(clock: Clock, seed: int, options: Mapping[str, str], make_unit: UnitFactory) -> World:
    own, rest = _split_options(options)
    thermal = Thermal(float(own.get("time_constants", 1.0)))
    unit = make_unit(clock, seed, thermal.unit, rest)
    return World(clock=clock, seed=seed, unit=unit, thermal=thermal, options=own)


def _gnc_world(clock: Clock, seed: int, options: Mapping[str, str]) -> World:
    module = importlib.import_module("sim_instruments.worlds.gnc.world")
    world: World = module.GncWorld(clock=clock, seed=seed, options=_gnc_options(options))
    return world


def _gnc_options(options: Mapping[str, str]) -> dict[str, bool | float | str]:
    found: dict[str, bool | float | str] = dict.fromkeys(GNC_OPTIONS, True)
    for key, value in options.items():
        if key in GNC_OPTIONS:
            found[key] = switch_of(key, value)
        elif key in GNC_NUMBERS:
            found[key] = number_of(key, value, 0.0, MOST_TILT_ARCMIN)
        elif key in GNC_TEXTS:
            found[key] = value
        else:
            raise unknown_option(key, options_of("gnc_module"))
    importlib.import_module("sim_instruments.worlds.gnc.faults").parse_faults(str(found.get("faults", "")))
    return found


def _simulated_ngu(clock: Clock, seed: int, thermal: Callable[[Any], Any], options: Mapping[str, str]) -> Unit:
    module = importlib.import_module("sim_instruments.worlds.af_converter.ngu")
    return module.Ngu(clock, seed, thermal, options)


def _split_options(options: Mapping[str, str]) -> tuple[dict[str, bool | float], dict[str, str]]:
    own: dict[str, bool | float] = dict.fromkeys(WORLD_OPTIONS, True)
    rest = {}
    for key, value in options.items():
        if key in UNIT_OPTIONS:
            rest[key] = value
        elif key in WORLD_NUMBERS:
            own[key] = number_of(key, value, LEAST.get(key, -MOST), MOST)
        elif key not in WORLD_OPTIONS:
            raise unknown_option(key, options_of("af_converter"))
        else:
            own[key] = switch_of(key, value)
    return own, rest


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
    module = simulator_module(driver) if re.fullmatch("[a-z0-9_]+", driver) else None
    found: Any = None if module is None else getattr(importlib.import_module(module), "SIMULATOR", None)
    if found is None:
        raise InputError(
            "B-SIM-003",
            f"there is no simulator of the driver {driver!r}",
            where=role,
            next_step="add sim_instruments/<driver>.py, or use a driver that has one",
        )
    return found
