"""A run with a driver of a lab folder is killed: its guard makes the bench safe with that driver, resume demands it."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from kill_drill import LONGEST_S, Process, killed, resumable, safe_after_s, session_in
from own_lab import DRIVER, copied
from rehearsal import Inside, bench
from served import SAFE_S, serving
from waiting import until

from bench.model.clock import WallClock
from bench.model.errors import RunError
from bench.model.posix import GUARD
from bench.record import SessionReader
from bench.run.guard.decision import Address, Brief
from bench.run.guard.diary import read_diary
from bench.run.guard.start import GuardProcess
from bench.run.stop import Health, StopSwitch

pytestmark = pytest.mark.waits

NOBODY = 1 << 22  # a number that no process has


def told(lab: Path, code: dict[str, str]) -> tuple[int, str, str]:
    """Start a guard as a run does, with the hashes of ``code``; its controller is nobody. Status, output and errors."""
    address = {"role": "thermometer", "driver": "example_t100", "resource": "GPIB0::11::INSTR", "options": {}}
    brief = {
        "pid": NOBODY, "visa": "@bench", "instruments": [address], "limits": {}, "silence_s": 60.0,
        "diary": str(lab / "diary"), "notify": [], "code": code,
    }  # fmt: skip
    said = json.dumps(brief) + "\n" + json.dumps({"goodbye": "done"}) + "\n"
    done = subprocess.run(
        [sys.executable, "-P", "-m", GUARD], input=said, capture_output=True, text=True, check=False, cwd=lab
    )
    return done.returncode, done.stdout, done.stderr


def test_the_guard_demands_the_hash(tmp_path: Path) -> None:
    lab = copied(tmp_path / "lab")
    (lab / DRIVER).write_text("print('this was executed')\n" + (lab / DRIVER).read_text())
    status, said, errors = told(lab, {DRIVER: "0" * 64})
    assert (status, said, errors.count("\n")) == (2, "", 1)
    assert errors.startswith(f"error B-LAB-007: {DRIVER}: SHA-256 000000000000 of the run is asked for, and ")


def test_no_run_begins_under_a_guard_that_found_other_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copied(tmp_path / "lab"))
    address = Address("thermometer", "example_t100", "GPIB0::11::INSTR")
    brief = Brief(os.getpid(), "@bench", (address,), {}, 2.0, str(tmp_path / "diary"), code={DRIVER: "0" * 64})
    clock = WallClock()
    with StopSwitch() as stop, pytest.raises(RunError, match="B-LAB-007") as caught:
        GuardProcess(brief, Health(clock), stop, clock, lambda event: None).__enter__()
    assert caught.value.code == "B-RUN-090"


@pytest.mark.slow
@pytest.mark.limit(SAFE_S)
def test_killed_moved_and_resumed(tmp_path: Path, inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, out = copied(tmp_path / "lab"), tmp_path / "out"
    out.mkdir()
    monkeypatch.chdir(lab)
    with serving(tmp_path / "served", of="t100_bench") as served:
        words = ("--station", str(served.station), "--clock", "wall", "--out", str(out))
        short = ("--set", "dwell=4 s", "--set", "between=1 s")
        process = Process(out / "said.txt", "run", "air_mean", *words, *short)
        try:
            _first_record(out, process)
            moment_s = killed(process, out)
            safe_s, on = safe_after_s(served, moment_s)
        finally:
            process.end()
        folder = session_in(out)
        assert folder is not None, process.said()
        assert (on, safe_s <= SAFE_S) == ([], True), (on, safe_s)
        assert _safe_by_its_guard(folder) == ["thermometer"]

        text = (lab / DRIVER).read_text()
        (lab / DRIVER).write_text(text + "\n# changed\n")
        refused = inside("resume", str(folder), cwd=lab)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1), refused.stderr
        assert f"error B-LAB-007: {DRIVER}: " in refused.stderr
        (lab / DRIVER).write_text(text)
        moved = lab.rename(tmp_path / "moved")
        nowhere = inside("resume", str(folder), cwd=tmp_path)
        assert (nowhere.returncode, "there is no lab folder here" in nowhere.stderr) == (2, True)
        resumed = bench("resume", str(folder), cwd=moved)
        assert resumed.returncode in (0, 1), resumed.stderr
        results = json.loads((folder / "results.json").read_text())
        assert {entry["conditions"]["place"] for entry in results["estimates"]} == {1, 2}
        assert results["quality"]["splices"] == 1
        verified = inside("report", "--verify", str(folder), cwd=moved)
        assert (verified.returncode, "identical: " in verified.stdout) == (0, True), verified.stdout


def _first_record(out: Path, process: Process) -> None:
    """Wait until the first record is in the session: the run is in its second one, or on its way to it."""

    def there() -> bool:
        assert process.ended_by(0.0) is None, process.said()
        folder = session_in(out)
        return folder is not None and resumable(folder) and any(SessionReader(folder).events("record"))

    until(there, process.said, LONGEST_S)


def _safe_by_its_guard(folder: Path) -> list[str]:
    """Return the roles that the guard has confirmed safe, when its diary says that it is done."""

    def diary() -> list[dict[str, Any]]:
        return read_diary(folder / "guard.jsonl")

    until(lambda: {"safe", "unsafe"} & {entry["what"] for entry in diary()}, "the end of the guard", LONGEST_S)
    return [entry["role"] for entry in diary() if entry["what"] == "instrument" and entry["safe"]]
