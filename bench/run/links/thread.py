"""The thread that waits for one port under the wall clock."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable

TURN_MS = 250  # a silent port: how often its thread shows that it lives
GATHER_MS = 6  # bytes that trickle in are read together; a frame that comes whole does not wait


class PortThread:
    """Waits on the descriptor of one port and calls ``on_ready`` when there is something to read.

    ``on_ready`` returns False when the port is gone, which ends the thread. ``on_turn`` is called at least each
    ``TURN_MS``.
    """

    def __init__(self, name: str, descriptor: int, on_ready: Callable[[], bool], on_turn: Callable[[], None]) -> None:
        self._descriptor = descriptor
        self._on_ready = on_ready
        self._on_turn = on_turn
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._loop, name=f"link {name}", daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        everything, wake = select.poll(), select.poll()
        for poller in (everything, wake):
            poller.register(self._wake_read, select.POLLIN)
        everything.register(self._descriptor, select.POLLIN)
        while True:
            ready = [descriptor for descriptor, _ in everything.poll(TURN_MS)]
            self._on_turn()
            if self._wake_read in ready:
                return
            if ready and (not self._on_ready() or wake.poll(GATHER_MS)):
                return

    def stop(self) -> None:
        """End the thread and wait for its end."""
        os.write(self._wake_write, b"x")
        self._thread.join()
        os.close(self._wake_read)
        os.close(self._wake_write)
