"""The short campaign end to end: same seed same bytes, replay, schema, watched; faults of its bench."""

import json
import shutil
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest
from rehearsal import (
    Inside,
    Rehearsal,
    Watched,
    assert_nothing_switched,
    contents,
    overheard,
    record_golden,
    rehearsed,
    tiny_plan,
    writable_copy,
)

from bench.analysis import results_schema
from bench.model.errors import BenchError
from bench.plan import Plan
from bench.record import RecordError, SessionReader, SessionWriter
from bench.run.besides import besides
from bench.run.control.client import FeedClient, FeedGone
from bench.run.session import Beside, Conducted
from sim_instruments.worlds.common.world import World

Short = tuple[Path, CompletedProcess[str]]


def results_of(folder: Path) -> dict[str, object]:
    return json.loads((folder / "results.json").read_text())


def test_a_campaign_ends_with_its_files_and_exit_status_0(short: Short) -> None:
    folder, done = short
    assert done.returncode == 0, done.stderr
    assert sorted(contents(folder)) == [
        "bench.001s", "bench.010s", "bench.100s", "coefficients.h", "coefficients.json", "port_a.001s", "port_a.010s",
        "port_a.100s", "port_b.001s", "port_b.010s", "port_b.100s", "report.html", "results.json", "session.0001.mcap",
        "session.0002.mcap", "session.0003.mcap", "trend.json",
    ]  # fmt: skip
    assert (folder.parent / "history.sqlite").is_file()
    assert "SIMULATED" in done.stdout
    assert str(folder / "report.html") in done.stdout
    assert "Traceback" not in done.stdout + done.stderr
    jsonschema.validate(results_of(folder), results_schema())


def test_a_folder_of_that_name_gives_a_suffix_which_is_in_no_file(golden: Path, tmp_path: Path) -> None:
    """Else the same seed gives the same bytes."""
    taken = tmp_path / golden.name
    taken.mkdir()
    record_golden(tmp_path)
    first, second = contents(golden), contents(taken.with_name(f"{golden.name}-2"))
    assert {name for name in first if first[name] != second[name]} == set()
    assert first.keys() == second.keys()
    assert not list(taken.iterdir())


@pytest.mark.validates(
    "replay of a session from its raw bytes",
    against="every number the run itself wrote, in a copy without the simulated truth",
)
def test_a_copy_elsewhere_replays_fits_and_reports_without_the_truth(
    short: Short, tmp_path: Path, inside: Inside
) -> None:
    folder, _ = short
    copy = writable_copy(folder, tmp_path / "somewhere" / "else")
    (copy / "report.html").unlink()
    replayed = inside("replay", str(copy), cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr
    assert "every number is identical" in replayed.stdout
    fitted = inside("fit", str(copy), "--json", cwd=tmp_path)
    assert fitted.returncode == 0
    assert json.loads(fitted.stdout) == results_of(folder)
    assert inside("report", str(copy), cwd=tmp_path).returncode == 0
    assert (copy / "report.html").read_bytes() == (folder / "report.html").read_bytes()


UTC_S = 946_684_800.0


class Watcher:
    """Polls a run as fast as it can and keeps what it sees; each twentieth step of the run waits for a look at it."""

    def __init__(self, out: Path) -> None:
        self.seen: list[dict[str, Any]] = []
        self.points = self._steps = 0
        self._out, self._looked, self._ended = out, threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._poll)

    def __enter__(self) -> "Watcher":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(20.0)

    def step(self) -> None:
        self._steps += 1
        if self._steps % 20 == 1:
            self._looked.clear()
            self._looked.wait(20.0)

    def _poll(self) -> None:
        client, since = None, 0
        while not self._ended.wait(0.001):
            with suppress(FeedGone, StopIteration):
                client = client or FeedClient(next(self._out.glob("*/live.*")).parent)
                reply = client.poll(since)
                since = int(reply.header["seq"])
                self.points += len(reply.t_utc_s)
                self.seen.append(reply.header["state"])
                self._looked.set()
        if client is not None:
            client.close()


def conducted(plan: Plan, out: Path, act: Callable[[], object] = lambda: None, *beside: Beside) -> Conducted:
    watched = [*besides(plan, {}, virtual=True), *beside]
    return rehearsed(out, plan, act=lambda world, step: act(), seed=5, beside=watched).run


