"""A recording shown like a living run: state and points at a cursor that one viewer moves."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from bench.model.clock import NS, Clock, pause
from bench.model.errors import BenchError
from bench.session.recorded_state import RecordedState
from bench.web.points import KEPT, Points, no_points
from bench.web.room import Room

SPEEDS = (1, 10, 100, 1000)
TICK_S = 0.1
TICKS_PER_STATE = 5
TICKS_PER_BEAT = 10
POINT_S = {1: 0.1, 10: 0.1, 100: 1.0, 1000: 10.0}  # a screen shows a minute of points; faster, they are wider
BLOCK = 200  # points fetched at once

Work = Callable[..., Awaitable[Any]]
"""Does something that takes long in a thread: function, arguments."""

Fetch = Callable[[float, float, float], Points]
"""Points between two times, each as wide as asked for; takes long."""


class ReplayRun:
    """One viewer's replay. It begins at the end of the recording, standing still; played from there it starts anew.

    Args: state: the recording's state, moved by this replay alone. extra: keys that the page server adds.
    """

    def __init__(
        self, state: RecordedState, fetch: Fetch, work: Work, clock: Clock, extra: Callable[[], dict[str, Any]]
    ) -> None:
        self.room = Room({})
        self._state = state
        self._fetch = fetch
        self._work = work
        self._clock = clock
        self._extra = extra
        self._first_s, self._last_s = state.recording.first_utc_s, state.recording.last_utc_s
        self._at_s = self._last_s
        self._speed = SPEEDS[0]
        self._playing = False
        self._jumped = True
        self._block = no_points(0)
        self._block_stop_s = -math.inf
        self._next = 0

    async def move(self, said: Mapping[str, Any]) -> None:
        """Do what the viewer wants: ``playing``, ``speed``, ``at_utc_s``; what makes no sense is not done."""
        at, speed, playing = said.get("at_utc_s"), said.get("speed"), said.get("playing")
        if isinstance(at, int | float) and not isinstance(at, bool) and -math.inf < at < math.inf:
            self._jump(float(min(max(at, self._first_s), self._last_s)))
        if speed in SPEEDS and not isinstance(speed, bool) and speed != self._speed:
            self._speed = int(speed)
            self._jumped = True
        if isinstance(playing, bool):
            if playing and self._at_s >= self._last_s:
                self._jump(self._first_s)
            self._playing = playing

    async def follow(self) -> None:
        """Ten times a second what is new at the cursor, for as long as it is not cancelled."""
        before_ns = self._clock.now_ns()
        ticks = 0
        while True:
            now_ns = self._clock.now_ns()
            if self._jumped:
                await self._begin()
            elif self._playing:
                await self._play((now_ns - before_ns) / NS)
                if ticks % TICKS_PER_STATE == 0 or not self._playing:
                    self.room.become(await self._document())
            before_ns = now_ns
            if ticks % TICKS_PER_BEAT == 0:
                self.room.beat(self._at_s, 0.0)
            ticks += 1
            await pause(TICK_S)

    def _jump(self, at_s: float) -> None:
        self._at_s = at_s
        self._jumped = True

    async def _begin(self) -> None:
        """The cursor has been put somewhere: a snapshot of what is there."""
        self._jumped = False
        self._block_stop_s = -math.inf
        width_s = POINT_S[self._speed]
        state = await self._document()
        points = await self._points(self._at_s - KEPT * width_s, self._at_s)
        self.room.begin(state, self._numbered(points.between(-math.inf, self._at_s).last(KEPT)))

    async def _play(self, elapsed_s: float) -> None:
        before_s = self._at_s
        self._at_s = min(before_s + elapsed_s * self._speed, self._last_s)
        self._playing = self._at_s < self._last_s
        if self._block_stop_s < self._at_s:
            stop_s = self._at_s + BLOCK * POINT_S[self._speed]
            self._block = await self._points(before_s, stop_s)
            self._block_stop_s = stop_s
        if self._jumped:  # moved meanwhile
            return
        self.room.show(self._numbered(self._block.between(before_s, self._at_s)))

    async def _points(self, t0_utc_s: float, t1_utc_s: float) -> Points:
        try:
            points: Points = await self._work(self._fetch, t0_utc_s, t1_utc_s, POINT_S[self._speed])
        except BenchError:  # bytes that cannot be decoded: events and instruments can still be looked at
            return no_points(len(self.room.state.get("signals") or ()))
        return points

    def _numbered(self, points: Points) -> Points:
        numbered = Points(self._next, points.t_utc_s, points.pairs)
        self._next = numbered.stop
        return numbered

    async def _document(self) -> dict[str, Any]:
        state: dict[str, Any] = await self._work(self._state.at, self._at_s)
        cursor = {"first_utc_s": self._first_s, "last_utc_s": self._last_s, "at_utc_s": self._at_s}
        return {**state, **self._extra(), "replay": {**cursor, "speed": self._speed, "playing": self._playing}}
