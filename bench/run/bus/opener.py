"""The one place of the bench that opens VISA resources and serial ports.

Whether somebody listens at an address on the network is asked before a VISA library that may wait long for it.
"""

from __future__ import annotations

import importlib
import re
import socket
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pyvisa
import serial
from pyvisa.constants import ControlFlow, InterfaceType, Parity, ResourceAttribute
from pyvisa.resources import MessageBasedResource
from pyvisa.rname import ResourceName
from serial.tools import list_ports

from bench.model.clock import Clock
from bench.model.drivers import driver_class
from bench.model.errors import InputError, InstrumentError, LinkError
from bench.model.ports import ByteLink, Instrument, RecordWindow, Transcript
from bench.run.bus.port import InstrumentLink, PortLink
from bench.run.bus.prologix import PrologixBoard, PrologixInstrument
from bench.run.bus.served_world import told
from bench.run.bus.side_by_side import bus_of

if TYPE_CHECKING:
    from bench.plan import Station  # the guard opens instruments too, and must not need plans

SIMULATION = "sim_instruments.worlds.simulation"
SERIAL_HANDLERS = "sim_instruments.bus"
WRITE_LIMIT_S = 1.0
OPERATE = "operate"  # word of the control socket of a served bench
BY_SERIAL_NUMBER = "serial-number:"
CONNECT_S = 1.0
DELIVER_S = 2.0
_ADDRESS = re.compile(r"TCPIP\d*::([^:]+)::(.+)::(INSTR|SOCKET)", re.IGNORECASE)
_HISLIP = re.compile(r"hislip\d*(?:,(\d+))?", re.IGNORECASE)
_HISLIP_PORT = 4880
_PORTMAP = 111  # VXI-11 asks there for its own port


class World(Protocol):
    """A simulated bench."""

    visa_library: str

    def link_url(self, name: str) -> str:
        """Return pySerial URL of a link."""

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        """Return what an analysis of these records should have found."""

    def operate(self, name: str, value: Any) -> None:
        """Do what a person does at the bench: put a unit on it, set a switch. Raises: InputError: an unknown name."""

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

    def operate(self, name: str, value: Any) -> None:
        """Do to a simulated bench what a prompt had a person do; to a real one the person has done it.

        Raises: InputError B-SIM-015 (the bench is served and its process is gone), and the world's own.
        """
        control = self.station.file.control
        if self.world is not None:
            self.world.operate(name, value)
        elif control is not None:
            told(Path(control), (OPERATE, name, str(value)))

    def close(self) -> None:
        """Release every session and port; one that is gone already keeps nothing else open."""
        closers = [instrument.close for instrument in self.instruments.values()]
        closers += [link.close for link in self.links.values()]
        for close in (*closers, self.close_visa):
            with suppress(Exception):
                close()
        if self.world is not None:
            self.world.close()


def open_bench(
    station: Station, clock: Clock, transcript: Transcript, *, seed: int, links: bool | Collection[str] = True,
    roles: Sequence[str] = (),
) -> OpenBench:  # fmt: skip
    """Open the instruments and links of a station; nothing is sent yet.

    Args:   seed: of the simulated world.   links: open the serial links too, all or these.
            roles: only these (default: all).
    Raises: InputError B-RUN-001 (virtual clock with a real station), InstrumentError B-RUN-002 (resource does not
            open), LinkError B-RUN-003 (port does not open).
    """
    if clock.virtual and station.file.world is None:
        raise InputError(
            "B-RUN-001",
            f"station {station.name!r} is not simulated in this process, so the virtual clock is refused",
            where="--clock",
            next_step="use --clock wall, or a station with a simulated world",
        )
    world = _open_world(station, clock, seed)
    if world is None and (missing := missing_buses(station)):
        raise next(iter(missing.values()))
    library = world.visa_library if world is not None else station.file.visa
    visa = open_visa(library, station.boards)
    bench = OpenBench(station, {}, {}, world, visa.close)
    try:
        for role, entry in station.instruments.items():
            if not roles or role in roles:
                bench.instruments[role] = open_instrument(visa, role, entry, clock, transcript, used=world is None)
        if links:
            _open_links(bench, [name for name in station.links if isinstance(links, bool) or name in links])
    except Exception:
        bench.close()
        raise
    return bench


def unheard(role: str, direction: str, text: str, t_mono_ns: int) -> None:
    """Forget what is said on the bus: there is no session it could go to."""


