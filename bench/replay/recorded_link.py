"""A recorded link that serves the port of the bench again: the same bytes at the same times of another clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path

from bench.model.clock import Clock
from bench.record import Message, SessionReader


class RecordedLink:
    """Implements bench.model.ports.ByteLink from what a link once received.

    Bytes received ``t`` after the first message of the session can be read ``t`` after this object was made. What is
    written is accepted and forgotten: the answers are already in the recording.
    Raises: InputError B-REC-010 if the folder holds no session.
    """

    def __init__(self, folder: Path, link: str, clock: Clock) -> None:
        reader = SessionReader(folder)
        self._clock = clock
        first = next(reader.messages(), None)
        self._shift_ns = clock.now_ns() - (first.t_ns if first is not None else 0)
        self._messages: Iterator[Message] = reader.messages(frozenset({f"/link/{link}/rx"}))
        self._next = next(self._messages, None)
        self._ready: deque[bytes] = deque()
        self._waiting = 0

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        now_ns = self._clock.now_ns()
        while self._next is not None and self._next.t_ns + self._shift_ns <= now_ns:
            self._ready.append(self._next.payload)
            self._waiting += len(self._next.payload)
            self._next = next(self._messages, None)
        return self._waiting

    @property
    def exhausted(self) -> bool:
        """True when the recording holds nothing more."""
        return self._next is None and not self._ready

    def read(self, size: int = 1) -> bytes:
        """Up to ``size`` bytes that are there."""
        left = min(size, self.in_waiting)
        self._waiting -= left
        parts = []
        while left:
            chunk = self._ready.popleft()
            if len(chunk) > left:
                self._ready.appendleft(chunk[left:])
                chunk = chunk[:left]
            parts.append(chunk)
            left -= len(chunk)
        return b"".join(parts)

    def write(self, data: bytes) -> int:
        """Accept bytes to the unit."""
        return len(data)

    def close(self) -> None:
        """Nothing more can be read."""
        self._next = None
        self._ready.clear()
        self._waiting = 0
