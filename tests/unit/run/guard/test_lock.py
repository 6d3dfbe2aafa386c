"""One controller at a time: against the kernel's own locks and other processes."""

import fcntl
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.model import posix
from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import ExitStatus, InputError
from bench.model.posix import user_name
from bench.run.guard.lock import GUARD, BenchLock, bench_lock, bus_keys, lock_folder
from bench.run.guard.take_over import take_over_request

KEYS = bus_keys(["GPIB0::4::INSTR", "TCPIP0::10.0.0.1::hislip0,4880::INSTR"])
HOLDER = """\
import sys
from pathlib import Path
from bench.model.clock import WallClock
from bench.model.posix import user_name
from bench.run.guard.lock import BenchLock
lock = BenchLock(sys.argv[3:], sys.argv[2], WallClock(), folder=Path(sys.argv[1]))
lock.take()
lock.name_session("night")
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the bench."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path), "run", *KEYS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def lock(folder: Path, keys: tuple[str, ...] = KEYS, what: str = "run", patience_s: float = 0.0) -> BenchLock:
    return BenchLock(keys, what, WallClock(), folder=folder, patience_s=patience_s)


def test_a_board_is_one_bus_and_anything_else_is_itself() -> None:
    assert bus_keys(["GPIB0::4::INSTR", "gpib0::22::INSTR", "GPIB1::4::INSTR"]) == ("GPIB0", "GPIB1")
    assert bus_keys(["tcpip0::a::hislip1,4880::instr", "ASRL3::INSTR"]) == (
        "ASRL3::INSTR",
        "TCPIP0::A::HISLIP1,4880::INSTR",
    )


def test_a_second_controller_is_refused_a_hundred_times_and_told_by_whom(
    tmp_path: Path, holder: subprocess.Popen[str]
) -> None:
    refused = 0
    for _ in range(100):
        with pytest.raises(InputError) as found:
            lock(tmp_path).take()
        refused += 1
        assert found.value.code == "B-RUN-092"
        assert f"pid {holder.pid}" in found.value.message
        assert "session night" in found.value.message
        assert found.value.exit_status is ExitStatus.BAD_INPUT
    assert refused == 100


def test_of_many_at_once_one_gets_it(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(tmp_path), "run", *KEYS]
    pipe = subprocess.PIPE
    many = [subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) for _ in range(5)]
    said = [process.stdout.readline() for process in many]  # each one either holds the bench by now or has ended
    assert sorted(said) == ["", "", "", "", "held\n"]
    refusals = [process.communicate()[1] for process in many]
    assert sum("B-RUN-092" in text for text in refusals) == 4


def test_one_bus_in_common_is_enough_and_who_is_refused_keeps_nothing(tmp_path: Path) -> None:
    with lock(tmp_path, ("B",)):
        with pytest.raises(InputError, match="in use"):
            lock(tmp_path, ("A", "B"), "talk").take()
        with lock(tmp_path, ("A",)):
            pass


def test_a_killed_holder_holds_nothing(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    second = lock(tmp_path)
    with lock(tmp_path), pytest.raises(InputError) as found:
        second.take()
    assert f"pid {os.getpid()}" in found.value.message


def test_a_child_does_not_inherit_the_bench(tmp_path: Path) -> None:
    taken = lock(tmp_path)
    taken.take()
    with subprocess.Popen(["sleep", "60"], close_fds=False) as child:
        taken.release()
        with lock(tmp_path):
            pass
        child.kill()


def test_the_kernel_agrees(tmp_path: Path) -> None:
    with lock(tmp_path, ("A",)):
        path = next(tmp_path.iterdir())
        assert path.stat().st_mode & 0o777 == 0o666
        with path.open("rb") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert json.loads(path.read_text())["pid"] == os.getpid()
    with path.open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert path.read_text() == ""


def test_a_guard_at_work_is_waited_for(tmp_path: Path) -> None:
    clock = VirtualClock()
    guard = BenchLock(KEYS, GUARD, clock, folder=tmp_path)
    guard.take()
    clock.every(3.0, guard.release)
    with BenchLock(KEYS, "run", clock, folder=tmp_path, patience_s=10.0):
        assert 3.0 <= clock.now_ns() / 1e9 < 3.5


@pytest.mark.parametrize(("holder_", "least_s"), [(GUARD, 10.0), ("talk", 0.0)])
def test_a_guard_is_not_waited_for_without_end_and_nobody_else_at_all(
    tmp_path: Path, holder_: str, least_s: float
) -> None:
    clock = VirtualClock()
    with BenchLock(KEYS, holder_, clock, folder=tmp_path):
        with pytest.raises(InputError, match=f"'{holder_}' of"):
            BenchLock(KEYS, "run", clock, folder=tmp_path, patience_s=10.0).take()
        assert least_s <= clock.now_ns() / 1e9 < least_s + 1.0


def test_one_that_has_not_named_itself_is_given_some_time(tmp_path: Path) -> None:
    """A guard that took the lock and was not given the processor before it could write its name."""
    clock = VirtualClock()
    guard = BenchLock(KEYS, GUARD, clock, folder=tmp_path)
    guard.take()
    for path in tmp_path.iterdir():
        path.write_text("")
    clock.every(3.0, guard.release)
    with pytest.raises(InputError, match="has not named itself"):
        BenchLock(KEYS, "talk", clock, folder=tmp_path).take()
    assert clock.now_ns() < 1e9
    with BenchLock(KEYS, "run", clock, folder=tmp_path, patience_s=90.0):
        assert 3.0 <= clock.now_ns() / 1e9 < 3.5


def test_one_of_another_form_holds_the_bench_whatever_it_says(tmp_path: Path) -> None:
    clock = VirtualClock()
    with BenchLock(("A",), GUARD, clock, folder=tmp_path):
        next(tmp_path.iterdir()).write_text('{"v": 2, "owner": "somebody"}')
        with pytest.raises(InputError, match=r"B-RUN-092: .* lock is of form 2, and this software knows form 1"):
            BenchLock(("A",), "run", clock, folder=tmp_path, patience_s=90.0).take()
    assert clock.now_ns() < 1e9


def test_a_lock_that_cannot_be_opened_is_said(tmp_path: Path) -> None:
    with lock(tmp_path, ("A",)):
        path = next(tmp_path.iterdir())
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="B-RUN-093"):
        lock(tmp_path, ("A",)).take()
    assert not (tmp_path / "elsewhere").exists()


def test_the_place_is_the_same_for_every_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert lock_folder().stat().st_mode & 0o002
    monkeypatch.setattr("bench.run.guard.lock._SHARED", tmp_path)  # one that this user alone may write to
    assert lock_folder() != tmp_path
    monkeypatch.setattr("bench.run.guard.lock._SHARED", tmp_path / "none")
    assert lock_folder().stat().st_mode & 0o002
    monkeypatch.undo()
    with bench_lock(["TCPIP0::127.0.0.1::nobody::INSTR"], "test", WallClock()):
        pass


def test_no_bench_is_taken_where_nothing_would_lock_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posix, "_fcntl", None)
    with BenchLock((), "talk", VirtualClock(), folder=tmp_path):
        pass  # a bench inside this process needs no lock
    with pytest.raises(InputError) as refused, BenchLock(KEYS, "run", VirtualClock(), folder=tmp_path):
        pass
    assert (refused.value.code, refused.value.exit_status) == ("B-SYS-001", ExitStatus.BAD_INPUT)
    assert list(tmp_path.iterdir()) == []


def test_a_person_takes_the_bench_over_from_a_guard_that_does_not_end(tmp_path: Path) -> None:
    clock, folder = VirtualClock(), tmp_path / "night"
    folder.mkdir()
    guard = BenchLock(KEYS, GUARD, clock, folder=tmp_path)
    guard.name_session(folder.name, folder)
    guard.take()
    with pytest.raises(InputError, match="--take-over"):
        BenchLock(KEYS, "resume", clock, folder=tmp_path, patience_s=1.0).take()
    asked: list[str] = []

    def look() -> None:
        if (request := take_over_request(folder)) is not None:
            asked.append(request.by)
            guard.release()

    clock.every(0.1, look)
    with BenchLock(KEYS, "resume", clock, folder=tmp_path, patience_s=1.0, take_over=True):
        assert asked == [user_name()]
    guard.name_session("gone", tmp_path / "gone")
    with guard, pytest.raises(InputError) as found:
        BenchLock(KEYS, "talk", clock, folder=tmp_path, patience_s=1.0, take_over=True).take()
    assert (found.value.code, found.value.where) == ("B-RUN-097", str(tmp_path / "gone"))


def test_a_controller_is_not_taken_over(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    with pytest.raises(InputError, match="B-RUN-092"):
        BenchLock(KEYS, "resume", WallClock(), folder=tmp_path, take_over=True).take()
    assert holder.poll() is None
