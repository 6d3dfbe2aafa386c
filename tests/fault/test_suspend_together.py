"""Row 5: controller and guard stop together, as they do on a machine that is suspended, with the calibrator on.

A stop moves no clock; for the boot clock of a machine that slept see tests/unit/run/watch/test_clock_disk_contact.py.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from kill_drill import LONGEST_S, RECORDS, SEQUENCE, Process, after_some_records, session_in
from served import SAFE_S, Served
from waiting import until

from bench.commands.session import replay
from bench.model.clock import NS
from bench.record import SessionReader
from bench.replay import replay_rows
from bench.run.guard.diary import read_diary

pytestmark = [pytest.mark.waits, pytest.mark.limit(SAFE_S)]

STOPPED_S = 5.0
AHEAD_S = 0.5  # the guard goes on before its controller, and must not take it for dead


def stopped_together(served: Served, process: Process, guard: int) -> tuple[float, float]:
    """Stop both while the calibrator is on, and let both go on; returns when the controller stopped and went on, s."""
    until(lambda: served.on() == ["calibrator", "switch"], "a stimulus that is on", each_s=0.02)
    stopped_s = time.monotonic()
    for pid in (guard, process.pid):
        os.kill(pid, signal.SIGSTOP)
    time.sleep(STOPPED_S)
    assert served.on() == ["calibrator", "switch"]  # nobody is there
    os.kill(guard, signal.SIGCONT)
    time.sleep(AHEAD_S)
    awake_s = time.monotonic()
    os.kill(process.pid, signal.SIGCONT)
    return stopped_s, awake_s


@pytest.mark.slow
def test_the_stimulus_goes_off_and_the_point_is_taken_again(served: Served, out: Path) -> None:
    words = ["run", SEQUENCE, "--station", str(served.station), "--clock", "wall", "--out", str(out)]
    out.mkdir()
    process = Process(out / "said", *words)
    try:
        after_some_records(out)
        folder = session_in(out)
        assert folder is not None
        guard = next(fields["pid"] for _, _, fields in SessionReader(folder).events("guard"))
        stopped_s, awake_s = stopped_together(served, process, guard)
        until(lambda: not served.on(), "outputs that are off", awake_s + SAFE_S - time.monotonic(), each_s=0.02)
        off_s = served.changed_s("calibrator") - awake_s
        print(f"off {off_s:.2f} s after both went on")
        assert 0.0 < off_s <= SAFE_S
        assert process.ended_by(LONGEST_S) == 0, process.said()
    finally:
        process.end()
    assert served.on() == []
    _judge(folder, stopped_s, awake_s)


def _judge(folder: Path, stopped_s: float, awake_s: float) -> None:
    """The session tells it, no record was taken across it, and all its numbers are found again."""

    def events(kind: str) -> list[dict[str, Any]]:
        return [fields for _, _, fields in SessionReader(folder).events(kind)]

    (suspend,), (hold,), (armed,) = events("suspend"), events("hold"), events("armed")
    assert suspend["seen"] == "late beat"
    assert STOPPED_S <= suspend["seconds"] <= awake_s - stopped_s + 1.0
    assert (hold["by"], hold["step"]) == ("suspend", armed["step"])
    windows = [row.window for row in replay_rows(folder, strict=True).measurement_rows]
    assert len({window.step for window in windows}) == len(windows) == RECORDS
    for window in windows:
        assert window.t_end_ns < stopped_s * NS or window.t_start_ns > awake_s * NS
    assert [entry["what"] for entry in read_diary(folder / "guard.jsonl")] == ["ready", "asleep", "dismissed"]
    assert replay(folder, as_json=False) == 0
