"""``WS /ws/runs``: the runs of one bench in a few lines, pushed when they change, for whoever looks at many benches.

It is made of the state documents that metrics and MQTT tell too, by the reducer of the first page, and has no signals.
A heartbeat is sent only behind a look at the runs: who hears it knows that what was sent last is still true.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from starlette.websockets import WebSocket

from bench.model.clock import NS, Clock, pause, to_ns
from bench.record import OPEN_MARKER
from bench.run.guard.last_words import roles_in_words
from bench.web.hub import Hub
from bench.web.now import now_of
from bench.web.recorded.listing import run_folder, session_row
from bench.web.room import Room, Viewer
from bench.web.socket import serve_page
from bench.web.telemetry import Lookout, SeenRun

PROTO = 1
LOOK_S = 1.0
BEAT_S = 2.0
BEGIN_S = 5.0  # a run writes its folder some moments before it answers for the first time
END_STEP_S = 60  # an end that moves from second to second is no news
PROGRESS_DIGITS = 3
MOST_RUNS = 32  # that are told, with those that need somebody first
ATTENTION = ("much", "some", "none")
_GRAVE = ("fault", "damaged", "stopped")

Card = dict[str, Any]

log = logging.getLogger(__name__)


class Overview:
    """The runs of one bench, looked at each second as long as somebody wants to know.

    Args: hub: of the folder. lookout: of the same hub.
    """

    def __init__(self, hub: Hub, lookout: Lookout) -> None:
        self.room = Room({})
        self._hub = hub
        self._out = hub.serving.out
        self._clock: Clock = hub.serving.clock
        self._lookout = lookout
        self._following: asyncio.Task[None] | None = None
        self._last: Card | None = None  # of the newest session that is over
        self._begun = self._failed = False
        self._unheard: dict[str, int] = {}  # runs that have never answered, since when they are seen

    async def socket(self, websocket: WebSocket) -> None:
        """Serve one who looks at many benches; the gate has let it in."""
        await serve_page(websocket, self._in_room)

    async def move(self, said: Mapping[str, Any]) -> None:
        """Living runs have no cursor."""

    async def look(self) -> dict[str, Any] | None:
        """Return the runs that go on by name, and the newest that is over; None if that is not known, as the log says.

        What goes wrong is said once until it goes right again.
        """
        try:
            document = await self._look()
        except Exception as error:  # a disk that is gone, or a session that is not what it should be
            if not self._failed:
                log.error("the runs in %s are not known: %s", self._out, error)
            self._failed = True
            return None
        self._failed = False
        return document

    async def _look(self) -> dict[str, Any]:
        if not self._begun or not await self._hub.work(self._out.is_dir):  # one that is gone says so here
            self._last = await self._hub.work(newest_over, self._out)
            self._begun = True
        runs = await self._lookout.runs(fitted=False)
        over = [run for run in runs if is_over(run)]
        if over:
            self._last = over_card(over[-1].state)
        living = {str(run.state["run"]): run for run in runs if not is_over(run)}
        now_ns, before = self._clock.now_ns(), self._unheard
        self._unheard = {name: before.get(name, now_ns) for name, run in living.items() if is_unheard(run)}
        cards = {name: run_card(run) for name, run in living.items()}
        for name, since_ns in self._unheard.items():
            if now_ns - since_ns <= to_ns(BEGIN_S):
                cards[name] |= {"state": "connecting", "attention": "none"}
        told = sorted(sorted(cards, reverse=True), key=lambda name: ATTENTION.index(cards[name]["attention"]))
        return {"proto": PROTO, "runs": {name: cards[name] for name in told[:MOST_RUNS]}, "last": self._last}

    @asynccontextmanager
    async def _in_room(self, viewer: Viewer) -> AsyncIterator[Overview]:
        self.room.enter(viewer)
        if self._following is None:
            self._following = asyncio.create_task(self._follow())
        try:
            yield self
        finally:
            self.room.viewers.discard(viewer)
            if not self.room.viewers and self._following is not None:
                self._following.cancel()
                self._following = None
                self.room.state = {}  # whoever comes next is not told how things were

    async def _follow(self) -> None:
        beat_ns = 0
        while True:
            now_ns = self._clock.now_ns()
            document = await self.look()
            if document is None:  # no heartbeat either: whoever looks says UNKNOWN
                self.room.state = {}
            elif document != self.room.state:
                self.room.begin(document)
                beat_ns = now_ns + to_ns(BEAT_S)
            elif now_ns >= beat_ns:
                self.room.beat(self._clock.utc_ns() / NS, None)
                beat_ns = now_ns + to_ns(BEAT_S)
            await pause(LOOK_S - (self._clock.now_ns() - now_ns) / NS)


def is_over(run: SeenRun) -> bool:
    """Return whether a recording is closed; one that was left open is told of until somebody resumes or ends it."""
    return run.state.get("state") == "ended" or run.state.get("session") is not None


def is_unheard(run: SeenRun) -> bool:
    """Return whether a run has never answered, though its process is there."""
    return run.age_s is None and run.state.get("state") == "lost"


def run_card(run: SeenRun) -> Card:
    """Return what is said of a run that goes on, or has gone."""
    now = now_of(run.state)
    end_utc_s = (now["eta"] or {}).get("likely_utc_s")
    progress, guard = now["progress"], run.state.get("guard") or {}
    return {
        **{key: run.state.get(key) for key in ("title", "uut", "simulated", "state")},
        **{key: now[key] for key in ("what", "alarm_count", "alarms")},
        "attention": now["attention"] if now["attention"] in ATTENTION else "much",
        "outputs": now["bench"]["state"],
        "unconfirmed": roles_in_words(now["bench"].get("unconfirmed") or {}),
        "waits": (now["wait"] or {}).get("reason"),
        "asks": now["prompt"],
        "guard": guard.get("reason"),
        "progress": None if progress is None else round(progress, PROGRESS_DIGITS),
        "end_utc_s": None if end_utc_s is None else END_STEP_S * round(end_utc_s / END_STEP_S),
    }


def over_card(state: Mapping[str, Any]) -> Card:
    """Return what is said of a run that is over: somebody is needed until the next run if not all was confirmed off."""
    outcome, bench = (state.get("session") or {}).get("outcome") or {}, state.get("bench") or {}
    word, off = outcome.get("word"), outcome.get("off")
    attention = "much" if off is False else "some" if word in _GRAVE else "none"
    named = {key: state.get(key) for key in ("run", "title", "uut", "simulated")}
    told = {"outcome": word, "off": off, "outputs": "unknown" if off is False else None}
    return {**named, **told, "attention": attention, "unconfirmed": roles_in_words(bench.get("unconfirmed") or {})}


def newest_over(out: Path) -> Card | None:
    """Return the newest session of a folder whose recording is closed; None if there is none."""
    with os.scandir(out) as entries:
        names = sorted((entry.name for entry in entries), reverse=True)
    for name in names:
        folder = run_folder(out, name)
        if folder is not None and not os.path.lexists(folder / OPEN_MARKER):
            row = session_row(folder)
            return over_card({**row, "session": {"outcome": row["outcome"]}})
    return None
