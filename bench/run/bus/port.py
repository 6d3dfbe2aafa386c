"""Where the bytes of a link come from: a serial port, or what an instrument has buffered, read as one reads a port.

A port loses nothing, tells the kernel's error counters, can be opened again, and has a thread that waits for it.
"""

from __future__ import annotations

import os
import select
import struct
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

from bench.model.errors import InputError, InstrumentError
from bench.model.ports import ByteLink, Instrument
from bench.model.posix import device_answer

READ_BYTES = 65_536  # a terminal gives 4 KiB at most; a larger buffer costs more than the read
TIOCGICOUNT = 0x545D  # Linux, asm-generic/ioctls.h
_COUNTS = struct.Struct("20i")  # serial_icounter_struct of linux/serial.h: 11 counters, 9 reserved
_PLACES = {"frame": 6, "overrun": 7, "parity": 8, "buf_overrun": 10}
TURN_MS = 250  # a silent port: how often its thread shows that it lives
GATHER_MS = 6  # bytes that trickle in are read together; a frame that comes whole does not wait


@runtime_checkable
class Reopenable(Protocol):
    """A link that can be opened again after its port was gone."""

    def reopen(self) -> None:
        """Close what is left and open the same identity again, its input empty. Raises: LinkError B-RUN-003."""


class PortLink:
    """A ByteLink around pySerial's port that can be opened again.

    pySerial's own read drops the bytes it holds when the port goes away in the middle of a call; here each call is
    one read of the descriptor, so what came before the end is handed on. A port without a descriptor (another URL
    handler) is read through its own interface.
    """

    def __init__(self, open_port: Callable[[], ByteLink]) -> None:
        self._open = open_port
        self._take(open_port())

    def _take(self, port: ByteLink) -> None:
        descriptor = descriptor_of(port)
        self._port, self._waits = port, descriptor is not None and os.get_blocking(descriptor)

    def read(self, size: int = 1) -> bytes:
        """Up to ``size`` bytes that are there; never waits. Raises: OSError when the port is gone."""
        descriptor = descriptor_of(self._port)
        if descriptor is None:
            return self._port.read(size)
        if self._waits and not _is_ready(descriptor):
            return b""
        chunk = _taken(descriptor, size)
        if chunk or not _is_ready(descriptor):  # nothing to read is no end, unless the port says it could be read
            return chunk
        chunk = _taken(descriptor, size)
        if not chunk and not os.isatty(descriptor):  # of a terminal that is there, somebody else has taken it
            raise OSError("the port was hung up")
        return chunk

    def arrivals(self, turns_ns: Sequence[int]) -> Sequence[int]:
        """Bytes that can be read at each of the coming times; nobody knows them of a real port. Raises: OSError."""
        ask = getattr(self._port, "arrivals", None)
        return () if ask is None else ask(turns_ns)

    def write(self, data: bytes) -> int | None:
        """Send bytes. Raises: OSError."""
        return self._port.write(data)

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return self._port.in_waiting

    def fileno(self) -> int:
        """Descriptor of the port, -1 if it has none."""
        descriptor = descriptor_of(self._port)
        return -1 if descriptor is None else descriptor

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def reopen(self) -> None:
        """Close what is left and open the same identity again. Raises: LinkError B-RUN-003."""
        with suppress(OSError):
            self._port.close()
        self._take(self._open())


def descriptor_of(link: object) -> int | None:
    """Descriptor that says when there is something to read; None for a link that has none."""
    ask = getattr(link, "fileno", None)
    if ask is None:
        return None
    try:
        descriptor = int(ask())
    except (OSError, ValueError):
        return None
    return descriptor if descriptor >= 0 else None


def readers_beside(link: object) -> str:
    """Return the other processes that have the port of a link open: "4711 (cat)"; "" if none is seen.

    Those of other users are not seen; the far side of a pseudo-terminal is none of them. Source: proc(5).
    """
    descriptor = descriptor_of(link)
    if descriptor is None or not os.isatty(descriptor):
        return ""
    name, found = os.ttyname(descriptor), []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            opened = {str(place.readlink()) for place in process.joinpath("fd").iterdir()}
            if name in opened and int(process.name) != os.getpid() and not ("/pts/" in name and "/dev/ptmx" in opened):
                found.append(f"{process.name} ({process.joinpath('comm').read_text().strip()})")
    return ", ".join(found)


