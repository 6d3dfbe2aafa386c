"""A GPIB board that is a Prologix adapter, or one that speaks as it does (AR488): all its instruments share one stream.

pyvisa-py 0.8.1 serves such a board, too. It is not used: there the time limit of an instrument has no effect (2 s
always), a reply after more than 50 ms is lost, a terminator is refused, a serial poll behind a command reads the reply
away, and what comes late is the answer to the next question: ``VOLT?`` was answered by a status byte (tried on the
simulated adapter).

Source: Prologix GPIB-USB Controller User Manual, 2011, 7 (escapes), 7.1 and 8 (commands, the same with Ethernet).
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

# nothing is kept in its memory, it is the controller and reads when it is told to; a line feed and EOI end a command
_SETTINGS = (b"++savecfg 0", b"++mode 1", b"++auto 0", b"++eos 2", b"++eoi 1", b"++eot_enable 0")
_VERSION = b"++ver"
_ANSWER_MS = 1000
_LONGEST_READ_MS = 3000
_MOST_STALE = 16
_SPECIAL = re.compile(rb"[\x1b\r\n+]")
_SECONDARY = 96  # on the bus secondary addresses count from there, in VISA from 0


class PrologixBoard:
    """The stream to an adapter. Args: open_stream: opens it; its terminators are set here.

    What the adapter does it does in order, so it is in step again once it has told its version behind what was late.
    """

    def __init__(self, open_stream: Callable[[], Any]) -> None:
        self._open_stream = open_stream
        self._stream: Any = None
        self._version = ""
        self._late = False  # a line may still come that nobody waits for
        self._lock = threading.Lock()

    def connect(self) -> None:
        """Open the stream, unless the adapter answers. Raises: OSError, and what the library raises."""
        with self._lock:
            if self._stream is not None:
                with suppress(OSError):
                    self._settle()
                    return
            self._stream = self._open_stream()
            self._stream.write_termination = self._stream.read_termination = "\n"
            self._version = "ver"  # part of what every one of them answers
            self._stream.write_raw(b"\n".join([*_SETTINGS, b""]))
            self._version = self._settle()
            self._settle()  # refuses what only looked like a version, left by an earlier client

    def exchange(self, limit_ms: float, *lines: bytes, answers: bool = False) -> str:
        """Send lines, and return the one that comes back if one does.

        Raises: OSError if the adapter is gone, and what the library raises.
        """
        with self._lock:
            if self._late:
                self._settle()
            if self._stream is None:
                raise ConnectionError("the adapter is not connected")
            self._stream.timeout = limit_ms
            self._late = answers
            self._stream.write_raw(b"\n".join([*lines, b""]))
            reply = str(self._stream.read()) if answers else ""
            self._late = False
            return reply

    def clear(self) -> None:
        """Clear the interface: whoever talks or listens starts anew. Raises: as ``exchange``."""
        self.exchange(_ANSWER_MS, b"++ifc")

    def close(self) -> None:
        """Close the stream; idempotent."""
        stream, self._stream = self._stream, None
        with suppress(Exception):  # one that is gone is closed
            stream.close()

    def _settle(self) -> str:
        """Return the version, once everything before it has come. Raises: OSError; the stream is closed then."""
        try:
            self._stream.timeout = _ANSWER_MS
            self._stream.write_raw(_VERSION + b"\n")
            for _ in range(_MOST_STALE):
                line = str(self._stream.read()).strip()
                if self._version in line:
                    self._late = False
                    return line
        except Exception as error:
            self.close()
            raise ConnectionError(f"the adapter does not tell its version: {error}") from error
        self.close()
        raise ConnectionError("the adapter does not tell its version, but other things")


class PrologixInstrument:
    """An instrument of a board: as much of a PyVISA resource as a driver uses. Args: resource_name: GPIB0::22::INSTR.

    The address goes out with each message, so that nothing goes to an instrument that another one was meant for.
    """

    write_termination = read_termination = "\n"

    def __init__(self, board: PrologixBoard, resource_name: str) -> None:
        self.resource_name = resource_name
        self.timeout = float(_ANSWER_MS)
        primary, *secondary = (int(part) for part in resource_name.split("::")[1:] if part.isdecimal())
        self._address = " ".join(str(part) for part in (primary, *(_SECONDARY + part for part in secondary))).encode()
        self._board = board

    def write(self, message: str) -> None:
        """Send a message. Raises: OSError, and what the library raises."""
        self._exchange(_SPECIAL.sub(b"\x1b\\g<0>", message.encode("ascii")))

    def read(self) -> str:
        """Return the reply, which ends with a line feed; the adapter waits as long for it as the program does."""
        limit = b"%d" % min(max(self.timeout, 1), _LONGEST_READ_MS)
        return self._exchange(b"++read_tmo_ms " + limit, b"++read eoi", answers=True)

    def read_stb(self) -> int:
        """Return the status byte by serial poll."""
        reply = self._board.exchange(self.timeout, b"++spoll " + self._address, answers=True)
        try:
            return int(reply)
        except ValueError as error:
            raise OSError(f"{reply!r} is no status byte") from error

    def clear(self) -> None:
        """Clear the device; returns when that is done."""
        self._exchange(b"++clr", _VERSION, answers=True)

    def close(self) -> None:
        """Leave the board to the others."""

    def _exchange(self, *lines: bytes, answers: bool = False) -> str:
        return self._board.exchange(self.timeout, b"++addr " + self._address, *lines, answers=answers)