@pytest.mark.slow
def test_a_watched_run_writes_the_same_bytes_and_tells_the_truth(tmp_path: Path) -> None:
    plan = tiny_plan(tmp_path)
    alone = conducted(plan, tmp_path / "alone")
    with Watcher(tmp_path / "watched") as watcher:
        watched = conducted(plan, tmp_path / "watched", watcher.step)
    assert contents(watched.folder) == contents(alone.folder)
    assert not list(watched.folder.glob("live*"))
    assert len(watcher.seen) > 5
    assert watcher.points > 600
    assert not {"interlock", "alarm", "hold"} & {kind for kind, _, _ in SessionReader(watched.folder).events()}
    (end,) = [utc_s(t_ns) for _, t_ns, _ in SessionReader(watched.folder).events("end")]
    etas = [one["eta"] for one in watcher.seen if one["eta"] is not None]
    assert etas
    for eta in etas:
        assert eta["earliest_utc_s"] <= end <= eta["latest_utc_s"]
    boots = {one["boot_id"] for one in watcher.seen}
    assert len(boots) == 1
    assert len(boots.pop()) == 16
    last = watcher.seen[-1]
    assert (last["simulated"], last["clock"], last["source"]) == (True, "virtual", "live")
    assert last["records"]["planned"] == 15
    assert {str(record["flags"]) for record in last["records"]["last"]} == {"[]"}
    assert set(last["instruments"]) == set(plan.station.instruments)
    assert not any(link["state"] in ("lost", "silent") for one in watcher.seen for link in one["links"].values())
    json.dumps(watcher.seen, allow_nan=False)


def utc_s(t_ns: int) -> float:
    return t_ns / 1e9 + UTC_S


Start = Callable[..., Rehearsal]


@pytest.mark.parametrize("role", ["calibrator", "switch", "chamber", "rail_dmm"])
def test_a_wrong_instrument_gets_no_command_and_nothing_is_switched(tmp_path: Path, rehearse: Start, role: str) -> None:
    heard: list[list[str]] = []

    def exchange(world: World) -> None:
        world.faults.instrument(role).identity = "ACME,42,0,0"
        heard.append(overheard(world))

    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=exchange)
    assert caught.value.code == "B-INST-002"
    assert role in caught.value.where
    assert_nothing_switched(heard[0])
    assert not (tmp_path / "out").exists()


def left_on(world: World) -> None:
    """As after a controller that was killed: 100 mA through channel 1."""
    switch, calibrator = world.instruments["switch"], world.instruments["calibrator"]
    switch.execute(":CLOS (@1!1!1)")
    for text in ("OUT 1.0E-01 A, 0 HZ", "OPER"):
        calibrator.execute(text)
    assert calibrator.operating


def refused(tmp_path: Path, rehearse: Start, change: Callable[[World], object]) -> tuple[BenchError, World]:
    """Return why a run does not begin on a bench that was left on and changed, and its world."""
    watched = Watched()
    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=lambda world: (left_on(world), change(world)), watched=watched)
    world = watched.worlds[0]
    assert world.wiring.closed == frozenset()
    return caught.value, world


def no_space(*_: object, **__: object) -> Any:
    raise RecordError("B-REC-001", "cannot be written: No space left on device")


def test_a_bench_that_was_left_on_is_made_safe_before_the_first_prompt(tmp_path: Path, rehearse: Start) -> None:
    seen: list[bool] = []
    found = rehearse(
        tiny_plan(tmp_path),
        arrange=left_on,
        act=lambda world, step: seen.append(bool(world.instruments["calibrator"].operating)),
    )
    assert found.run.outcome.error is None
    assert seen[0] is False


@pytest.mark.parametrize("role", ["logger", "calibrator"])
def test_a_silent_instrument_at_the_start_leaves_nothing_on(tmp_path: Path, rehearse: Start, role: str) -> None:
    error, world = refused(tmp_path, rehearse, lambda world: setattr(world.faults.instrument(role), "mute", True))
    assert error.code == "B-INST-001"
    assert any("B-RUN-060" in note and role in note for note in error.__notes__)
    assert role == "calibrator" or not world.instruments["calibrator"].operating


def test_an_instrument_with_another_serial_number_is_refused(tmp_path: Path, rehearse: Start) -> None:
    def other(world: World) -> None:
        world.faults.instrument("calibrator").identity = "FLUKE,5720A,OTHER99,1.0"

    error, world = refused(tmp_path, rehearse, other)
    assert error.code == "B-RUN-006"
    assert "OTHER99" in error.message
    assert not world.instruments["calibrator"].operating
    assert not (tmp_path / "out").exists()


def test_a_disk_without_room_is_refused_before_anything_is_opened(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=1_000_000))
    with pytest.raises(BenchError, match="B-RUN-005"):
        rehearse(tiny_plan(tmp_path), arrange=lambda world: pytest.fail("the bench was opened"))


def test_a_session_that_cannot_be_created_leaves_nothing_on(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SessionWriter, "create", no_space)
    error, world = refused(tmp_path, rehearse, lambda world: None)
    assert error.code == "B-REC-001"
    assert not world.instruments["calibrator"].operating


def test_a_session_that_cannot_be_closed_still_tells_how_the_run_ended(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SessionWriter, "close", no_space)
    outcome = rehearse(tiny_plan(tmp_path)).run.outcome
    assert outcome.error.code == "B-RUN-061"
    assert outcome.unsafe == ()
    assert len(outcome.rows) == 15
