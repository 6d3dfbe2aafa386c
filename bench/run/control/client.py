"""Asks the feed of a run, for a page or a terminal view."""

from __future__ import annotations

import json
import socket
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import InputError, unknown_form
from bench.model.posix import unix_socket
from bench.run.control.local_socket import LIVE, find_socket

ANSWER_S = 2.0
LONGEST_REPLY = 16_000_000
LENGTHS = struct.Struct("<II")  # of header and points, before them
LENGTHS_BYTES = LENGTHS.size


class FeedGone(InputError):
    """Nobody answers: the run has ended, has been killed, or hangs."""


@dataclass(frozen=True)
class FeedReply:
    """One answer of a run.

    header: as in docs/live-protocol.md, with ``state`` if it was asked for.   t_utc_s: (n,) seconds since 1970 UTC.
    low, high: (n, signals) float32, NaN where nothing came.   packed: the points as they came, bytes of the protocol.
    """

    header: dict[str, Any]
    t_utc_s: NDArray[np.float64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    packed: bytes


class FeedClient:
    """Asks the run of one session; keeps its connection and opens it again by itself. For one thread at a time."""

    def __init__(self, folder: Path, answer_s: float = ANSWER_S) -> None:
        self._folder = folder
        self._answer_s = answer_s
        self._connection: socket.socket | None = None

    def poll(self, since: int, state: bool = True) -> FeedReply:
        """Return points from number ``since`` on, and the state document.

        Raises: FeedGone B-RUN-100 if nobody answers within 2 s, or not in the protocol.
        """
        try:
            if self._connection is not None:
                try:
                    return self._exchange(self._connection, since, state)
                except TimeoutError:
                    raise
                except OSError:  # let go for being silent, or another run of the session answers by now
                    self.close()
            self._connection = self._connect()
            return self._exchange(self._connection, since, state)
        except (OSError, ValueError, RecursionError) as error:
            self.close()
            raise gone(self._folder, error) from error

    def close(self) -> None:
        """Let the connection go."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _connect(self) -> socket.socket:
        connection = unix_socket()
        try:
            connection.settimeout(self._answer_s)
            connection.connect(str(find_socket(self._folder, LIVE)))
        except OSError:
            connection.close()
            raise
        return connection

    def _exchange(self, connection: socket.socket, since: int, state: bool) -> FeedReply:
        connection.sendall(request(since, state))
        header, packed = lengths(_exactly(connection, LENGTHS_BYTES))
        return understood(_exactly(connection, header), _exactly(connection, packed), state)


def _exactly(connection: socket.socket, count: int) -> bytes:
    received = bytearray()
    while len(received) < count:
        chunk = connection.recv(min(1 << 20, count - len(received)))
        if not chunk:
            raise ConnectionResetError("the connection was closed")
        received += chunk
    return bytes(received)


def gone(folder: Path, error: Exception) -> FeedGone:
    """Return what is said where the run of a session does not answer."""
    return FeedGone(
        "B-RUN-100",
        f"no run of this session answers ({getattr(error, 'strerror', None) or str(error) or 'timed out'})",
        where=str(folder),
        next_step="its recording can be looked at; 'bench resume SESSION' goes on with one that ended early",
    )


def request(since: int, state: bool) -> bytes:
    """Return the question for points from number ``since`` on, and for the state document."""
    return json.dumps({"since": since, "state": state}).encode() + b"\n"


def lengths(head: bytes) -> tuple[int, int]:
    """Return how many bytes of header and of points follow the first ``LENGTHS_BYTES``. Raises: ValueError."""
    header, packed = LENGTHS.unpack(head)
    if header + packed > LONGEST_REPLY:
        raise ValueError(f"a reply of {header + packed} bytes")
    return header, packed


def understood(told: bytes, packed: bytes, state: bool) -> FeedReply:
    """Return a reply of its two parts. Raises: ValueError for what no run of this protocol says."""
    header = json.loads(told)
    if not isinstance(header, dict) or not isinstance(header.get("boot_id"), str):
        raise ValueError("no reply of the feed")
    if why := unknown_form(header, "proto"):
        raise ValueError(f"it answers in a live protocol {why}: look at it with the version that runs it")
    if not all(type(header.get(name)) is int and header[name] >= 0 for name in ("first", "n", "signals", "seq")):
        raise ValueError("no reply of the feed")
    if state and not isinstance(header.get("state"), dict):
        raise ValueError("no reply of the feed")
    n, signals = header["n"], header["signals"]
    times = np.frombuffer(packed, "<f8", n)
    spans = np.frombuffer(packed, "<f4", 2 * n * signals, offset=times.nbytes).reshape(n, signals, 2)
    return FeedReply(header, times, spans[:, :, 0], spans[:, :, 1], packed)
