"""The two clocks behind one interface; what is not there off POSIX, its equivalents and its refusal."""

import errno
import os
import socket
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.model import posix
from bench.model.clock import NS, VIRTUAL_START_UTC_NS, VirtualClock, WallClock, to_ns
from bench.model.errors import ExitStatus, InputError


def test_virtual_time_jumps_and_calls_back_in_order_until_cancelled() -> None:
    clock = VirtualClock()
    clock.sleep(136_800.0)
    assert clock.now_ns() == 136_800 * NS
    assert clock.utc_ns() == VIRTUAL_START_UTC_NS + 136_800 * NS
    clock.sleep_until_ns(5)
    assert clock.now_ns() == 136_800 * NS
    clock = VirtualClock()
    seen: list[tuple[str, int]] = []
    clock.every(2.0, lambda: seen.append(("a", clock.now_ns() // NS)))
    clock.every(1.0, lambda: seen.append(("b", clock.now_ns() // NS)))
    clock.sleep(4.0)
    assert seen == [("b", 1), ("a", 2), ("b", 2), ("b", 3), ("a", 4), ("b", 4)]
    clock = VirtualClock()
    seen: list[int] = []
    task = clock.every(1.0, lambda: (seen.append(clock.now_ns() // NS), task.cancel() if len(seen) == 2 else None))
    clock.sleep(10.0)
    assert seen == [1, 2]


def test_a_callback_that_sleeps_is_not_entered_again_and_drops_missed_ticks() -> None:
    clock = VirtualClock()
    seen: list[int] = []

    def slow() -> None:
        seen.append(clock.now_ns() // NS)
        clock.sleep(2.5)

    clock.every(1.0, slow)
    clock.sleep(10.0)
    assert seen == [1, 4, 7, 10]


def test_an_error_in_a_callback_reaches_the_sleeper_and_leaves_the_clock_usable() -> None:
    clock = VirtualClock()
    task = clock.every(1.0, lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        clock.sleep(5.0)
    task.cancel()
    assert clock.now_ns() == NS
    clock.sleep(1.0)
    assert clock.now_ns() == 2 * NS


def test_quiet_time_ends_at_the_sleeper_or_the_next_callback_that_may_change_the_bench() -> None:
    clock = VirtualClock()
    horizons: list[float] = []
    clock.every(1.0, lambda: horizons.append(clock.quiet_until_ns() / NS), observer=True)
    clock.sleep(2.0)
    clock.every(2.5, lambda: None, observer=False)
    clock.sleep(4.0)
    assert horizons == [2.0, 2.0, 4.5, 4.5, 6.0, 6.0]


@pytest.mark.parametrize("clock", [VirtualClock(), WallClock()])
def test_a_period_must_be_positive(clock: VirtualClock | WallClock) -> None:
    with pytest.raises(ValueError, match="not positive"):
        clock.every(0.0, lambda: None)


def test_wall_clock_sleeps_at_least_as_long_as_asked() -> None:
    clock = WallClock()
    start = clock.now_ns()
    clock.sleep_until_ns(start + 20_000_000)
    clock.sleep(0.01)
    assert clock.now_ns() - start >= 30_000_000
    assert abs(clock.utc_ns() / NS - 1.7e9) < 1e9
    assert abs(clock.now_ns() - time.monotonic_ns()) < NS  # a clock that is set moves nothing


def test_wall_clock_calls_back_on_its_own_thread_until_cancelled() -> None:
    clock = WallClock()
    called = threading.Semaphore(0)
    threads = set()
    task = clock.every(0.005, lambda: (threads.add(threading.current_thread()), called.release()))
    assert all(called.acquire(timeout=5.0) for _ in range(3))
    task.cancel()
    assert threading.main_thread() not in threads
    assert not any(thread.is_alive() for thread in threads)


def test_seconds_are_rounded_to_the_nearest_nanosecond() -> None:
    assert to_ns(0.1) == 100_000_000
    assert to_ns(1e-9 * 1.6) == 2


def test_an_error_on_a_thread_of_the_wall_clock_reaches_the_main_thread() -> None:
    clock = WallClock()
    called = threading.Event()
    calls: list[int] = []

    def fail() -> None:
        calls.append(1)
        called.set()
        raise OSError("gone")

    ticking = clock.every(0.005, fail)
    assert called.wait(5.0)
    with pytest.raises(OSError, match="gone"):
        clock.sleep(0.05)
    clock.sleep(0.03)
    ticking.cancel()
    assert calls == [1]


def test_turns_ahead_are_those_before_anybody_else_acts() -> None:
    clock = VirtualClock()
    ahead: list[list[float]] = []
    clock.every(2.0, lambda: None)  # registered first: at the same time its turn comes first
    clock.every(1.0, lambda: ahead.append([turn / NS for turn in clock.turns_ahead_ns()]))
    clock.every(3.0, lambda: None)
    clock.sleep(5.0)
    assert ahead == [[], [3.0], [], [5.0], []]


def test_turns_that_were_passed_are_not_taken_again() -> None:
    clock = VirtualClock()
    taken: list[tuple[str, float]] = []

    def turn() -> None:
        taken.append(("first", clock.now_ns() / NS))
        for due_ns in clock.turns_ahead_ns():
            clock.pass_to_ns(due_ns)

    clock.every(1.0, turn)
    clock.every(4.0, lambda: taken.append(("other", clock.now_ns() / NS)))
    clock.sleep(9.0)
    assert taken == [("first", 1.0), ("other", 4.0), ("first", 5.0), ("other", 8.0), ("first", 9.0)]
    assert clock.now_ns() == 9 * NS


TOP = Path(__file__).resolve().parents[3]
ALONE = TOP / "bench" / "model" / "posix.py"


def test_what_needs_posix_is_refused_with_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posix, "_fcntl", None)
    monkeypatch.delattr(socket, "AF_UNIX")
    assert posix.lacking() == ("fcntl", "AF_UNIX")
    with pytest.raises(InputError) as refused:
        posix.require("a run on the wall clock")
    assert (refused.value.code, refused.value.exit_status) == ("B-SYS-001", ExitStatus.BAD_INPUT)
    assert refused.value.message == "a run on the wall clock needs Linux; this system has no fcntl, AF_UNIX"
    with pytest.raises(OSError, match="no Unix sockets"):
        posix.unix_socket()


def test_who_is_at_the_other_end(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = socket.socketpair()
    with one, other:
        assert posix.peer(one) == (os.getpid(), os.getuid())
        monkeypatch.delattr(socket, "SO_PEERCRED")
        assert posix.peer(one) is None
    assert "SO_PEERCRED" in posix.lacking()  # macOS


def test_a_lock_is_held_until_the_file_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    path.write_bytes(b"line\n")
    one, other = (os.open(path, os.O_RDONLY | posix.ALONE) for _ in range(2))
    posix.lock_file(one)
    with pytest.raises(BlockingIOError):
        posix.lock_file(other)
    os.close(one)
    posix.lock_file(other)
    os.close(other)


@pytest.mark.parametrize(("number", "raised"), [(None, None), (errno.EACCES, BlockingIOError), (errno.EIO, OSError)])
def test_windows_locks_a_byte_behind_everything_that_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int | None, raised: type[OSError] | None
) -> None:
    asked: list[tuple[int, int, int]] = []

    def locking(descriptor: int, mode: int, count: int) -> None:
        asked.append((os.lseek(descriptor, 0, os.SEEK_CUR), mode, count))
        if number is not None:
            raise OSError(number, "as the C library says it")

    monkeypatch.setattr(posix, "_fcntl", None)
    monkeypatch.setattr(posix, "_msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    with (tmp_path / "journal").open("wb") as file:
        if raised is None:
            posix.lock_file(file.fileno())
        else:
            with pytest.raises(raised) as refused:
                posix.lock_file(file.fileno())
            assert type(refused.value) is raised
    assert asked == [(1 << 30, 2, 1)]


@pytest.mark.parametrize("missing", [(), ("pread", "pwrite")])
def test_bytes_at_a_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: tuple[str, ...]) -> None:
    for name in missing:
        monkeypatch.delattr(os, name)
    with (tmp_path / "file").open("w+b", buffering=0) as file:
        file.write(b"0123456789")
        assert posix.write_at(file.fileno(), memoryview(b"ab"), 4) == 2
        assert posix.read_at(file.fileno(), 4, 3) == b"3ab6"


def test_whose_file_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch(0o600)
    status = (tmp_path / "file").stat()
    foreign = SimpleNamespace(st_uid=status.st_uid + 1, st_mode=status.st_mode)
    (tmp_path / "file").chmod(0o620)
    assert posix.is_own(status)
    assert not posix.is_own((tmp_path / "file").stat())
    assert not posix.is_own(foreign)  # type: ignore[arg-type]
    of_root = SimpleNamespace(st_uid=0, st_mode=0o100644)
    assert posix.is_own(of_root, or_of_root=True)  # type: ignore[arg-type]
    monkeypatch.delattr(os, "geteuid")
    assert posix.is_own(foreign)  # type: ignore[arg-type]


def test_users_have_names_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    assert posix.user_name()
    assert posix.user_name(4_000_000_001) == "uid 4000000001"
    monkeypatch.setattr(posix, "_pwd", None)
    monkeypatch.setenv("LOGNAME", "kim")
    assert posix.user_name() == "kim"

    def nobody() -> str:
        raise OSError("no user name")

    monkeypatch.setattr(posix.getpass, "getuser", nobody)
    assert posix.user_name() == "somebody"


def test_limits_and_signals_that_are_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert [number.name for number in posix.signals("SIGINT", "SIGNOTHING")] == ["SIGINT"]
    posix.sync_folder(tmp_path)
    monkeypatch.setattr(posix, "_resource", None)
    monkeypatch.setattr(posix, "_fcntl", None)
    monkeypatch.setattr(posix, "termios", None)
    monkeypatch.delattr(os, "nice")
    assert (posix.soft_limit("RLIMIT_NOFILE"), posix.spent_by_children_s()) == (None, 0.0)
    posix.give_way(1)
    posix.forget_typed(sys.stdin)
    posix.sync_folder(tmp_path / "none")
    with pytest.raises(OSError, match="no device"):
        posix.device_answer(0, 0, 4)
