"""Everything that is shown now: the runs somebody looks at, each followed once for all who look."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from bench.model.clock import pause
from bench.model.errors import BenchError
from bench.record import OPEN_MARKER, TrendWindow
from bench.run.control.client import FeedGone, FeedReply
from bench.session.partial_fits import PartialFits
from bench.web.live import FeedLine, LiveRun, end_tasks, listens
from bench.web.now import now_of, silent_row
from bench.web.points import Points
from bench.web.recorded.listing import Row, RunList, run_folder
from bench.web.recorded.past import HistoryQuery, Past
from bench.web.recorded.replaying import ReplayRun
from bench.web.room import Viewer
from bench.web.security.refusal import Refusal
from bench.web.serving import Serving

WORK_THREADS = 4  # history, recordings, lists; some may wait for a trend that is being made
LISTED_S = 1.0  # a list of runs waits no longer for any of them
_WARM_S = 0.05
_COUNTED = ("done", "planned")
_Result = TypeVar("_Result")

Watched = LiveRun | ReplayRun


class Hub:
    """Living runs and recordings on their way to browsers. Made anywhere, started and stopped on the event loop."""

    def __init__(self, serving: Serving) -> None:
        self.serving = serving
        self.runs = RunList(serving.out)
        self.past = Past()
        self.lease = serving.lease.document  # who holds the command, as the state document says it
        self._lines: dict[str, FeedLine] = {}  # of runs whose state was asked for
        self._work = ThreadPoolExecutor(WORK_THREADS, "work")
        self._live: dict[str, LiveRun] = {}
        self._tasks: dict[str, list[asyncio.Task[None]]] = {}
        self._fits = PartialFits(serving.clock)
        self._warming: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to read the sessions there are, newest first, so that the first list is whole soon; make figures."""
        self._warming = asyncio.create_task(self._warm())

    async def stop(self) -> None:
        """Let go of everything; runs do not notice."""
        tasks = [task for tasks in self._tasks.values() for task in tasks]
        tasks += [self._warming] if self._warming is not None else []
        await end_tasks(*tasks)
        self.past.stop()
        for line in self._lines.values():
            line.close()
        self._work.shutdown(wait=False, cancel_futures=True)

    async def work(self, task: Callable[..., _Result], *arguments: Any) -> _Result:
        """Do something that takes long in a thread of its own."""
        return await asyncio.get_running_loop().run_in_executor(self._work, partial(task, *arguments))

    def folder(self, run: str) -> Path:
        """Return folder of a run. Raises: Refusal B-WEB-013, status 404."""
        folder = run_folder(self.serving.out, run)
        if folder is None:
            raise Refusal(404, "B-WEB-013", "there is no run of that name", next_step="the first page lists them")
        return folder

    @asynccontextmanager
    async def watching(self, run: str, viewer: Viewer) -> AsyncIterator[Watched]:
        """Open what a viewer looks at: the shared living run, or a replay of its own. Raises: Refusal B-WEB-013."""
        folder = self.folder(run)
        if run in self._live or listens(folder):
            async with self._in_room(run, viewer) as live:
                yield live
        else:
            async with self._in_replay(folder, viewer) as replay:
                yield replay

    async def document(self, run: str) -> dict[str, Any]:
        """Return the state document of a run now; of a recording at its end. Raises: Refusal B-WEB-013."""
        folder = self.folder(run)
        if run in self._live and self._live[run].room.state:
            return self._live[run].room.state
        state = await self._state_of(folder)
        if state is not None:
            return {**state, **self.added(run)}
        return {**await self.work(self.past.final, folder), "operator": self.lease()}

    async def outline(self, run: str) -> tuple[dict[str, Any], bool]:
        """Return what figures are made for, and whether it is more than a part of the state: see ``Past.outline``.

        Raises: Refusal B-WEB-013.
        """
        folder = self.folder(run)
        if run not in self._live and not (folder / OPEN_MARKER).exists():
            with suppress(BenchError):  # what is wrong with a recording its state says
                outline = await self.work(self.past.outline, folder)
                if outline is not None:
                    return outline, True
        return await self.document(run), False

    async def history(self, run: str, query: HistoryQuery) -> TrendWindow:
        """Return signals of a run over time. Raises: Refusal B-WEB-013, InputError for a signal that is not there."""
        return await self.work(self.past.history, self.folder(run), query)

    async def listed(self) -> tuple[list[Row], int]:
        """Return rows of all runs, newest first, living ones as they are now; and how many could not be read yet."""
        rows, unread = await self.work(self.runs.rows)
        return list(await asyncio.gather(*(self._row_now(row) for row in rows))), unread

    async def _row_now(self, row: Row) -> Row:
        if row["state"] != "stopped":  # its recording is closed
            return row
        live = self._live.get(row["run"])
        folder = self.serving.out / row["run"]
        state = live.room.state if live is not None else await self._state_of(folder)
        if state and state.get("state") == "ended":
            return row
        if not state or state.get("state") in (None, "lost"):
            return {**row, **await self.work(silent_row, folder)}
        records = state.get("records") or row["records"]  # a run of another version may say less
        counted = {key: records.get(key) for key in _COUNTED}
        return {**row, "state": state["state"], "live": True, "records": counted, "now": now_of(state)}

    async def reply(self, folder: Path, since: int) -> FeedReply | None:
        """Return what the run itself says, with its points from a number on; None if nobody answers in time."""
        line = self._lines.setdefault(folder.name, FeedLine(folder, LISTED_S))
        try:
            return await line.poll(since)
        except FeedGone:
            self._lines.pop(folder.name, None)
            return None

    async def fit(self, folder: Path) -> None:
        """Fit a living run, unless it was fitted a short while ago; its estimates stand in ``added`` from then on."""
        await self._fits.once(folder)

    async def _state_of(self, folder: Path) -> dict[str, Any] | None:
        reply = await self.reply(folder, 0)
        return None if reply is None else reply.header["state"]

    def added(self, run: str) -> dict[str, Any]:
        """Return what the page server adds to the state document of a living run."""
        return {"operator": self.lease(), "estimates": self._fits.of(run)}

    @asynccontextmanager
    async def _in_room(self, run: str, viewer: Viewer) -> AsyncIterator[LiveRun]:
        live = self._live.get(run) or self._enter(run)
        live.room.enter(viewer)
        try:
            yield live
        finally:
            live.room.viewers.discard(viewer)
            if not live.room.viewers and self._live.pop(run, None) is not None:
                await end_tasks(*self._tasks.pop(run))

    def _enter(self, run: str) -> LiveRun:
        folder = self.serving.out / run
        line = FeedLine(folder)

        async def follow() -> None:
            try:
                await live.follow()
            finally:
                line.close()

        final = partial(self.work, self.past.final, folder)
        live = LiveRun(folder, line.poll, self.serving.clock, partial(self.added, run), final)
        self._live[run] = live
        coroutines = (follow(), live.beat(), self._fits.keep(folder))
        self._tasks[run] = [asyncio.create_task(coroutine) for coroutine in coroutines]
        return live

    @asynccontextmanager
    async def _in_replay(self, folder: Path, viewer: Viewer) -> AsyncIterator[ReplayRun]:
        state = await self.work(self.past.state, folder)

        def fetch(t0_utc_s: float, t1_utc_s: float, width_s: float) -> Points:
            return self.past.points(folder, t0_utc_s, t1_utc_s, width_s)

        final = await self.work(self.past.final, folder)

        def extra() -> dict[str, Any]:
            return {"operator": self.lease(), "estimates": final.get("estimates"), "session": final.get("session")}

        replay = ReplayRun(state, fetch, self.work, self.serving.clock, extra)
        replay.room.enter(viewer)
        task = asyncio.create_task(replay.follow())
        try:
            yield replay
        finally:
            await end_tasks(task)

    async def _warm(self) -> None:
        figures = await self.work(import_module, "bench.web.figures")
        rows, _ = await self.work(self.runs.rows)
        newest = next((row["run"] for row in rows if row["state"] == "ended"), None)
        with suppress(BenchError):
            if newest is not None:  # what the next page shows is of the same kind, mostly
                outline = await self.work(self.past.outline, self.serving.out / newest)
                await self.work(figures.run_figures, outline or {})
        while (await self.work(self.runs.rows))[1]:
            await pause(_WARM_S)
