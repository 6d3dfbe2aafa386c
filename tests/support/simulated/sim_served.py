"""For tests: a simulated bench served over HiSLIP and raw sockets, and a HiSLIP client made of bytes only."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyvisa
from sim_bench import RecordingUnit, station

from bench.model.clock import Clock, WallClock
from sim_instruments.served.process import InstrumentServers
from sim_instruments.worlds.simulation import open_world

LIMIT_S = 10.0  # far more than anything here takes; a test that fails ends all the same


class Served:
    """A world, its servers and a stock PyVISA manager on pyvisa-py."""

    def __init__(self, clock: Clock, wiring: Any) -> None:
        self.world = open_world("af_converter", clock=clock, seed=5, station=wiring, unit_factory=RecordingUnit)
        self.servers = InstrumentServers(self.world)
        self.visa = pyvisa.ResourceManager("@py")

    def open(self, role: str, timeout_ms: int = 5000) -> Any:
        """A session over HiSLIP."""
        return self._opened(self.servers.resources()[role], timeout_ms)

    def open_socket(self, role: str, timeout_ms: int = 5000) -> Any:
        """A session over the raw socket."""
        return self._opened(self.servers.sockets()[role], timeout_ms)

    def _opened(self, resource: str, timeout_ms: int) -> Any:
        opened = self.visa.open_resource(resource, read_termination="\n", write_termination="\n")
        opened.timeout = timeout_ms
        return opened

    def no_latency(self) -> None:
        """Bus operations take no time: for tests of many of them."""
        for device in self.world.instruments.values():
            device.latency_ns = 0

    def close(self) -> None:
        self.visa.close()
        self.servers.close()
        self.world.close()


@contextmanager
def serve(clock: Clock | None = None, wiring: Any = None) -> Iterator[Served]:
    """The ten instruments, served on the wall clock."""
    served = Served(clock or WallClock(), wiring or station())
    try:
        yield served
    finally:
        served.close()


class Wire:
    """One connection that speaks in headers as IVI-6.1 prints them: "HS", type, control, parameter, length."""

    def __init__(self, port: int) -> None:
        self.sock = socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S)
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # keeps the order of the two channels

    def say(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        self.sock.sendall(b"HS" + struct.pack(">BBIQ", kind, control, parameter, len(payload)) + payload)

    def hear(self) -> tuple[int, int, int, bytes]:
        """Type, control code, parameter and payload of the next message."""
        header = self._exactly(16)
        assert header[:2] == b"HS"
        kind, control, parameter, length = struct.unpack(">BBIQ", header[2:])
        return kind, control, parameter, self._exactly(length)

    def silent(self, seconds: float = 0.1) -> bool:
        """Whether nothing comes for a while."""
        self.sock.settimeout(seconds)
        try:
            return self.sock.recv(1, socket.MSG_PEEK) == b"nothing"
        except TimeoutError:
            return True
        finally:
            self.sock.settimeout(LIMIT_S)

    def ended(self) -> bool:
        """Whether the server has closed the connection."""
        try:
            return self.sock.recv(1) == b""
        except ConnectionResetError:
            return True

    def _exactly(self, count: int) -> bytes:
        received = b""
        while len(received) < count:
            chunk = self.sock.recv(count - len(received))
            assert chunk, "the server has closed the connection"
            received += chunk
        return received


class RawClient:
    """A HiSLIP session of bytes: both channels open."""

    def __init__(self, port: int, name: bytes = b"hislip6") -> None:
        self.sync, self.asynchronous = Wire(port), Wire(port)
        self.sync.say(0, 0, 0x0100_5858, name)
        kind, overlap, parameter, _ = self.sync.hear()
        assert (kind, overlap, parameter >> 16) == (1, 0, 0x0100)
        self.session_id = parameter & 0xFFFF
        self.asynchronous.say(17, 0, self.session_id)
        assert self.asynchronous.hear()[:2] == (18, 0)

    def send(self, text: bytes, message_id: int, delivered: bool = False) -> None:
        self.sync.say(7, int(delivered), message_id, text)

    def status(self, message_id: int = 0, delivered: bool = False) -> int:
        self.asynchronous.say(21, int(delivered), message_id)
        kind, status, _, _ = self.asynchronous.hear()
        assert kind == 22
        return status

    def lock(self, key: bytes = b"", timeout_ms: int = 0) -> int:
        self.asynchronous.say(4, 1, timeout_ms, key)
        return self.locked()

    def locked(self) -> int:
        kind, answer, _, _ = self.asynchronous.hear()
        assert kind == 5
        return answer

    def unlock(self) -> int:
        self.asynchronous.say(4, 0, 0)
        return self.locked()

    def clear(self) -> None:
        self.asynchronous.say(19)
        assert self.asynchronous.hear() == (23, 0, 0, b"")
        self.sync.say(8)
        while (heard := self.sync.hear())[0] != 9:
            assert heard[0] in (6, 7, 13)
        assert heard == (9, 0, 0, b"")

    def close(self) -> None:
        for wire in (self.sync, self.asynchronous):
            wire.sock.close()


def threads() -> set[str]:
    """Names of the threads that serve instruments."""
    return {thread.name for thread in threading.enumerate() if thread.name.startswith(("hislip", "raw socket"))}


def session_count() -> int:
    """How many HiSLIP sessions are served."""
    return sum(thread.name.startswith("hislip session") for thread in threading.enumerate())


def descriptors() -> int:
    """Open descriptors of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))
