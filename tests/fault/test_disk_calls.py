"""Rows 1, 3, 4, 28 at the system calls themselves: killed at each write and fsync, a disk that refuses or hangs.

``strace`` injects the fault into a recorder of its own process; without strace these tests are skipped. The same faults
through the seam of the file layer are in tests/unit/record/test_writer.py.
"""

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from recorder import main as record

from bench.record import SessionReader, read_journal

SUPPORT = Path(__file__).resolve().parents[1] / "support"
STRACE = shutil.which("strace")
pytestmark = [pytest.mark.sweep, pytest.mark.skipif(STRACE is None, reason="strace is not installed")]
SECONDS = 90
CALLS = 200
SEGMENTS = 12


@dataclass
class Recorded:
    """What the recorder acknowledged, and how it ended."""

    folder: Path
    status: int
    said: str

    @property
    def acknowledged(self) -> list[int]:
        return [int(line.split()[1]) for line in self.said.splitlines() if line.startswith("ack")]

    def found(self) -> tuple[list[int], SessionReader]:
        """Records in the session, by event, each with its bytes."""
        reader = SessionReader(self.folder)
        numbers = [int(fields["number"]) for _, _, fields in reader.events("record")]
        raw = [int.from_bytes(one.payload, "big") for one in SessionReader(self.folder).messages(frozenset({"/link/"}))]
        assert raw[: len(numbers)] == numbers
        return numbers, reader


def recorded(folder: Path, *inject: str) -> Recorded:
    """Run the recorder under strace with faults in the calls that touch the files of its session."""
    session = folder / "s"
    paths = [session / "journal.jsonl", *(session / f"session.{n:04d}.mcap" for n in range(1, SEGMENTS))]
    words = [word for path in paths for word in ("-P", str(path))]
    words += [word for one in inject for word in ("-e", f"inject={one}")]
    command = [str(STRACE), "-f", "-qq", "-o", "/dev/null", *words, "-e", "trace=write,fsync"]
    command += [sys.executable, str(SUPPORT / "recorder.py"), str(session), str(SECONDS), "new"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return Recorded(session, done.returncode, done.stdout)


def goes_on(one: Recorded, acknowledged: list[int]) -> None:
    """Nothing acknowledged is lost, nothing is invented, and the session can be gone on with and closed."""
    numbers, _ = one.found()
    assert numbers == list(range(len(numbers)))
    assert set(acknowledged) <= set(numbers)
    assert len(numbers) <= len(acknowledged) + 1  # more than one second is never under way
    assert len(read_journal(one.folder).entries) >= len(acknowledged)
    assert record(str(one.folder), "3", "resume") == 0
    after, reader = one.found()
    assert after == list(range(len(numbers) + 3))
    assert reader.damage == []


def each_call(tmp_path: Path, call: str, check: Callable[[Recorded, int], None], step: int = 1) -> int:
    """``check`` for the fault at each of the first ``CALLS`` calls; returns how many there were."""
    for number in range(1, CALLS + 1, step):
        one = recorded(tmp_path / f"{call}{number}", f"{call}:signal=SIGKILL:when={number}")
        if "closed" in one.said:  # there were not that many
            return number - 1
        check(one, number)
        shutil.rmtree(one.folder.parent)
    return CALLS


@pytest.mark.parametrize("call", ["write", "fsync"])
def test_killed_at_each_call(tmp_path: Path, call: str) -> None:

    def check(one: Recorded, number: int) -> None:
        assert one.status in (-9, 137), number
        if (one.folder / "session.0001.mcap").exists() and SessionReader(one.folder).topics:
            goes_on(one, one.acknowledged)
        else:
            assert one.acknowledged == []

    calls = each_call(tmp_path, call, check)
    print(f"killed at each of {calls} calls of {call}: no acknowledged record lost")
    assert calls >= 150


WRITE_FAILS = [f"write:error={error}:when={n}" for n in range(3, CALLS, 14) for error in ("ENOSPC", "EIO")]
# writes of some 20 min of the bench fail, 30 min are waited for; before the twentieth it is refused: no session yet
FULL_FOR_A_WHILE = [f"write:error=ENOSPC:when={n}..{n + 5}" for n in range(20, CALLS, 20)]
# the page cache may have dropped what it could not write: nothing more goes to that file, a new segment begins
FSYNC_FAILS = [f"fsync:error=EIO:when={n}" for n in range(1, CALLS, 14)]
SLOW = "fsync:delay_exit=500000:when=5..9"


@pytest.mark.parametrize("fault", [*WRITE_FAILS, *FULL_FOR_A_WHILE, *FSYNC_FAILS, SLOW])
def test_a_call_that_fails_or_hangs_loses_nothing(tmp_path: Path, fault: str) -> None:
    one = recorded(tmp_path, fault)
    assert one.status == 0, one.said
    assert fault not in FULL_FOR_A_WHILE or "trouble" in one.said
    assert fault not in (*WRITE_FAILS, SLOW) or one.acknowledged == list(range(SECONDS))
    numbers, reader = one.found()
    assert numbers == list(range(SECONDS))
    assert reader.damage == []