def cure(link: object) -> str:
    """Return what to do about a link whose frames are missing."""
    beside = readers_beside(link)
    return f"end process {beside}" if beside else "check supply, cable and stream mode of the unit"


def _is_ready(descriptor: int) -> bool:
    ready = select.poll()
    ready.register(descriptor, select.POLLIN)
    return bool(ready.poll(0))


def _taken(descriptor: int, size: int) -> bytes:
    try:
        return os.read(descriptor, min(size, READ_BYTES))
    except BlockingIOError:
        return b""


def kernel_counts(link: object) -> dict[str, int] | None:
    """Return what the kernel counted since the driver was loaded: frame, overrun, parity, buf_overrun.

    None where the driver does not count (pseudo-terminals, other URL handlers). Source: tty_ioctl(2), TIOCGICOUNT.
    """
    descriptor = descriptor_of(link)
    if descriptor is None:
        return None
    try:
        answer = device_answer(descriptor, TIOCGICOUNT, _COUNTS.size)
    except OSError:
        return None
    values = _COUNTS.unpack(answer)
    return {name: values[place] for name, place in _PLACES.items()}


class PortThread:
    """Waits on the descriptor of one port and calls ``on_ready`` when there is something to read.

    What comes within ``GATHER_MS`` behind a reading waits until then. ``on_ready`` returns False when the port is gone,
    which ends the thread. ``on_turn`` is called at least each ``TURN_MS``.
    """

    def __init__(
        self,
        name: str,
        descriptor: int,
        on_ready: Callable[[], bool],
        on_turn: Callable[[], None],
        now_ns: Callable[[], int],
    ) -> None:
        self._descriptor = descriptor
        self._on_ready = on_ready
        self._on_turn = on_turn
        self._now_ns = now_ns
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._loop, name=f"link {name}", daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        everything, wake = select.poll(), select.poll()
        for poller in (everything, wake):
            poller.register(self._wake_read, select.POLLIN)
        everything.register(self._descriptor, select.POLLIN)
        gathered_ns, trickles = self._now_ns(), False
        while True:
            ready = everything.poll(0) if trickles else []
            trickles = bool(ready)
            ready = ready or everything.poll(TURN_MS)
            self._on_turn()
            if any(descriptor == self._wake_read for descriptor, _ in ready):
                return
            if not ready:
                continue
            early_ms = (gathered_ns - self._now_ns()) / 1e6
            trickles = trickles or early_ms > 0  # then the next ones are waited for without looking whether they come
            if (early_ms > 0 and wake.poll(early_ms)) or not self._on_ready():
                return
            gathered_ns = self._now_ns() + GATHER_MS * 1_000_000
            if trickles and wake.poll(GATHER_MS):
                return

    def stop(self) -> None:
        """End the thread and wait for its end."""
        os.write(self._wake_write, b"x")
        self._thread.join()
        os.close(self._wake_read)
        os.close(self._wake_write)


@runtime_checkable
class StreamSource(Protocol):
    """An instrument that measures by itself and keeps what it finds until it is read."""

    def read_stream(self, most_bytes: int) -> bytes:
        """Return what is buffered, at most so much; b"" at once if there is nothing. Raises: InstrumentError."""


class InstrumentLink:
    """A ByteLink on the buffer of an instrument; reading it again is all it takes to open it again.

    Raises: InputError B-RUN-007 if the instrument has no such buffer.
    """

    def __init__(self, name: str, instrument: Instrument) -> None:
        if not isinstance(instrument, StreamSource):
            message = f"{instrument.role} buffers nothing that could be read as a link"
            raise InputError("B-RUN-007", message, where=name, next_step="name another instrument in the station file")
        self._source: StreamSource = instrument

    def read(self, size: int = 1) -> bytes:
        """Return what the instrument has buffered. Raises: OSError if it cannot be read."""
        try:
            return self._source.read_stream(size)
        except InstrumentError as error:
            raise OSError(error.message) from error

    def write(self, data: bytes) -> int | None:
        """Raises: OSError: a buffer takes no commands."""
        raise OSError(f"{len(data)} bytes for an instrument, which is commanded over its bus")

    @property
    def in_waiting(self) -> int:
        """Nobody knows before it is read."""
        return 0

    def close(self) -> None:
        """The instrument is closed by whoever opened it."""

    def reopen(self) -> None:
        """The next reading shows whether it is there."""
