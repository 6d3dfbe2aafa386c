"""A test of a limit is repeated behind a stall of the machine, and behind nothing else."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import stalls
from tree import TOP

TEST = """
import os, signal, time
from pathlib import Path
import pytest

def stop_the_meter(seconds):
    (meter,) = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    os.kill(int(meter), signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(int(meter), signal.SIGCONT)

@pytest.fixture(scope="module")
def bench():
    return []

@pytest.mark.limit(1.0)
def test_of_a_limit(bench):
    assert bench == [], "what the run before has left"
    bench.append("disturbed")
    runs = Path("runs.txt")
    first = not runs.exists()
    with runs.open("a") as file:
        file.write("run\\n")
    if first:
        stop_the_meter(SECONDS)
    assert not first

def test_on_the_same_bench(): ...
"""


@pytest.mark.parametrize(("stall_s", "runs", "said"), [(1.5, 2, "test_of_a_limit: repeated"), (0.0, 1, "1 failed")])
def test_only_a_stall_above_the_limit_repeats_a_test(tmp_path: Path, stall_s: float, runs: int, said: str) -> None:
    (tmp_path / "test_it.py").write_text(TEST.replace("SECONDS", str(stall_s)))
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = limit\n")
    support = str(TOP / "tests" / "support")
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "stalls"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": support},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert (tmp_path / "runs.txt").read_text().count("run") == runs, ended.stdout + ended.stderr
    assert said in ended.stdout
    assert ended.returncode == (0 if runs == 2 else 1)


def test_a_stall_is_told_once() -> None:
    with stalls.meter() as meter:
        meter._process.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        meter._process.send_signal(signal.SIGCONT)
        told_s = meter.late_s()
        assert told_s > 0.9
        assert meter.late_s() < told_s
