"""The opening of a simulated bench for a run: ``open_world`` builds the world a simulated station describes.

Kinds of simulated benches: in which package each lives, what its ``options`` offer, the class of its ``world``.
"""

from __future__ import annotations

import pkgutil
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from pyvisa import rname

from bench.model.clock import Clock
from bench.model.errors import InputError
from bench.model.installed import (
    Offer,
    driver_packages,
    load,
    named,
    offer_of,
    offers,
    simulator_module,
    spec_of,
    world_parts,
)
from sim_instruments.bus.live import LiveDevice
from sim_instruments.faults.fault import Fault
from sim_instruments.faults.named import every_fault
from sim_instruments.worlds.common.options import Check, number_of, switch_of, text_of, unknown_option
from sim_instruments.worlds.common.world import Unit, World


class _Offered(NamedTuple):
    switches: Mapping[str, str]
    numbers: Mapping[str, tuple[str, float, float]]  # text, least, most
    texts: Mapping[str, tuple[str, Sequence[str] | Check]]  # text, what is possible


def kind_options(name: str) -> tuple[str, ...]:
    """Return the names of all options of a kind of world."""
    offered = _offered(name)
    return (*offered.switches, *offered.numbers, *offered.texts)


def checked_options(name: str, options: Mapping[str, str]) -> dict[str, Any]:
    """Return the options as the world takes them, only those that are given. Raises: InputError B-SIM-002."""
    offered = _offered(name)
    checked: dict[str, Any] = {}
    for key, value in options.items():
        if key in offered.switches:
            checked[key] = switch_of(key, value)
        elif key in offered.numbers:
            checked[key] = number_of(key, value, *offered.numbers[key][1:])
        elif key in offered.texts:
            checked[key] = text_of(key, value, offered.texts[key][1])
        else:
            raise unknown_option(key, kind_options(name))
    return checked


def world_class(name: str) -> type[World]:
    """Return the world of one kind; it is made from (clock, seed, options). Raises: as ``_offer``, and B-PKG-004."""
    kind: type[World] = named(world_parts(_offer(name))[0])
    return kind


def _offered(name: str) -> _Offered:
    return _Offered(*map(named, world_parts(_offer(name))[1:]))


def _offer(name: str) -> Offer:
    """Return the offer of a kind of world. Raises: InputError B-SIM-001; InstallationError B-PKG-001."""
    offer = offer_of("worlds", name)
    if offer is None:
        known = ", ".join(offer.name for offer in offers("worlds"))
        raise InputError("B-SIM-001", f"no simulated world is called {name!r}", next_step=f"use one of: {known}")
    return offer


IDENTITY_FIELDS = 4  # manufacturer, model, serial number, firmware
UnitFactory = Callable[..., Unit]


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
        options: those of the world's own module ``options``, as text.
        unit_factory: makes another unit under test than the world's own, where the world lets it be exchanged.
    Raises:
        InputError: B-SIM-001 unknown world, B-SIM-002 bad option, B-SIM-003 no simulator of that driver,
            B-SIM-004 bad or doubled VISA address, B-SIM-020 slots in a world of one unit.
    """
    make: Any = world_class(name)
    exchanged = {} if unit_factory is None else {"unit_factory": unit_factory}
    made = {"clock": clock, "seed": seed, "options": checked_options(name, options or {}), **exchanged}
    slots = station.get("slots", {})
    world: World = make.in_slots(slots, **made) if slots else make(**made)
    try:
        for role, entry in station.get("instruments", {}).items():
            _connect(world, role, entry)
    except InputError:
        world.close()
        raise
    return world


def check_operation(name: str, what: str, value: Any) -> None:
    """Raises: InputError B-SIM-018, B-SIM-019 if no person can set this at a bench of the kind ``name``."""
    world_class(name).check_operation(what, value)


def possible_faults() -> dict[str, Fault]:
    """Return every fault that some simulated bench can have: of links, interfaces and all models."""
    packages = [package.simulators for package in driver_packages() if package.simulators]
    specs = [spec for spec in map(spec_of, packages) if spec is not None]
    names = [
        f"{spec.name}.{module.name}"
        for spec in specs
        for module in pkgutil.iter_modules(spec.submodule_search_locations)
        if not module.ispkg
    ]
    return every_fault(filter(None, map(_model, names)))


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
    """Return an identity of four fields with the serial number of the register; models without one stay as they are."""
    fields = identity.split(",")
    if len(fields) != IDENTITY_FIELDS or fields[2] == "0" or not serial:
        return identity
    return ",".join([*fields[:2], serial, fields[3]])


def _simulator(driver: str, role: str) -> type[LiveDevice]:
    module = simulator_module(driver) if re.fullmatch("[a-z0-9_]+", driver) else None
    model = None if module is None else _model(module)
    if model is None:
        raise InputError(
            "B-SIM-003",
            f"there is no simulator of the driver {driver!r}",
            where=role,
            next_step="add sim_instruments/<driver>.py, or use a driver that has one",
        )
    return model


def _model(module: str) -> type[LiveDevice] | None:
    """Return the simulated model of a module, None if it holds none."""
    return getattr(load(module), "SIMULATOR", None)
