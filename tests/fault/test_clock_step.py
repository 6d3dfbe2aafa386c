"""Row 5: the clock of the machine is set, or the machine sleeps: an event within a second, and no duration changes."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from kill_drill import SEQUENCE
from rehearsal import rehearsed
from served import Served
from soak_campaign import soak_plan, watchers

from bench.commands.run import view_of
from bench.model.clock import NS, VirtualClock, WallClock
from bench.model.events import Event
from bench.record import SessionReader
from bench.run.session import Conducted
from bench.run.stop import StopSwitch
from bench.run.watch.clock import LOOK_S, STEP_S, clock_watch
from bench.session.happenings import happenings
from bench.session.view import KEPT_EVENTS

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
