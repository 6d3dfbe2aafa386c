"""A rehearsal that is watched: the same bytes as one that is not, what it says while it runs, its recording after."""

from __future__ import annotations

import json
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rehearsal import SOAK_s, contents, rehearsed, tiny_plan

from bench.model.events import event_of
from bench.plan import Plan, steps_of
from bench.record import SessionReader
from bench.run.besides import besides
from bench.run.context import RunContext
from bench.run.feed.client import FeedClient, FeedGone
from bench.run.feed.state import RunState
from bench.run.session import Beside, Conducted
from bench.tables import watch

UTC_S = 946_684_800.0
LATE = (("slot: 1800 s", "slot: 1200 s"), ("duration: 2250 s", "duration: 1650 s"))  # too short to get warm


class Crowd:
    """Watchers of a run: one polls as fast as it can and keeps what it sees, one never reads, one is a notebook."""

    def __init__(self, out: Path) -> None:
        self.seen: list[dict[str, Any]] = []
        self.points = 0
        self.pictures: list[bytes] = []
        self.looked = threading.Event()  # the notebook, whose libraries take their time, has its first picture
        self._out, self._ended = out, threading.Event()
        self._threads = [threading.Thread(target=one) for one in (self._poll, self._ask_and_never_read, self._watch)]

    def __enter__(self) -> Crowd:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(20.0)

    def _folder(self) -> Path | None:
        while not self._ended.wait(0.01):
            if found := next(iter(self._out.glob("*/live.*")), None):
                return found.parent
        return None

    def _poll(self) -> None:
        if (folder := self._folder()) is None:
            return
        client, since = FeedClient(folder), 0
        while not self._ended.is_set():
            try:
                reply = client.poll(since)
            except FeedGone:
                continue
            since = int(reply.header["seq"])
            self.points += len(reply.t_utc_s)
            self.seen.append(reply.header["state"])
        client.close()

    def _watch(self) -> None:
        """Look at the run as a notebook does; the view ends with the run."""
        if (folder := self._folder()) is not None:
            watch(folder, "bench.unit")
            self.pictures.append(b"end")

    def DisplayHandle(self) -> Any:
        """Stand in for IPython.display, whose handle shows a picture and replaces it."""
        return SimpleNamespace(display=self._show, update=self._show)

    def _show(self, picture: bytes) -> None:
        self.pictures.append(picture)
        self.looked.set()

    def Image(self, data: bytes) -> bytes:
        return data

    def _ask_and_never_read(self) -> None:
        if (folder := self._folder()) is None:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as mute:
            mute.settimeout(0.1)
            try:
                mute.connect(str(folder / "live.sock"))
                while not self._ended.is_set():
                    mute.sendall(b'{"since": 0, "state": true}\n' * 100)
            except OSError:  # the run is over, or it was dropped
                self._ended.wait(20.0)


def conducted(plan: Plan, out: Path, act: Callable[[], object] = lambda: None, *beside: Beside) -> Conducted:
    watched = [*besides(plan, {}, virtual=True), *beside]
    return rehearsed(out, plan, act=lambda world, step: act(), seed=5, beside=watched).run


@pytest.mark.slow
def test_a_watched_run_writes_the_same_bytes_and_tells_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = tiny_plan(tmp_path)
    alone = conducted(plan, tmp_path / "alone")
    with Crowd(tmp_path / "watched") as crowd:
        monkeypatch.setitem(sys.modules, "IPython.display", crowd)  # type: ignore[arg-type]
        watched = conducted(plan, tmp_path / "watched", lambda: crowd.looked.wait(20.0))
    assert contents(watched.folder) == contents(alone.folder)
    assert not list(watched.folder.glob("live*"))
    assert len(crowd.seen) > 5
    assert crowd.points > 600
    assert len(set(crowd.pictures)) > 1
    assert {picture[:4] for picture in crowd.pictures[:-1]} == {b"\x89PNG"}
    assert crowd.pictures[-1] == b"end"
    (end,) = [utc_s(t_ns) for _, t_ns, _ in SessionReader(watched.folder).events("end")]
    etas = [one["eta"] for one in crowd.seen if one["eta"] is not None]
    assert etas
    for eta in etas:
        assert eta["earliest_utc_s"] <= end <= eta["latest_utc_s"]
    boots = {one["boot_id"] for one in crowd.seen}
    assert len(boots) == 1
    assert len(boots.pop()) == 16
    last = crowd.seen[-1]
    assert (last["simulated"], last["clock"], last["source"]) == (True, "virtual", "live")
    assert last["records"]["planned"] == 15
    assert {str(record["flags"]) for record in last["records"]["last"]} == {"[]"}
    assert set(last["instruments"]) == set(plan.station.instruments)
    assert not any(link["state"] in ("lost", "silent") for one in crowd.seen for link in one["links"].values())
    json.dumps(crowd.seen, allow_nan=False)


def utc_s(t_ns: int) -> float:
    return t_ns / 1e9 + UTC_S


def documents_of(folder: Path, look: Callable[[float, RunState], None]) -> RunState:
    """Feed a recording to a state and look at it before each event."""
    reader = SessionReader(folder)
    state = RunState(steps_of(reader.texts["plan.json"]), reader.manifest, source="replay")
    for message in reader.messages(frozenset({"/event", "/instrument/"})):
        t_utc_s = utc_s(message.t_ns)
        if message.topic == "/event":
            look(t_utc_s, state)
            state.on_event(event_of(*message.event()), t_utc_s)
        else:
            line = message.document()
            state.on_traffic(message.topic.rpartition("/")[2], line["direction"], line["text"], t_utc_s)
    return state


def held_for_a_while(from_s: float) -> Beside:
    """The run stands still for 200 s from a time on."""

    def beside(context: RunContext) -> AbstractContextManager[None]:
        holds = context.stop.holds
        held: list[object] = []

        def look() -> None:
            now_s = context.clock.now_ns() / 1e9
            if now_s >= from_s and not held:
                held.append(holds.hold("operator", "door"))
            elif now_s >= from_s + 200.0:
                holds.release("operator")

        context.clock.every(1.0, look)
        return nullcontext()

    return beside


@pytest.mark.slow
@pytest.mark.parametrize("act", ["pause", "late soak"])
def test_a_recording_says_the_same_and_when_the_run_will_end(tmp_path: Path, act: str) -> None:
    plan = tiny_plan(tmp_path, *(LATE if act == "late soak" else ()))
    beside = [held_for_a_while(plan.prepare_s + SOAK_s + 50.0)] if act == "pause" else []
    folder = conducted(plan, tmp_path / "out", lambda: None, *beside).folder
    (end,) = [utc_s(t_ns) for _, t_ns, _ in SessionReader(folder).events("end")]
    known = [utc_s(t_ns) for _, t_ns, _ in SessionReader(folder).events("release" if act == "pause" else "late")]
    assert len(known) == 1  # before it nobody can know how much later the run will be over
    ranges: list[tuple[float, float]] = []

    def look(t_utc_s: float, state: RunState) -> None:
        document = state.document(t_utc_s)
        if document["eta"] is not None and document["state"] == "running" and t_utc_s > known[0]:
            ranges.append((document["eta"]["earliest_utc_s"], document["eta"]["latest_utc_s"]))

    state = documents_of(folder, look)
    assert ranges
    for earliest, latest in ranges:
        assert earliest <= end + 0.5 <= latest + 0.5
    final = state.document(end)
    assert (final["state"], final["outcome"]) == ("ended", {"error": None, "text": "done"})
    assert (final["records"]["done"], final["progress"]) == (15, 1.0)
