"""Commands on a machine without POSIX, as far as Linux can play one: a program of its own, and the only honest way.

``off_posix.py WORDS...`` is ``bench WORDS...``; ``off_posix.py --all JSON`` runs a list of commands in one process and
prints ``[[status, stdout, stderr], ...]``. Modules that only POSIX systems have cannot be imported, and functions,
flags and signals that Windows lacks are gone, before anything of the bench is loaded. Packages that bring a part of
their own for Windows take their part for Linux, because the system underneath is Linux.
"""

import builtins
import contextlib
import io
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Sequence
from typing import Any

MODULES = {"fcntl", "termios", "pwd", "grp", "resource", "pty", "tty", "syslog"}
WITH_A_PART_FOR_WINDOWS = {"serial", "os", "tempfile", "textual"}
GONE: dict[Any, str] = {
    os: "fork forkpty openpty geteuid getuid getegid getgid setsid killpg nice pread pwrite fchmod chown ttyname "
    "mkfifo getloadavg sched_getaffinity sched_setaffinity setpriority O_CLOEXEC O_NOFOLLOW O_NONBLOCK O_DIRECTORY",
    signal: "SIGHUP SIGKILL SIGSTOP SIGCONT SIGQUIT SIGTSTP SIGALRM alarm pthread_sigmask sigtimedwait "
    "pidfd_send_signal",
    socket: "AF_UNIX SO_PEERCRED",
    select: "poll",
}
_import = builtins.__import__


def _guarded(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:  # noqa: A002
    who = str((globals or {}).get("__name__", "bench")).partition(".")[0]
    if level == 0 and name.partition(".")[0] in MODULES and who not in WITH_A_PART_FOR_WINDOWS:
        raise ImportError(f"there is no {name} on this system")
    return _import(name, globals, locals, fromlist, level)


def _pair(*_: int) -> tuple[socket.socket, socket.socket]:
    """Two sockets that are connected, as Windows makes them."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        one = socket.create_connection(listener.getsockname())
        return one, listener.accept()[0]


def leave_posix() -> None:
    """From here on this process has what Windows has."""
    builtins.__import__ = _guarded  # type: ignore[assignment]
    socket.socketpair = _pair  # type: ignore[assignment]
    for module, names in GONE.items():
        for name in names.split():
            if hasattr(module, name):
                delattr(module, name)


def statuses(commands: Sequence[Sequence[str]]) -> list[tuple[int, str, str]]:
    """Run commands and return what each said and how it ended."""
    from bench import cli

    done = []
    for words in commands:
        sys.argv = ["bench", *words]
        said, errors = io.StringIO(), io.StringIO()
        status = -1
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
            try:
                cli.main()
            except SystemExit as ended:
                status = int(ended.code or 0)
        done.append((status, said.getvalue(), errors.getvalue()))
    return done


if __name__ == "__main__":
    leave_posix()
    if sys.argv[1] == "--all":
        print(json.dumps(statuses(json.loads(sys.argv[2]))))
    else:
        from bench import cli

        cli.main()
