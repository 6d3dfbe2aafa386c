"""Rows 3, 4, 5, 24, 28: a clock that is set, a machine that sleeps, a disk that is full or hangs, many benches."""

import gc
import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from kill_drill import LONGEST_S, SEQUENCE, Process, session_in
from record_sample import FaultyFiles, io_error, no_space
from rehearsal import Rehearsal, rehearsed
from served import Served
from soak_campaign import soak_plan, watchers

from bench.commands.resume import resume
from bench.commands.run import view_of
from bench.model.clock import NS, VirtualClock, WallClock
from bench.model.errors import BenchError
from bench.model.events import Event
from bench.plan import Plan, load_station
from bench.record import Journal, SessionReader, SessionWriter
from bench.record import writer as writer_module
from bench.run.bus.opener import open_bench
from bench.run.guard.lock import bench_lock
from bench.run.session import Conducted
from bench.run.stop import StopSwitch
from bench.run.watch.clock import LOOK_S, STEP_S, clock_watch
from bench.session.happenings import happenings
from bench.session.service import read_view
from bench.session.view import KEPT_EVENTS
from sim_instruments.served.process import OutputWatch
from sim_instruments.worlds.common.world import World

STEP_AT_S = 90.3
HOUR_S = 3600.0


class MovedClock(VirtualClock):
    """UTC is off by ``moved(seconds of monotonic time)`` seconds."""

    def __init__(self, moved: Callable[[float], float]) -> None:
        super().__init__()
        self._moved = moved

    def utc_ns(self) -> int:
        return super().utc_ns() + round(self._moved(self.now_ns() / NS) * NS)


def stepped(step_s: float) -> MovedClock:
    return MovedClock(lambda t_s: step_s if t_s >= STEP_AT_S else 0.0)


def watched(clock: MovedClock, seconds: float) -> list[tuple[float, dict[str, Any]]]:
    """Events (time, fields) of a watch over some seconds."""
    found: list[tuple[float, dict[str, Any]]] = []

    def note(event: Event) -> None:
        assert event.kind == "clock_step"
        assert event.told
        found.append((clock.now_ns() / NS, event.document()))

    context: Any = SimpleNamespace(clock=clock, note=note, stop=StopSwitch())
    with clock_watch(context):
        clock.sleep(seconds)
    clock.sleep(10.0)
    return found


@pytest.mark.parametrize("step_s", [-HOUR_S, 1.0, HOUR_S, -0.51])
def test_a_step_is_an_event_within_a_second(step_s: float) -> None:
    ((at_s, fields),) = watched(stepped(step_s), 200.0)
    assert 0.0 <= at_s - STEP_AT_S <= 1.0
    assert fields["step_s"] == pytest.approx(step_s)
    assert LOOK_S + STEP_S <= 1.0


def test_a_clock_that_is_slewed_or_corrected_a_little_is_no_event() -> None:
    assert watched(MovedClock(lambda t_s: 500e-6 * t_s), 4 * HOUR_S) == []  # adjtimex(2): the most there is
    assert watched(stepped(0.49), 200.0) == []


def test_a_thread_that_was_not_given_the_processor_sees_no_step() -> None:
    """The two clocks are read one after the other; a pause between the readings is not a step."""
    clock = VirtualClock()
    pauses = iter([0.0, 0.0, 0.0, 3.0, 3.0])
    plain = clock.utc_ns
    clock.utc_ns = lambda: (clock.sleep(next(pauses, 0.0)), plain())[1]  # type: ignore[method-assign]
    assert watched(clock, 60.0) == []  # type: ignore[arg-type]


def conducted(folder: Path, clock: VirtualClock) -> tuple[Conducted, Any]:
    folder.mkdir()
    plan = soak_plan(folder)
    beside = [*watchers(plan), clock_watch]
    run = rehearsed(folder / "out", plan, clock=clock, seed=5, beside=beside, kept=KEPT_EVENTS).run
    assert run.outcome.error is None
    return run, plan


def steps_in(folder: Path) -> list[tuple[str, int]]:
    return [(kind, t_ns) for kind, t_ns, _ in SessionReader(folder).events() if kind != "clock_step"]


def test_a_campaign_takes_exactly_as_long_under_a_clock_that_is_set(tmp_path: Path) -> None:
    plain, _ = conducted(tmp_path / "plain", VirtualClock())
    moved, plan = conducted(tmp_path / "moved", stepped(-HOUR_S))
    assert steps_in(moved.folder) == steps_in(plain.folder)  # every soak, dwell and record, to the nanosecond
    assert [row.window for row in moved.outcome.rows] == [row.window for row in plain.outcome.rows]
    assert [fields["step_s"] for kind, _, fields in moved.events if kind == "clock_step"] == [pytest.approx(-HOUR_S)]
    assert any(line.startswith("clock_step") for line in happenings(view_of(plan, moved)))


SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>
/* UTC is moved as long as the file exists; the monotonic clock is left alone. */
int clock_gettime(clockid_t which, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *)) dlsym(RTLD_NEXT, "clock_gettime");
    int done = real(which, now);
    if (which == CLOCK_REALTIME && getenv("MOVED_FILE") && !access(getenv("MOVED_FILE"), F_OK)) now->tv_sec -= 3600;
    return done;
}
"""


@pytest.mark.sweep
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_clock_of_the_machine_is_set_back_an_hour(served: Served, tmp_path: Path) -> None:
    """A real process in real time, whose libc tells another UTC from one moment on."""
    (tmp_path / "shim.c").write_text(SHIM)
    library, moved = tmp_path / "shim.so", tmp_path / "moved"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "shim.c", "-ldl"], check=True)
    words = ["run", SEQUENCE, "--station", str(served.station), "--clock", "wall", "--out", str(tmp_path / "out")]
    environment = {**os.environ, "LD_PRELOAD": str(library), "MOVED_FILE": str(moved)}
    clock = WallClock()
    with (tmp_path / "said").open("wb") as said:
        process = subprocess.Popen([sys.executable, "-m", "bench", *words], env=environment, stdout=said, stderr=said)
        clock.sleep(25.0)
        moved.touch()
        moved_ns = clock.now_ns()
        assert process.wait(120.0) == 0, (tmp_path / "said").read_text()
    (folder,) = (path for path in (tmp_path / "out").iterdir() if path.is_dir())
    ((_, t_ns, fields),) = SessionReader(folder).events("clock_step")
    print(f"noticed after {(t_ns - moved_ns) / NS:.3f} s")
    assert 0 <= t_ns - moved_ns <= NS
    assert fields["step_s"] == pytest.approx(-HOUR_S, abs=0.1)
    results = json.loads((folder / "results.json").read_text())
    assert results["quality"]["records"] == 10
    assert results["quality"]["frames_lost"] == 0


STRACE = shutil.which("strace")
RECORDS = 25
STALL_AT_S, STALL_S = 15.0, 10
FULL_FROM_S, FULL_TO_S = 120.0, 160.0


def on_a_disk(folder: Path, patch: pytest.MonkeyPatch, fault: Callable[[float, str], OSError | None]) -> Rehearsal:
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

    done = on_a_disk(tmp_path, monkeypatch, fault)
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

    done = on_a_disk(tmp_path, monkeypatch, fault)
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


CYCLES = 1000
SHORT = 15
SERVED = 40


def kept() -> tuple[int, int]:
    """Descriptors and threads of this process."""
    gc.collect()
    return len(list(Path("/proc/self/fd").iterdir())), threading.active_count()


def constant(cycle: Callable[[int], None], cycles: int) -> None:
    """After a first few, no cycle leaves anything behind."""
    for number in range(3):
        cycle(number)
    before = kept()
    for number in range(3, 3 + cycles):
        cycle(number)
    assert kept() == before


def failing_run(plan: Plan, out: Path) -> Callable[[int], None]:
    """A run whose instrument is not the one it should be: opened, refused, closed."""

    def exchange(world: World) -> None:
        world.faults.instrument("switch").identity = "ACME,42,0,0"

    def cycle(_: int) -> None:
        with pytest.raises(BenchError, match="B-INST-002"):
            rehearsed(out, plan, exchange, seed=1)

    return cycle


@pytest.mark.parametrize("cycles", [SHORT, pytest.param(CYCLES, marks=pytest.mark.sweep)])
@pytest.mark.waits
def test_benches_that_do_not_open(tmp_path: Path, cycles: int) -> None:
    constant(failing_run(soak_plan(tmp_path), tmp_path / "out"), cycles)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("cycles", [SHORT, pytest.param(CYCLES, marks=pytest.mark.sweep)])
@pytest.mark.waits
def test_sessions_and_journals(tmp_path: Path, cycles: int) -> None:
    def cycle(number: int) -> None:
        folder = tmp_path / str(number)
        writer = SessionWriter.create(folder, {"schema": 1}, {}, t_mono_ns=0)
        with pytest.raises(BenchError, match="B-REC-001"):
            SessionWriter.create(folder, {"schema": 1}, {}, t_mono_ns=0)
        journal = Journal(folder)
        with pytest.raises(BenchError, match="B-REC-006"):
            Journal(folder)
        journal.close()
        writer.close("done")

    constant(cycle, cycles)


@pytest.mark.slow
@pytest.mark.parametrize("cycles", [4, pytest.param(SERVED, marks=pytest.mark.sweep)])
@pytest.mark.waits
def test_benches_in_another_process_that_do_not_open(served: Served, cycles: int) -> None:
    """Sessions of PyVISA over the network, ports and the lock of the bench."""
    station, clock = load_station(served.station), WallClock()
    served.fault("identity", "rail_dmm", "ACME,42,0,0")

    def cycle(_: int) -> None:
        with bench_lock((entry.resource for entry in station.instruments.values()), "test", clock):
            bench = open_bench(station, clock, lambda *_: None, seed=1)
            try:
                with pytest.raises(BenchError, match="B-INST-002"):
                    bench.instruments["rail_dmm"].identify()
            finally:
                bench.close()

    constant(cycle, cycles)
