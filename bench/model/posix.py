"""What only POSIX systems have, in one place: a portable equivalent where one does no harm, else one clear refusal.

No other module loads ``fcntl``, ``termios``, ``pwd`` or ``resource``, or names Unix sockets, owners or flags of one
system (tests/house). What is left out elsewhere costs convenience: a lower priority, the owner of a file, the name of
a file on the disk after a loss of power. What a bench must not do without asks ``require``
(docs/decisions/0035-minimal-install.md).

Behind it the bench's own processes: every module that is started by its name. They are processes of their own so that a
run cannot die of them, or so that they outlive it. None takes a module from the folder it happens to be started in
(``-P``).
"""

from __future__ import annotations

import errno
import getpass
import os
import signal
import socket
import stat
import struct
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

from bench.model.errors import InputError

if TYPE_CHECKING:
    from asyncio import StreamReader, StreamWriter


def _there(name: str) -> Any:
    """Return a module of the standard library that some systems lack, None on those."""
    try:
        return __import__(name)
    except ImportError:
        return None


_fcntl, _pwd, _resource = _there("fcntl"), _there("pwd"), _there("resource")
termios = _there("termios")  # None where terminals have no modes
_msvcrt = _there("msvcrt")
_LOCKED_AT = 1 << 30  # Windows keeps others from reading a byte that is locked: one behind any journal
_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK, 36)  # 36: EDEADLOCK of the C library of Windows
_PEER = struct.Struct("3i")  # unix(7): process, user, group
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH

RAW = getattr(os, "O_BINARY", 0)
"""Flag of ``os.open``: bytes are written as they are; only Windows writes others without it."""
ALONE = RAW | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOINHERIT", 0)
"""Flags of ``os.open``: as ``RAW``, and no process that is started later has the file open."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of ``os.open``: a symbolic link is no file."""
AT_ONCE = getattr(os, "O_NONBLOCK", 0)
"""Flag of ``os.open``: a pipe is not waited for."""
NOT_OURS = getattr(os, "O_NOCTTY", 0)
"""Flag of ``os.open``: a terminal does not become that of a process that leads a session."""


def lacking() -> tuple[str, ...]:
    """Return what a bench in real time needs and this system does not have; nothing on Linux."""
    there = {
        "fcntl": _fcntl,
        "termios": termios,
        "pwd": _pwd,
        "os.fork": getattr(os, "fork", None),
        "os.geteuid": getattr(os, "geteuid", None),
        "SIGSTOP": getattr(signal, "SIGSTOP", None),
        "AF_UNIX": getattr(socket, "AF_UNIX", None),
        "SO_PEERCRED": getattr(socket, "SO_PEERCRED", None),
    }
    return tuple(name for name, part in there.items() if part is None)


def require(what: str, instead: str = "rehearse with --clock virtual, or run on Linux") -> None:
    """Refuse what needs POSIX where it is not there. Raises: InputError B-SYS-001."""
    missing = lacking()
    if missing:
        message = f"{what} needs Linux; this system has no {', '.join(missing)}"
        raise InputError("B-SYS-001", message, where="system", next_step=instead)


