"""What waits to be sent to one browser: bounded, so that a browser that does not read costs nothing."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence

LONGEST_QUEUE = 50

Outgoing = str | bytes


class Viewer:
    """The queue of one open page. Whoever reads too slowly loses what waits and gets a new snapshot instead."""

    def __init__(self, role: str) -> None:
        self.role = role  # viewer or operator
        self.stale = True  # needs a snapshot before anything else makes sense
        self.dropped = 0  # times the queue overflowed
        self._queue: deque[Outgoing] = deque()
        self._filled = asyncio.Event()

    def put(self, message: Outgoing) -> None:
        """Hand over a message; never waits."""
        if self.stale:
            return  # the snapshot that comes will hold it
        if len(self._queue) >= LONGEST_QUEUE:
            self.dropped += 1
            self.ask_snapshot()
            return
        self._queue.append(message)
        self._filled.set()

    def ask_snapshot(self) -> None:
        """Throw away what waits; the next thing sent is a snapshot."""
        self._queue.clear()
        self.stale = True
        self._filled.set()

    def start(self, messages: Sequence[Outgoing]) -> None:
        """Begin again with the messages of a snapshot."""
        self._queue.clear()
        self._queue.extend(messages)
        self.stale = False
        self._filled.set()

    async def wait(self) -> None:
        """Return when there is something to send, or a snapshot to be made."""
        await self._filled.wait()

    def take(self) -> Outgoing | None:
        """The next message, None if there is none."""
        if self._queue:
            return self._queue.popleft()
        if not self.stale:
            self._filled.clear()
        return None