class Visa:
    """A VISA library, and the GPIB boards that are adapters: ``boards`` are the addresses of their streams."""

    def __init__(self, manager: pyvisa.ResourceManager, boards: Mapping[str, str]) -> None:
        self._manager = manager
        self._boards = {name: PrologixBoard(partial(self._connected, at)) for name, at in boards.items()}

    def open(self, role: str, entry: InstrumentAddress) -> MessageBasedResource:
        """Open the address of an instrument. Raises: InstrumentError B-RUN-002."""
        try:
            if (board := self._boards.get(bus_of(entry.resource))) is not None:
                board.connect()
                return PrologixInstrument(board, entry.resource)  # type: ignore[return-value]
            opened = self._connected(entry.resource)
            for name, value in _line_attributes(entry.line):
                opened.set_visa_attribute(name, value)
        except Exception as error:  # a library may let out whatever lies below it
            raise InstrumentError(
                "B-RUN-002",
                f"{entry.resource} does not open: {error}",
                where=role,
                next_step="check the address in the station file and the interface",
            ) from error
        return opened

    def interface_clear(self, resource: str) -> Callable[[], None] | None:
        """Return a function that clears the interface of a GPIB board: who talks or listens starts anew; else None."""
        name = bus_of(resource)
        if (board := self._boards.get(name)) is not None:
            return board.clear

        def clear() -> None:
            with self._manager.open_resource(f"{name}::INTFC") as interface:
                interface.send_ifc()  # type: ignore[attr-defined]

        return clear if name.startswith("GPIB") else None

    def close(self) -> None:
        """Close what is open."""
        for board in self._boards.values():
            board.close()
        self._manager.close()

    def _connected(self, resource: str) -> MessageBasedResource:
        check_answers(resource)
        opened: MessageBasedResource = self._manager.open_resource(resource, resource_pyclass=MessageBasedResource)  # type: ignore[assignment]
        _bound_delivery(opened)
        return opened


def _line_attributes(line: Mapping[str, Any]) -> Iterator[tuple[ResourceAttribute, int]]:
    """Yield what a station says of a serial line as VISA has it; what it does not say stays as the library has it."""
    if line:
        yield ResourceAttribute.asrl_baud_rate, line["baud"]
        yield ResourceAttribute.asrl_data_bits, line["bits"]
        yield ResourceAttribute.asrl_parity, Parity[line["parity"]]
        yield ResourceAttribute.asrl_stop_bits, 10 * line["stop"]
        yield ResourceAttribute.asrl_flow_control, ControlFlow[line["handshake"]]


def open_visa(library: str, boards: Mapping[str, str] | None = None) -> Visa:
    """Return the VISA library of a station, with its adapters. Raises: InstrumentError B-RUN-002."""
    try:
        return Visa(pyvisa.ResourceManager(library), boards or {})
    except (pyvisa.Error, OSError, ValueError) as error:
        raise InstrumentError(
            "B-RUN-002",
            f"no VISA library {library} is found: {' '.join(str(error).split())}",
            where=library,
            next_step="install it, or change 'visa' in the station file ('@py' is installed with this software)",
        ) from error


def missing_buses(station: Station) -> dict[str, InstrumentError]:
    """Return by role why an instrument cannot be reached whatever its address says; one error for all of a kind.

    The VISA library is not installed, or what it needs for a kind of interface is not. Nothing is sent or opened.
    """
    addresses = {role: entry.resource for role, entry in station.instruments.items()}
    resources = {role: station.boards.get(bus_of(address), address) for role, address in addresses.items()}
    library, where = station.file.visa, station.document.where(("visa",))
    try:
        open_visa(library).close()
    except InstrumentError as error:
        error.where = where
        return dict.fromkeys(resources, error)
    kinds: dict[str, list[str]] = {}
    for role, resource in resources.items():
        kinds.setdefault(_unserved(library, resource), []).append(role)
    missing: dict[str, InstrumentError] = {}
    for why, roles in kinds.items():
        if why:
            more = f" and {len(roles) - 1} more" if roles[1:] else ""
            message = f"the VISA library {library} cannot reach {resources[roles[0]]}{more}: {why}"
            next_step = "install it, or change 'visa' or the addresses in the station file"
            unserved = InstrumentError("B-RUN-002", message, where=where, next_step=next_step)
            missing |= dict.fromkeys(roles, unserved)
    return missing


def _unserved(library: str, resource: str) -> str:
    """Return what the pure Python library lacks for the interface of an address; empty if nothing is known to lack."""
    if not library.endswith("@py"):
        return ""
    from pyvisa_py.sessions import Session, UnavailableSession

    importlib.import_module("pyvisa_py.highlevel")  # registers the kinds that it can serve
    name = ResourceName.from_string(resource)
    of_board = name.interface_type == "GPIB"  # of an instrument it says so when it is opened
    try:
        kind = Session.get_session_class(
            InterfaceType[name.interface_type.lower().replace("-", "_")], "INTFC" if of_board else name.resource_class
        )
    except (KeyError, ValueError):
        return f"{name.interface_type} {name.resource_class} is no kind that it knows"
    if not issubclass(kind, UnavailableSession):
        return ""
    return " ".join(kind.session_issue.split()).partition(". ")[0].rstrip(".")


def _open_world(station: Station, clock: Clock, seed: int) -> World | None:
    if (kind := station.file.world) is None:
        return None
    world: World = importlib.import_module(SIMULATION).open_world(
        kind.name, clock=clock, seed=seed, station=station.wiring(), options=station.world_options
    )
    return world


