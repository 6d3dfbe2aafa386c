"""Looks at every run that goes on, when somebody asks and at most once a second, whatever the number of those who ask.

What is told is the state document of docs/live-protocol.md, which the page shows too. A run that does not answer keeps
nothing of what it said but its name: its state is "lost", and nobody knows what is on.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.model.clock import NS, to_ns
from bench.record import OPEN_MARKER
from bench.run.control.client import FeedReply
from bench.web.hub import Hub
from bench.web.live import LOST_S, end_tasks
from bench.web.now import silent_row
from bench.web.recorded.listing import run_folder, session_row, stamp_of

FRESH_S = 1.0
ENDED_S = 600.0  # so long a run is told of behind its end: a scraper that comes seldom learns how it ended
MOST_ENDED = 16  # rehearsals end every few seconds
READ_S = 1.0  # a look waits no longer for the end of a recording to be read: the other runs are told meanwhile
RECENT = 50  # points, 5 s: what a temperature was before is not told as if it were now
_NAMED = ("run", "title", "sequence", "station", "uut", "simulated", "clock")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SeenRun:
    """One run at a moment.

    Args: state: its state document.   temperatures_degC: newest readings by the name of their signal.
        age_s: since the run answered, second; None if it never has, or is over.
    """

    state: Mapping[str, Any]
    temperatures_degC: Mapping[str, float] = field(default_factory=dict)
    age_s: float | None = None


@dataclass
class _Known:
    """What is kept of one run between two looks. ``stamp``: of the files that ``over`` was made of."""

    folder: Path
    answered_ns: int | None = None
    next_point: int = 0
    named: Mapping[str, Any] | None = None
    seen: SeenRun | None = None
    ended_ns: int | None = None
    stamp: tuple[int, ...] = ()
    reading: asyncio.Task[tuple[tuple[int, ...], SeenRun]] | None = None


class Lookout:
    """The runs of a page server: that go on, or ended in the last ten minutes, or unsafely. For one event loop."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._clock = hub.serving.clock
        self._known: dict[str, _Known] = {}
        self._one = asyncio.Lock()
        self._seen: tuple[SeenRun, ...] = ()
        self._due_ns = self._fit_due_ns = 0
        self._fitting: asyncio.Task[None] | None = None

    async def runs(self) -> tuple[SeenRun, ...]:
        """Return all runs by name, as they were at most ``FRESH_S`` ago, with their estimates."""
        async with self._one:
            now_ns = self._clock.now_ns()
            if now_ns >= self._due_ns:
                self._seen = await self._look()
                self._due_ns = self._clock.now_ns() + to_ns(FRESH_S)
            if now_ns >= self._fit_due_ns:
                self._fit()
                self._fit_due_ns = now_ns + to_ns(FRESH_S)
        return self._seen

    async def stop(self) -> None:
        """Give up the fit that is under way, and the recordings that are read."""
        tasks = [task for task in (self._fitting, *(known.reading for known in self._known.values())) if task]
        await end_tasks(*tasks)

    async def _look(self) -> tuple[SeenRun, ...]:
        going_on = await self._hub.work(open_runs, self._hub.serving.out)
        for folder in going_on:
            self._known.setdefault(folder.name, _Known(folder))
        names = {folder.name for folder in going_on}
        seen = await asyncio.gather(*(self._seen_or_lost(known, name in names) for name, known in self._known.items()))
        self._forget()
        return tuple(sorted((run for run in seen if run is not None), key=lambda run: str(run.state.get("run"))))

    async def _seen_or_lost(self, known: _Known, is_open: bool) -> SeenRun | None:
        try:
            return await self._see(known, is_open)
        except Exception:  # a session of somebody else that is not what it should be: the others are told of
            log.exception("what %s says is not understood", known.folder.name)
            return SeenRun({"run": known.folder.name, "state": "lost", "attention": "much"})

    async def _see(self, known: _Known, is_open: bool) -> SeenRun | None:
        reply = await self._hub.reply(known.folder, max(0, known.next_point - RECENT))
        if reply is not None:
            known.answered_ns, known.next_point, known.ended_ns = self._clock.now_ns(), reply.header["seq"], None
            state = {**reply.header["state"], **self._hub.added(known.folder.name)}
            known.named = {key: state.get(key) for key in _NAMED}
            known.seen = SeenRun(state, temperatures_degC(reply), 0.0)
        elif is_open:
            known.ended_ns = None
            known.seen = await self._silent(known)
        else:
            await self._over(known)
        return known.seen

    async def _silent(self, known: _Known) -> SeenRun:
        """Return what is left to say of a run that does not answer: how long, and what its guard did."""
        age_s = None if known.answered_ns is None else (self._clock.now_ns() - known.answered_ns) / NS
        if known.seen is not None and age_s is not None and age_s <= LOST_S and known.seen.age_s is not None:
            return SeenRun(known.seen.state, known.seen.temperatures_degC, age_s)
        if known.named is None:
            row = await self._hub.work(session_row, known.folder)
            known.named = {key: row.get(key) for key in _NAMED}
        row = await self._hub.work(silent_row, known.folder)
        now = row["now"]
        silent = {"state": row["state"], **{key: now[key] for key in ("attention", "bench", "guard")}}
        return SeenRun({**known.named, **silent}, {}, age_s)

    async def _over(self, known: _Known) -> None:
        """Read how a run ended, and again when its results come; nothing is left of one whose folder is gone."""
        stamp = await self._hub.work(stamp_of, known.folder)
        known.ended_ns = self._clock.now_ns() if known.ended_ns is None else known.ended_ns
        if not stamp:
            known.seen = None
            return
        if not known.stamp:  # until its recording is read
            known.seen = SeenRun({**(known.named or {}), "run": known.folder.name, "state": "ended"})
        if known.reading is None and stamp != known.stamp:
            known.reading = asyncio.create_task(self._read(known.folder, stamp))
        if known.reading is not None and (await asyncio.wait({known.reading}, timeout=READ_S))[0]:
            reading, known.reading = known.reading, None
            known.stamp, known.seen = reading.result()

    async def _read(self, folder: Path, stamp: tuple[int, ...]) -> tuple[tuple[int, ...], SeenRun]:
        final = await self._hub.work(self._hub.past.final, folder)
        return stamp, SeenRun({**final, "run": folder.name})

    def _forget(self) -> None:
        now_ns = self._clock.now_ns()
        ended = sorted((known.ended_ns, name) for name, known in self._known.items() if known.ended_ns is not None)
        for place, (ended_ns, name) in enumerate(reversed(ended)):
            seen = self._known[name].seen
            is_old = now_ns - ended_ns > to_ns(ENDED_S) and not (place == 0 and seen is not None and _left_on(seen))
            if is_old or place >= MOST_ENDED or seen is None:
                del self._known[name]

    def _fit(self) -> None:
        """Let the fits go on that are due, as for a page that is open; nobody waits for them here."""
        known_runs = self._known.values()
        folders = [known.folder for known in known_runs if known.seen is not None and known.seen.age_s == 0.0]

        async def fit_each() -> None:
            for folder in folders:
                await self._hub.fit(folder)

        if self._fitting is None or self._fitting.done():
            self._fitting = asyncio.create_task(fit_each())


def _left_on(seen: SeenRun) -> bool:
    """Return whether a run has ended with outputs that nobody has confirmed off: told of until the next one ends."""
    return bool((seen.state.get("bench") or {}).get("unconfirmed"))


def open_runs(out: Path) -> list[Path]:
    """Return the folders of the runs whose recording is not closed."""
    try:
        with os.scandir(out) as entries:
            names = [entry.name for entry in entries if os.path.lexists(f"{entry.path}/{OPEN_MARKER}")]
    except OSError:
        return []
    return [folder for name in names if (folder := run_folder(out, name)) is not None]


def temperatures_degC(reply: FeedReply) -> dict[str, float]:
    """Return the newest value of each temperature among the last ``RECENT`` points, none where nothing came.

    A point is the least and the greatest value of 0.1 s; what is returned is their middle.
    """
    newest = {}
    for column, signal in enumerate(reply.header["state"].get("signals") or ()):
        if signal.get("unit") == "degC" and column < reply.low.shape[1]:
            spans = np.stack([reply.low[-RECENT:, column], reply.high[-RECENT:, column]], axis=1).astype(float)
            there = spans[np.isfinite(spans).all(axis=1)]
            if len(there):
                newest[str(signal.get("name"))] = float(there[-1].mean())
    return newest
