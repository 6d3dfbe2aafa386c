"""Follows a living run through its feed while somebody looks at it; asks nothing but the feed's socket."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.model.clock import NS, Clock, pause, to_ns
from bench.model.posix import unix_connection, unix_socket
from bench.record import OPEN_MARKER
from bench.run.control.client import (
    ANSWER_S,
    LENGTHS_BYTES,
    FeedGone,
    FeedReply,
    gone,
    lengths,
    request,
    understood,
)
from bench.run.control.local_socket import LIVE, find_socket
from bench.session.recorded_state import unheard
from bench.web.points import MISSING_BEFORE, Points
from bench.web.room import Room

POLL_S = 0.1
POLLS_PER_STATE = 5  # the state twice a second
BEAT_S = 1.0
BUFFER = 1 << 16  # bytes of an answer that wait to be read
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
                self.room.change(state="lost", attention="much", **unheard(self.folder))

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
    """Asks the feed of one run on the event loop; keeps its connection and opens it again by itself.

    Args: answer_s: nobody is waited for longer.
    """

    def __init__(self, folder: Path, answer_s: float = ANSWER_S) -> None:
        self._folder = folder
        self._answer_s = answer_s
        self._one = asyncio.Lock()
        self._ends: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def poll(self, since: int, state: bool = True) -> FeedReply:
        """Return points from number ``since`` on, and the state document. Raises: FeedGone B-RUN-100, as FeedClient."""
        try:
            async with asyncio.timeout(self._answer_s), self._one:
                try:
                    return await self._asked(since, state)
                except BaseException:  # what comes now would be taken for the answer to the next question
                    self.close()
                    raise
        except (OSError, ValueError, RecursionError, asyncio.IncompleteReadError) as error:
            raise gone(self._folder, error) from error

    def close(self) -> None:
        """Let the connection go."""
        if self._ends is not None:
            self._ends[1].close()
            self._ends = None

    async def _asked(self, since: int, state: bool) -> FeedReply:
        if self._ends is not None:
            try:
                return await _exchange(*self._ends, since, state)
            except (OSError, asyncio.IncompleteReadError):  # let go for being silent, or another run answers by now
                self.close()
        place = await asyncio.to_thread(find_socket, self._folder, LIVE)
        self._ends = await unix_connection(place, BUFFER)
        return await _exchange(*self._ends, since, state)


async def end_tasks(*tasks: asyncio.Future[Any]) -> None:
    """Cancel tasks, and return when each of them has ended."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _exchange(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, since: int, state: bool) -> FeedReply:
    writer.write(request(since, state))
    header, packed = lengths(await reader.readexactly(LENGTHS_BYTES))
    return understood(await reader.readexactly(header), await reader.readexactly(packed), state)


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


def _points(reply: FeedReply) -> Points:
    return Points(reply.header["first"], reply.t_utc_s, np.stack([reply.low, reply.high], axis=-1))
