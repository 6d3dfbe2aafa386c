"""Follows a living run through its feed while somebody looks at it; asks nothing but the feed's socket."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from bench.model.clock import NS, Clock, pause, to_ns
from bench.model.posix import unix_socket
from bench.record import OPEN_MARKER
from bench.run.control.local_socket import LIVE, find_socket
from bench.run.feed.client import FeedClient, FeedGone, FeedReply
from bench.web.now import silent_row
from bench.web.points import MISSING_BEFORE, Points
from bench.web.room import Room

POLL_S = 0.1
POLLS_PER_STATE = 5  # the state twice a second
BEAT_S = 1.0
LOST_S = 3.0  # without an answer: the run is lost, whatever it said last
FIRST_RETRY_S, LONGEST_RETRY_S = 0.25, 5.0

Ask = Callable[[int, bool], Awaitable[FeedReply]]
"""Asks the feed for the points from a number on, and for the state if wanted. Raises FeedGone."""

Extra = Callable[[], dict[str, Any]]
"""What the page server adds to the state of a run."""


class LiveRun:
    """One living run and the room it is shown in.

    Args: ask: reaches the run's feed. extra: keys of the state that the page server adds. ended: the final state of a
        run whose recording is closed, asked for once.
    """

    def __init__(
        self, folder: Path, ask: Ask, clock: Clock, extra: Extra, ended: Callable[[], Awaitable[dict[str, Any]]]
    ) -> None:
        self.folder = folder
        self.room = Room({})
        self._ask = ask
        self._clock = clock
        self._extra = extra
        self._ended = ended
        self._boot_id: str | None = None
        self._next = 0
        self._polls = 0
        self._has_results = False
        self._answered_ns = clock.now_ns()

    @property
    def age_s(self) -> float:
        """Time since the run answered last, s."""
        return (self._clock.now_ns() - self._answered_ns) / NS

    async def move(self, said: Mapping[str, Any]) -> None:
        """A living run has no cursor."""

    async def follow(self) -> None:
        """Ask ten times a second until it is cancelled; a run that does not answer, less and less often."""
        retry_s = FIRST_RETRY_S
        while True:
            due_ns = self._clock.now_ns() + to_ns(POLL_S)
            try:
                await self.poll()
            except FeedGone:
                await self._missed()
                await pause(retry_s)
                retry_s = min(2 * retry_s, LONGEST_RETRY_S)
            else:
                retry_s = FIRST_RETRY_S
                await pause((due_ns - self._clock.now_ns()) / NS)

    async def beat(self) -> None:
        """The heartbeat, once a second; also says that the run is lost."""
        while True:
            await pause(BEAT_S)
            self.room.beat(self._clock.utc_ns() / NS, round(self.age_s, 3))
            if self.age_s > LOST_S and self.room.state.get("state") != "ended":
                now = silent_row(self.folder)["now"]
                self.room.change(state="lost", attention=now["attention"], bench=now["bench"], guard=now["guard"])

    async def poll(self) -> None:
        """Ask once. Raises: FeedGone if nobody answers."""
        wanted = self._polls % POLLS_PER_STATE == 0
        reply = await self._ask(self._next, wanted)
        self._polls += 1
        self._answered_ns = self._clock.now_ns()
        header = reply.header
        if header["boot_id"] != self._boot_id:
            await self._meet(reply)
            return
        points = _points(reply)
        missing = MISSING_BEFORE if points.first > self._next else 0
        self._next = header["seq"]
        self.room.show(points, missing)
        if wanted:
            self.room.become({**header["state"], **self._extra()})

    async def _meet(self, reply: FeedReply) -> None:
        """A process that has not answered before: everything from the beginning."""
        if self._next or not reply.header.get("state"):
            reply = await self._ask(0, True)
        header = reply.header
        self._boot_id = header["boot_id"]
        self._has_results = False
        self._next = header["seq"]
        self._polls = 1
        self.room.begin({**header["state"], **self._extra()}, _points(reply))

    async def _missed(self) -> None:
        """Nobody answers: the run has ended if its recording is closed; else it may come back."""
        self._polls = 0  # the first answer brings the state
        if self._has_results or (self.folder / OPEN_MARKER).exists():
            return
        final = await self._ended()
        results = {key: final[key] for key in ("estimates", "session") if final.get(key)}
        self._has_results = bool(results)  # they are written some time after the recording is closed
        if self.room.state.get("state") != "ended":
            self.room.become({**final, **self._extra(), "source": "live", "state": "ended"})
        self.room.change(**results)


class FeedLine:
    """The connection to one run's feed, asked in worker threads and closed only when none of them uses it."""

    def __init__(self, folder: Path) -> None:
        self._client = FeedClient(folder)
        self._lock = Lock()

    def poll(self, since: int, state: bool) -> FeedReply:
        """As FeedClient.poll."""
        with self._lock:
            return self._client.poll(since, state)

    def close(self) -> None:
        """Let the connection go; waits for an answer that is still due."""
        with self._lock:
            self._client.close()


def listens(folder: Path) -> bool:
    """Return True if a process has the feed of a session open, be it too busy to answer. Takes at most a moment."""
    try:
        with unix_socket() as connection:
            connection.setblocking(False)
            connection.connect(str(find_socket(folder, LIVE)))
    except BlockingIOError:  # so many wait there already
        return True
    except OSError:
        return False
    return True


def reply_of(folder: Path, since: int = 0) -> FeedReply | None:
    """Return state document and points as the run itself gives them; None if nobody answers in the time of a feed."""
    client = FeedClient(folder)
    try:
        return client.poll(since)
    except FeedGone:
        return None
    finally:
        client.close()


def _points(reply: FeedReply) -> Points:
    return Points(reply.header["first"], reply.t_utc_s, np.stack([reply.low, reply.high], axis=-1))
