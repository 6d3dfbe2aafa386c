"""All benches and everybody who looks at them: a task for each bench, and one that tells the pages twice a second."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from typing import Any

from bench.model.clock import NS, Clock, pause, to_ns
from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.line import line_of
from bench.web.fleet.overview import PROTO
from bench.web.fleet.seat import Seat
from bench.web.room import Room, Viewer
from bench.web.security.tokens import draw_id

TELL_S = 0.5
BEAT_S = 1.0


class Fleet:
    """The benches of one ``fleet.yaml``. Made anywhere, started and stopped on the event loop."""

    def __init__(self, benches: Iterable[FleetBench], clock: Clock) -> None:
        self._clock = clock
        self._seats = [Seat(bench, clock) for bench in benches]
        self._boot_id = draw_id()
        self._tasks: list[asyncio.Task[None]] = []
        self.room = Room(self._state())

    async def start(self) -> None:
        """Open all lines."""
        trusted = ssl.create_default_context()
        lines = [line_of(seat.bench, seat, self._clock, trusted) for seat in self._seats]
        self._tasks = [asyncio.create_task(line.follow()) for line in lines]
        self._tasks.append(asyncio.create_task(self._tell()))

    async def stop(self) -> None:
        """Let go of all lines; no bench notices."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    @asynccontextmanager
    async def watching(self, viewer: Viewer) -> AsyncIterator[Fleet]:
        """Let somebody look; what is seen first is of now."""
        self.room.become(self._state())
        self.room.enter(viewer)
        try:
            yield self
        finally:
            self.room.viewers.discard(viewer)

    async def move(self, said: Mapping[str, Any]) -> None:
        """Benches have no cursor."""

    async def _tell(self) -> None:
        beat_ns = 0
        while True:
            now_ns = self._clock.now_ns()
            if self.room.viewers:
                self.room.become(self._state())
                if now_ns >= beat_ns:
                    self.room.beat(self._clock.utc_ns() / NS, None)
                    beat_ns = now_ns + to_ns(BEAT_S)
            await pause(TELL_S)

    def _state(self) -> dict[str, Any]:
        cards = {seat.bench.name: seat.card() for seat in self._seats}
        return {"proto": PROTO, "boot_id": self._boot_id, "benches": cards}