def lock_file(descriptor: int) -> None:
    """Lock an open file for this descriptor alone until it is closed or its process ends.

    Raises: BlockingIOError if somebody else holds it; OSError. A system without any lock locks nothing.
    """
    if _fcntl is not None:
        _fcntl.flock(descriptor, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
    elif _msvcrt is not None:
        os.lseek(descriptor, _LOCKED_AT, os.SEEK_SET)
        try:
            _msvcrt.locking(descriptor, _msvcrt.LK_NBLCK, 1)
        except OSError as error:
            if error.errno in _TAKEN:
                raise BlockingIOError(errno.EAGAIN, "another process holds the lock") from error
            raise


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable; Windows opens no folder, and writes names by itself. Raises: OSError."""
    if _fcntl is None:
        return
    descriptor = os.open(folder, os.O_RDONLY | ALONE)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_at(descriptor: int, count: int, at: int) -> bytes:
    """Return up to ``count`` bytes from a place in a file. Raises: OSError."""
    if hasattr(os, "pread"):
        return os.pread(descriptor, count, at)
    os.lseek(descriptor, at, os.SEEK_SET)
    return os.read(descriptor, count)


def write_at(descriptor: int, content: bytes | memoryview, at: int) -> int:
    """Write at a place in a file; returns how many bytes. Raises: OSError."""
    if hasattr(os, "pwrite"):
        return os.pwrite(descriptor, content, at)
    os.lseek(descriptor, at, os.SEEK_SET)
    return os.write(descriptor, content)


def is_own(status: os.stat_result, others: int = _OTHERS_WRITE, *, or_of_root: bool = False) -> bool:
    """Return whether a file belongs to this user, and others have none of the rights ``others``.

    True where files have no owner in this sense: the folder of a user on Windows is closed by its access list.
    """
    if not hasattr(os, "geteuid"):
        return True
    owners = (os.geteuid(), 0) if or_of_root else (os.geteuid(),)
    return status.st_uid in owners and not status.st_mode & others


def has_owners() -> bool:
    """Return whether files have owners and rights in the sense of POSIX."""
    return hasattr(os, "geteuid")


def distrust(status: os.stat_result, *, shared: bool = False) -> str:
    """Return why somebody else may have changed a file or folder, as a predicate; "" if only this user or root may.

    ``shared``: a folder may be everybody's (``/tmp``) if its sticky bit keeps others from what is not theirs in it.
    The group counts as others. Source: unlink(2), EPERM, for what the sticky bit keeps.
    """
    if not is_own(status, 0, or_of_root=True):
        return f"belongs to {user_name(status.st_uid)}, neither to you nor to root"
    if is_own(status, or_of_root=True) or (shared and status.st_mode & stat.S_ISVTX):
        return ""
    return "can be written to by others"


def user_id() -> int:
    """Return the number of this user; 0 where users have none."""
    return os.getuid() if hasattr(os, "getuid") else 0


def user_name(number: int | None = None) -> str:
    """Return the name of a user, of this one without a number; a container may run under a number without a name."""
    if _pwd is None:
        try:
            return getpass.getuser()
        except (ImportError, OSError, KeyError):  # no variable of the environment says it
            return "somebody"
    number = os.getuid() if number is None else number
    try:
        return str(_pwd.getpwuid(number).pw_name)
    except KeyError:
        return f"uid {number}"


def give_way(nice: int) -> None:
    """Let other processes go first, where priorities can be lowered."""
    if hasattr(os, "nice"):
        os.nice(nice)


def spent_by_children_s() -> float:
    """Return processor time of the processes that have ended, s; 0 where nobody counts it."""
    if _resource is None:
        return 0.0
    used = _resource.getrusage(_resource.RUSAGE_CHILDREN)
    return float(used.ru_utime + used.ru_stime)


def soft_limit(kind: Literal["RLIMIT_NOFILE", "RLIMIT_FSIZE"]) -> int | None:
    """Return a limit of this process; None: no limit, or a system that has none of this kind."""
    if _resource is None:
        return None
    soft, _ = _resource.getrlimit(getattr(_resource, kind))
    return None if soft == _resource.RLIM_INFINITY else int(soft)


def forget_typed(terminal: TextIO) -> None:
    """Drop what was typed at a terminal and not read yet; nothing happens at what is none."""
    if termios is not None:
        try:
            termios.tcflush(terminal, termios.TCIFLUSH)
        except termios.error:
            return


def make_raw(descriptor: int) -> None:
    """Let a terminal hand on bytes as they are, at once."""
    _there("tty").setraw(descriptor, termios.TCSANOW)


def device_answer(descriptor: int, request: int, size: int) -> bytes:
    """Return what a device answers to an ioctl, ``size`` bytes. Raises: OSError."""
    if _fcntl is None:
        raise OSError(errno.ENOTTY, "no device is asked on this system")
    answer: bytes = _fcntl.ioctl(descriptor, request, bytes(size))
    return answer


def signals(*names: str) -> tuple[signal.Signals, ...]:
    """Return those of some signals that this system has."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


def unix_socket(kind: int = socket.SOCK_STREAM) -> socket.socket:
    """Return a socket of this machine. Raises: OSError where there are none: no run in real time is alive there."""
    return socket.socket(_unix_family(), kind)


def peer(connection: socket.socket) -> tuple[int, int] | None:
    """Return process and user at the other end of a Unix socket; None where nobody says it."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return None
    try:
        pid, uid, _ = _PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, option, _PEER.size))
    except OSError:
        return None
    return pid, uid


async def unix_connection(path: Path, limit: int) -> tuple[StreamReader, StreamWriter]:
    """Connect to a socket of this machine, as ``asyncio.open_unix_connection``. Raises: OSError."""
    import asyncio  # of the page alone

    _unix_family()
    return await asyncio.open_unix_connection(path, limit=limit)


def _unix_family() -> int:
    family: int | None = getattr(socket, "AF_UNIX", None)
    if family is None:
        raise OSError(errno.EAFNOSUPPORT, "this system has no Unix sockets")
    return family


GUARD = "bench.run.guard"  # makes the bench safe when its controller is gone
NOTICE = "bench.run.guard.notice"  # tells people what the guard did
DRILL_CONTROLLER = "bench.run.guard.drill_controller"  # is killed under stimulus by ``bench drill``
EARLY_VERDICT = "bench.session.early"  # judges a session that is still being recorded
PARTIAL_RESULTS = "bench.session.partial"  # fits a session that is still being recorded, for the page
TREND = "bench.replay.build_trend"  # builds the trend file of a session that has none
STARTED = (GUARD, NOTICE, DRILL_CONTROLLER, EARLY_VERDICT, PARTIAL_RESULTS, TREND)

APPRISE = (sys.executable, "-P", "-c", "import sys; from apprise.cli import main; sys.exit(main())")
"""The program of the extra ``messages``, which is no module of ours."""


def own_process(module: str, *words: str) -> list[str]:
    """Return the command that starts one of the modules in ``STARTED`` with its arguments."""
    return [sys.executable, "-P", "-m", module, *words]
