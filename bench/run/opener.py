"""The one place of the bench that opens VISA resources and serial ports."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import pyvisa
import serial
from pyvisa.resources import MessageBasedResource

from bench.model.clock import Clock
from bench.model.errors import InputError, InstrumentError, LinkError
from bench.model.ports import ByteLink, Instrument, RecordWindow, Transcript
from bench.plan import Station
from bench.plan.drivers import driver_class

SIMULATION = "sim_instruments.simulation"
SERIAL_HANDLERS = "sim_instruments"
WRITE_LIMIT_S = 2.0


class World(Protocol):
    """A simulated bench."""

    visa_library: str

    def link_url(self, name: str) -> str:
        """pySerial URL of a link."""

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        """What an analysis of these records should have found."""

    def close(self) -> None:
        """Forget the world."""


@dataclass
class OpenBench:
    """An opened station; ``world`` is None on a real one."""

    station: Station
    instruments: dict[str, Instrument]
    links: dict[str, ByteLink]
    world: World | None
    close_visa: Callable[[], None]

    def close(self) -> None:
        """Release every session and port; one that is gone already keeps nothing else open."""
        closers = [instrument.close for instrument in self.instruments.values()]
        closers += [link.close for link in self.links.values()]
        for close in (*closers, self.close_visa):
            with suppress(pyvisa.Error, OSError):
                close()
        if self.world is not None:
            self.world.close()


def open_bench(
    station: Station, clock: Clock, transcript: Transcript, *, seed: int, links: bool = True, roles: Sequence[str] = ()
) -> OpenBench:
    """Open the instruments and links of a station; nothing is sent yet.

    Args:   seed: of the simulated world.   links: open the serial links too.   roles: only these (default: all).
    Raises: InputError B-RUN-001 (virtual clock with a real station), InstrumentError B-RUN-002 (resource does not
            open), LinkError B-RUN-003 (port does not open).
    """
    if clock.virtual and not station.simulated:
        raise InputError(
            "B-RUN-001",
            f"station {station.name!r} is real, so the virtual clock is refused",
            where="--clock",
            next_step="use --clock wall, or a simulated station",
        )
    world = _open_world(station, clock, seed) if station.simulated else None
    library = world.visa_library if world is not None else station.file.visa
    visa = _visa(library)
    bench = OpenBench(station, {}, {}, world, visa.close)
    try:
        for role, entry in station.instruments.items():
            if not roles or role in roles:
                bench.instruments[role] = _open_instrument(visa, role, entry, clock, transcript)
        if links:
            bench.links.update(_open_links(station, world))
    except Exception:
        bench.close()
        raise
    return bench


def _visa(library: str) -> pyvisa.ResourceManager:
    try:
        return pyvisa.ResourceManager(library)
    except (pyvisa.Error, OSError, ValueError) as error:
        raise InstrumentError(
            "B-RUN-002",
            f"no VISA library is found: {' '.join(str(error).split())}",
            where=library,
            next_step="install it, or change 'visa' in the station file",
        ) from error


def _open_world(station: Station, clock: Clock, seed: int) -> World:
    simulation = importlib.import_module(SIMULATION)
    assert station.file.world is not None
    name, options = station.file.world.name, station.world_options
    world: World = simulation.open_world(name, clock=clock, seed=seed, station=station.wiring(), options=options)
    return world


def _open_instrument(
    visa: pyvisa.ResourceManager, role: str, entry: Any, clock: Clock, transcript: Transcript
) -> Instrument:
    try:
        resource = visa.open_resource(entry.resource, resource_pyclass=MessageBasedResource)
    except (pyvisa.Error, OSError, ValueError) as error:
        raise InstrumentError(
            "B-RUN-002",
            f"{entry.resource} does not open: {error}",
            where=role,
            next_step="check the address in the station file and the interface",
        ) from error
    driver = driver_class(entry.driver)
    instrument: Instrument = driver(resource, role=role, clock=clock, transcript=transcript, options=entry.options)
    return instrument


def _open_links(station: Station, world: World | None) -> Mapping[str, ByteLink]:
    if world is not None and SERIAL_HANDLERS not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(SERIAL_HANDLERS)
    opened: dict[str, ByteLink] = {}
    for name, entry in station.links.items():
        url = world.link_url(name) if world is not None else str(entry.url)
        try:
            opened[name] = serial.serial_for_url(
                url, baudrate=entry.baud, timeout=0, write_timeout=WRITE_LIMIT_S, exclusive=world is None
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkError(
                "B-RUN-003",
                f"{url} does not open: {error}",
                where=name,
                next_step="check the port in the station file and its permissions",
            ) from error
    return opened
