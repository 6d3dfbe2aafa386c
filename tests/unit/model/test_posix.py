"""The one module that knows what is not there off POSIX: its equivalents, its refusal, and that nobody else does."""

from __future__ import annotations

import ast
import errno
import os
import re
import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.model import posix
from bench.model.errors import ExitStatus, InputError

TOP = Path(__file__).resolve().parents[3]
ALONE = TOP / "bench" / "model" / "posix.py"
MODULES = {"fcntl", "termios", "pwd", "grp", "resource", "pty", "tty", "syslog"}
NAMES = re.compile(
    r"\bos\.(?:fork|get(?:e?[ug]id)|nice|pread|pwrite|O_(?:CLOEXEC|NOFOLLOW|NONBLOCK|DIRECTORY|BINARY))\b|\bAF_UNIX\b"
    r"|\bopen_unix_connection\b"
)


def test_no_other_module_loads_or_names_what_is_posix() -> None:
    found = []
    for path in sorted(
        path for room in ("bench", "instruments", "sim_instruments") for path in (TOP / room).rglob("*.py")
    ):
        if path == ALONE:
            continue
        text = path.read_text(encoding="utf-8")
        found += [f"{path.name}: {name}" for name in NAMES.findall(text)]
        if any(name in text for name in MODULES):
            for node in ast.walk(ast.parse(text)):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                found += [f"{path.name}: {name}" for name in names if name.partition(".")[0] in MODULES]
    assert found == []


def test_this_system_lacks_nothing() -> None:
    assert posix.lacking() == ()
    posix.require("anything")


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
