"""A rehearsal that is watched: the same bytes as one that is not, what it says while it runs, its recording after."""

from __future__ import annotations

import hashlib
import json
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rehearsal import Watched, tiny_plan

from bench.model.clock import VirtualClock
from bench.model.events import event_of
from bench.plan import Plan, steps_of
from bench.record import SessionReader
from bench.run.besides import besides
from bench.run.control.operator import SimulatedOperator
from bench.run.feed.client import FeedClient, FeedGone
from bench.run.feed.state import RunState
from bench.run.session import Conducted, conduct
from bench.run.stop import StopSwitch
from bench.tables import watch

SEED = 5
UTC_S = 946_684_800.0
LATE = (("slot: 1800 s", "slot: 1200 s"), ("duration: 2250 s", "duration: 1650 s"))  # too short to get warm


class Crowd:
    """Watchers of the run in ``out``: one polls as fast as it can and keeps what it sees, one asks and never reads, and
    one is a notebook."""

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


def conducted(plan: Plan, out: Path, act: Callable[[], object] = lambda: None) -> Conducted:
    return conduct(
        plan, clock=VirtualClock(), seed=SEED, out=out, operator=SimulatedOperator(),
        listener=Watched(lambda world, step: act(), [None]),  # type: ignore[list-item]
        beside=besides(plan, {}, virtual=True),
    )  # fmt: skip


def hashes(folder: Path) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.slow
def test_a_watched_run_writes_the_same_bytes_and_tells_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = tiny_plan(tmp_path)
    alone = conducted(plan, tmp_path / "alone")
    with Crowd(tmp_path / "watched") as crowd:
        monkeypatch.setitem(sys.modules, "IPython.display", crowd)  # type: ignore[arg-type]
        watched = conducted(plan, tmp_path / "watched", lambda: crowd.looked.wait(20.0))
    assert hashes(watched.folder) == hashes(alone.folder)
    assert not list(watched.folder.glob("live*"))
    assert len(crowd.seen) > 5
    assert crowd.points > 600
    assert len(set(crowd.pictures)) > 1
    assert {picture[:4] for picture in crowd.pictures[:-1]} == {b"\x89PNG"}
    assert crowd.pictures[-1] == b"end"
    (end,) = [t_ns / 1e9 + UTC_S for kind, t_ns, _ in SessionReader(watched.folder).events("end")]
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


def documents_of(folder: Path, look: Callable[[float, RunState], None]) -> RunState:
    """Feed a recording to a state and look at it before each event."""
    reader = SessionReader(folder)
    state = RunState(steps_of(reader.texts["plan.json"]), reader.manifest, source="replay")
    for message in reader.messages(frozenset({"/event", "/instrument/"})):
        t_utc_s = message.t_ns / 1e9 + UTC_S
        if message.topic == "/event":
            look(t_utc_s, state)
            kind, fields = message.event()
            state.on_event(event_of(kind, fields), t_utc_s)
        else:
            line = message.document()
            state.on_traffic(message.topic.rpartition("/")[2], line["direction"], line["text"], t_utc_s)
    return state


@pytest.mark.slow
@pytest.mark.parametrize("act", ["pause", "late soak"])
def test_a_recording_says_the_same_and_when_the_run_will_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str
) -> None:
    plan = tiny_plan(tmp_path, *(LATE if act == "late soak" else ()))
    if act == "pause":
        held_for_a_while(monkeypatch)
    folder = conducted(plan, tmp_path / "out").folder
    (end,) = [t_ns / 1e9 + UTC_S for _, t_ns, _ in SessionReader(folder).events("end")]
    known = [t_ns / 1e9 + UTC_S for _, t_ns, _ in SessionReader(folder).events("release" if act == "pause" else "late")]
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


def held_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run stands still for 200 s when it comes to its first measured point."""
    seen: list[int] = []
    check = StopSwitch.check

    def holding(self: StopSwitch) -> None:
        seen.append(1)
        if len(seen) == 200:
            self.holds.hold("operator", "door")
        check(self)

    monkeypatch.setattr(StopSwitch, "check", holding)
    stand = StopSwitch.check_stop

    def looking(self: StopSwitch) -> None:
        stand(self)
        if len(seen) >= 200 and "operator" in self.holds.reasons:
            seen.append(1)
            if len(seen) > 1200:
                self.holds.release("operator")

    monkeypatch.setattr(StopSwitch, "check_stop", looking)