class InstrumentAddress(Protocol):
    """An instrument of a station, as far as opening it needs it."""

    @property
    def driver(self) -> str:
        """Plain name of the driver."""

    @property
    def resource(self) -> str:
        """VISA address."""

    @property
    def options(self) -> Mapping[str, Any]:
        """Options of the driver."""

    @property
    def line(self) -> Mapping[str, Any]:
        """Settings of a serial line; empty: those of the library."""


def open_instrument(
    visa: Visa, role: str, entry: InstrumentAddress, clock: Clock, transcript: Transcript,
    *, used: bool = False,
) -> Instrument:  # fmt: skip
    """Open one instrument; no command is sent. Raises: InstrumentError B-RUN-002.

    Args: used: somebody else had it before, and may have left half a command in its buffer: it gets a device clear.
    """

    def reopen() -> MessageBasedResource:
        return visa.open(role, entry)

    driver, resource = driver_class(entry.driver), reopen()
    if used:
        with suppress(Exception):  # serial lines and raw sockets have none, and every library says so in its own way
            resource.clear()
    instrument: Instrument = driver(
        resource, role=role, clock=clock, transcript=transcript, options=dict(entry.options), reopen=reopen,
        interface_clear=visa.interface_clear(entry.resource),
    )  # fmt: skip
    return instrument


def _bound_delivery(resource: MessageBasedResource) -> None:
    """Have the kernel drop what it could not deliver in ``DELIVER_S``, on the connections of pyvisa-py.

    A command that a network has kept must not switch anything on when the network is back and the bench made safe.
    Source: RFC 5482, tcp(7); elsewhere than on Linux there is no such option.
    """
    limit: int | None = getattr(socket, "TCP_USER_TIMEOUT", None)
    interface = getattr(getattr(resource.visalib, "sessions", {}).get(resource.session), "interface", None)
    for connection in (interface, *getattr(interface, "__dict__", {}).values()):
        if isinstance(connection, socket.socket) and limit is not None:
            connection.setsockopt(socket.IPPROTO_TCP, limit, round(1000 * DELIVER_S))


def _open_links(bench: OpenBench, names: Sequence[str]) -> None:
    world = bench.world
    if world is not None and SERIAL_HANDLERS not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(SERIAL_HANDLERS)
    for name in names:
        entry = bench.station.links[name]
        if entry.instrument is not None:
            bench.links[name] = InstrumentLink(name, bench.instruments[entry.instrument])
        else:
            url = world.link_url(name) if world is not None else str(entry.url)
            bench.links[name] = PortLink(partial(open_port, name, url, entry.baud or 0, exclusive=world is None))


def open_port(name: str, url: str, baud: int, *, exclusive: bool) -> ByteLink:
    """Open one serial port; reads never wait, and nobody else can open it meanwhile.

    No flow control of any kind: a byte 0x11 or 0x13 of a frame is no command to the driver. ``serial-number:XYZ`` is
    the port of the adapter with this serial number, wherever it is plugged in. Raises: LinkError B-RUN-003.
    """
    try:
        port: ByteLink = serial.serial_for_url(
            _located(url), baudrate=baud, timeout=0, write_timeout=WRITE_LIMIT_S, exclusive=exclusive,
            xonxoff=False, rtscts=False, dsrdtr=False,
        )  # fmt: skip
    except (serial.SerialException, OSError, ValueError) as error:
        raise LinkError(
            "B-RUN-003",
            f"{url} does not open: {error}",
            where=name,
            next_step="check the port in the station file and its permissions",
        ) from error
    with suppress(OSError, ValueError, AttributeError, NotImplementedError):  # where the driver has it
        port.set_low_latency_mode(True)  # type: ignore[attr-defined]
    return port


def _located(url: str) -> str:
    """Return the device of a URL with an adapter's serial number; any other URL as it is. Raises: ValueError."""
    wanted = url.removeprefix(BY_SERIAL_NUMBER)
    if wanted == url:
        return url
    ports = list_ports.comports()
    devices = sorted(port.device for port in ports if port.serial_number == wanted)
    if len(devices) != 1:
        known = ", ".join(sorted(port.serial_number for port in ports if port.serial_number)) or "none"
        raise ValueError(f"{len(devices)} ports have the serial number {wanted!r}; there are: {known}")
    return str(devices[0])


def port_of(resource: str) -> tuple[str, int] | None:
    """Return host and TCP port of a VISA address; None for one that is not on the network.

    Source: VPP-4.3 (address strings), IVI-6.1 (HiSLIP port 4880), VXI-11 (port mapper).
    """
    address = _ADDRESS.fullmatch(resource)
    if address is None:
        return None
    host, device, kind = address.groups()
    if kind.upper() == "SOCKET":
        return (host, int(device)) if device.isdigit() else None
    hislip = _HISLIP.fullmatch(device)
    return (host, _PORTMAP if hislip is None else int(hislip[1] or _HISLIP_PORT))


def check_answers(resource: str) -> None:
    """Return if somebody accepts a connection within ``CONNECT_S``, or if the address is not on the network.

    Raises: OSError if nobody does.
    """
    address = port_of(resource)
    if address is not None:
        socket.create_connection(address, CONNECT_S).close()
