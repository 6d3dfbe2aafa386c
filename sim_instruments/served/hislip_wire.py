"""HiSLIP messages on the wire: 16 bytes of header, then the payload; and how a stream of bytes becomes messages.

Source: IVI-6.1, revision 1.1: message header (2.2), message types (table 4), error codes (tables 9 and 10).
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
from dataclasses import dataclass
from enum import IntEnum

HEADER = struct.Struct("!2sBBIQ")
PROLOGUE = b"HS"
MAX_MESSAGE_BYTES = 1 << 20  # header and payload; what the server takes and says so
RMT_DELIVERED = 1  # control bit: the client has handed the last response, to its end, to the application
CHUNK = 65536
SEND_LIMIT_MS = 5000  # a client whose buffers stay full that long is gone


class Type(IntEnum):
    """Message types this server knows; everything of 2.0 (descriptors, TLS, SASL) is unknown to it."""

    INITIALIZE = 0
    INITIALIZE_RESPONSE = 1
    FATAL_ERROR = 2
    ERROR = 3
    ASYNC_LOCK = 4
    ASYNC_LOCK_RESPONSE = 5
    TEXT = 6  # "Data" and "DataEND" in the specification
    TEXT_END = 7
    DEVICE_CLEAR_COMPLETE = 8
    DEVICE_CLEAR_ACKNOWLEDGE = 9
    ASYNC_REMOTE_LOCAL_CONTROL = 10
    ASYNC_REMOTE_LOCAL_RESPONSE = 11
    TRIGGER = 12
    INTERRUPTED = 13
    ASYNC_INTERRUPTED = 14
    ASYNC_MAX_MESSAGE_SIZE = 15
    ASYNC_MAX_MESSAGE_SIZE_RESPONSE = 16
    ASYNC_INITIALIZE = 17
    ASYNC_INITIALIZE_RESPONSE = 18
    ASYNC_DEVICE_CLEAR = 19
    ASYNC_STATUS_QUERY = 21
    ASYNC_STATUS_RESPONSE = 22
    ASYNC_DEVICE_CLEAR_ACKNOWLEDGE = 23
    ASYNC_LOCK_INFO = 24
    ASYNC_LOCK_INFO_RESPONSE = 25


FIRST_VENDOR_TYPE = 128


class Fatal(IntEnum):
    """Reasons to end a connection."""

    BAD_HEADER = 1
    ONE_CHANNEL_ONLY = 2
    BAD_INITIALIZATION = 3
    TOO_MANY_CLIENTS = 4


class Mistake(IntEnum):
    """Reasons to refuse one message."""

    UNIDENTIFIED = 0
    UNKNOWN_TYPE = 1
    UNKNOWN_CONTROL_CODE = 2
    UNKNOWN_VENDOR_MESSAGE = 3
    TOO_LARGE = 4


class FatalProtocolError(Exception):
    """The connection has to end; ``args`` are the reason and its text."""


class RefusedMessage(Exception):
    """One message is refused, the session goes on; ``args`` are the reason and its text."""


@dataclass
class Message:
    """One message; of a ``too_large`` one the payload was thrown away."""

    type: int
    control: int
    parameter: int
    payload: bytes = b""
    too_large: bool = False

    def packed(self) -> bytes:
        """Return the bytes of the message."""
        return HEADER.pack(PROLOGUE, self.type, self.control, self.parameter, len(self.payload)) + self.payload


class Inbox:
    """Messages out of bytes that arrive in pieces of any size; holds one message at most."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._skip = 0

    def feed(self, chunk: bytes) -> list[Message]:
        """Return messages that are complete now. Raises: FatalProtocolError if a header does not begin with "HS"."""
        self._buffer += chunk
        messages = []
        while (message := self._next()) is not None:
            messages.append(message)
        return messages

    def _next(self) -> Message | None:
        dropped = min(self._skip, len(self._buffer))
        del self._buffer[:dropped]
        self._skip -= dropped
        if len(self._buffer) < HEADER.size:
            return None
        prologue, kind, control, parameter, length = HEADER.unpack_from(self._buffer)
        if prologue != PROLOGUE:
            raise FatalProtocolError(Fatal.BAD_HEADER, f"a header begins with {prologue!r}, not with {PROLOGUE!r}")
        if length > MAX_MESSAGE_BYTES - HEADER.size:
            del self._buffer[: HEADER.size]
            self._skip = length
            return Message(kind, control, parameter, too_large=True)
        if len(self._buffer) < HEADER.size + length:
            return None
        payload = bytes(self._buffer[HEADER.size : HEADER.size + length])
        del self._buffer[: HEADER.size + length]
        return Message(kind, control, parameter, payload)


def receive_now(sock: socket.socket) -> bytes | None:
    """Return what has arrived on a non-blocking socket: None if nothing has, empty if the other side is gone."""
    try:
        return sock.recv(CHUNK)
    except BlockingIOError:
        return None
    except OSError:
        return b""


def is_ready(*socks: socket.socket, limit_ms: float | None, event: int = select.POLLIN) -> bool:
    """Wait until one of the sockets can be read, None: however long. Args: event: POLLOUT: until it can be written."""
    awaited = select.poll()
    for sock in socks:
        awaited.register(sock, event)
    return bool(awaited.poll(limit_ms))


def send_all(sock: socket.socket, payload: bytes) -> None:
    """Send over a non-blocking socket. Raises: OSError if the other side is gone, or takes nothing for 5 s."""
    view = memoryview(payload)
    while view:
        try:
            view = view[sock.send(view) :]
        except BlockingIOError:
            if not is_ready(sock, limit_ms=SEND_LIMIT_MS, event=select.POLLOUT):
                raise TimeoutError("the client does not read") from None


def say(sock: socket.socket, kind: Type, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
    """Send one message. Raises: OSError as ``send_all``."""
    send_all(sock, Message(kind, control, parameter, payload).packed())


def say_fatal(sock: socket.socket, error: FatalProtocolError) -> None:
    """Tell the client why the connection ends, if it still listens."""
    with contextlib.suppress(OSError):
        say(sock, Type.FATAL_ERROR, error.args[0], 0, str(error.args[1]).encode())


def shut(sock: socket.socket) -> None:
    """End both directions: whoever waits on the socket wakes up, in any thread."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
