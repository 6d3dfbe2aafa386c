"""Rows 3, 4 and 28 in a whole campaign: a disk that is full for a while, for good, or hangs for ten seconds."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from kill_drill import LONGEST_S, SEQUENCE, Process, session_in
from record_sample import FaultyFiles, io_error, no_space
from rehearsal import Rehearsal, rehearsed
from served import Served
from soak_campaign import soak_plan, watchers

from bench.commands.resume import resume
from bench.model.clock import NS, VirtualClock
from bench.record import SessionReader
from bench.record import writer as writer_module
from bench.session.service import read_view
from sim_instruments.served.process import OutputWatch
from sim_instruments.worlds.common.world import World

STRACE = shutil.which("strace")
RECORDS = 25
STALL_AT_S, STALL_S = 15.0, 10
FULL_FROM_S, FULL_TO_S = 120.0, 160.0


def conducted(folder: Path, patch: pytest.MonkeyPatch, fault: Callable[[float, str], OSError | None]) -> Rehearsal:
    """The short campaign on a disk whose calls fail as ``fault(seconds, kind)`` says."""
    clock, plan = VirtualClock(), soak_plan(folder)
    patch.setattr(writer_module, "OsFiles", lambda: FaultyFiles(lambda kind, n: fault(clock.now_ns() / NS, kind)))
    return rehearsed(folder / "out", plan, clock=clock, seed=4, beside=watchers(plan))


def on(world: World) -> list[str]:
    state = OutputWatch(world).state()["instruments"]
    return [role for role, one in state.items() if one.get("operating") or one.get("on") or one.get("closed")]


@pytest.mark.parametrize("error", [no_space, io_error])
def test_a_disk_that_refuses_for_a_while_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Callable[[], OSError]
) -> None:
    def fault(t_s: float, kind: str) -> OSError | None:
        return error() if FULL_FROM_S <= t_s < FULL_TO_S and kind in ("write", "create") else None

    done = conducted(tmp_path, monkeypatch, fault)
    run = done.run
    assert run.outcome.error is None
    assert len(run.outcome.rows) + 4 >= RECORDS
    assert len([text for text in done.watched.messages if "B-REC-001" in text]) == 1  # one alarm, not one each second
    assert [fields["code"] for _, _, fields in SessionReader(run.folder).events("error")] == ["B-REC-004"]
    view = read_view(run.folder, strict=True)
    assert [row.window for row in view.rows] == [row.window for row in run.outcome.rows]
    assert not view.incomplete


@pytest.mark.parametrize(("limit", "most"), [("HELD_BYTES", 300_000), ("REFUSED_S", 60)])
def test_a_disk_that_stays_full_ends_the_run_safely_and_it_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, most: int
) -> None:
    monkeypatch.setattr(writer_module, limit, most)

    def fault(t_s: float, kind: str) -> OSError | None:
        return no_space() if t_s >= FULL_FROM_S and kind in ("write", "create") else None

    done = conducted(tmp_path, monkeypatch, fault)
    run = done.run
    assert run.outcome.error.code == "B-REC-003"
    assert run.outcome.unsafe == ()
    assert on(done.world) == []
    monkeypatch.undo()  # there is room again
    whole = read_view(run.folder).rows
    assert resume(run.folder, None, None, as_json=False) == 0
    view = read_view(run.folder, strict=True)
    assert view.damaged is False
    assert len(view.splices) == 1
    known = {row.window.number: row.window for row in view.rows}
    assert all(known[row.window.number] == row.window for row in whole)


@pytest.mark.sweep
@pytest.mark.skipif(STRACE is None, reason="strace is not installed")
def test_an_fsync_of_ten_seconds_costs_no_frame(served: Served, tmp_path: Path) -> None:
    """A real run in real time; its thread for the disk hangs in the call, everything else goes on."""
    words = ["run", SEQUENCE, "--station", str(served.station), "--clock", "wall", "--out", str(tmp_path / "out")]
    process = Process(tmp_path / "said", *words)
    try:
        assert process.ended_by(STALL_AT_S) is None, process.said()
        folder = session_in(tmp_path / "out")
        assert folder is not None
        trace = tmp_path / "trace"
        strace = [str(STRACE), "-f", "-o", str(trace), "-P", str(folder / "session.0001.mcap"), "-e", "trace=fsync"]
        strace += ["-e", f"inject=fsync:delay_exit={STALL_S * 1_000_000}:when=3", "-p", str(process.pid)]
        with subprocess.Popen(strace, stderr=subprocess.DEVNULL):
            assert process.ended_by(LONGEST_S) == 0, process.said()
    finally:
        process.end()
    assert "(DELAYED)" in trace.read_text()
    quality = json.loads((folder / "results.json").read_text())["quality"]
    assert (quality["frames_lost"], quality["frames_bad"], quality["records"]) == (0, 0, 10)
    assert not read_view(folder, strict=True).incomplete
