"""A serial port as the acquisition holds it: reads that lose nothing, the kernel's error counters, and a way back."""

from __future__ import annotations

import fcntl
import os
import select
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol, runtime_checkable

from bench.model.ports import ByteLink

READ_BYTES = 65_536  # a terminal gives 4 KiB at most; a larger buffer costs more than the read
TIOCGICOUNT = 0x545D  # Linux, asm-generic/ioctls.h
_COUNTS = struct.Struct("20i")  # serial_icounter_struct of linux/serial.h: 11 counters, 9 reserved
_PLACES = {"frame": 6, "overrun": 7, "parity": 8, "buf_overrun": 10}


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
        self._port = open_port()

    def read(self, size: int = 1) -> bytes:
        """Up to ``size`` bytes that are there; never waits. Raises: OSError when the port is gone."""
        descriptor = descriptor_of(self._port)
        if descriptor is None:
            return self._port.read(size)
        ready = select.poll()
        ready.register(descriptor, select.POLLIN)
        if not ready.poll(0):
            return b""
        try:
            chunk = os.read(descriptor, min(size, READ_BYTES))
        except BlockingIOError:
            return b""
        if not chunk:
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
        self._port = self._open()


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


def kernel_counts(link: object) -> dict[str, int] | None:
    """Return what the kernel counted since the driver was loaded: frame, overrun, parity, buf_overrun.

    None where the driver does not count (pseudo-terminals, other URL handlers). Source: tty_ioctl(2), TIOCGICOUNT.
    """
    descriptor = descriptor_of(link)
    if descriptor is None:
        return None
    try:
        answer = fcntl.ioctl(descriptor, TIOCGICOUNT, bytes(_COUNTS.size))
    except OSError:
        return None
    values = _COUNTS.unpack(answer)
    return {name: values[place] for name, place in _PLACES.items()}
