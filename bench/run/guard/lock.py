"""One controller at a time: a lock per bus or instrument, held with ``flock`` and naming its holder.

The kernel frees the lock with the process that holds it, however that ends; the files stay and mean nothing. They lie
where every user of the machine can reach them. A serial port is locked by its own opening.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.model.clock import Clock, to_ns, utc_moment
from bench.model.errors import InputError, unknown_form
from bench.model.posix import ALONE, NO_LINK, lock_file, read_at, require, user_name, write_at
from bench.model.quantities import Values
from bench.run.bus.side_by_side import bus_of
from bench.run.guard.take_over import ask_to_let_go

GUARD_PATIENCE_S = 90.0  # how long a controller waits for a guard that is making the bench safe
UNNAMED_PATIENCE_S = 10.0
_SETTLE_S = 0.2  # a holder that has just taken the lock writes its name within this time
_POLL_S = 0.02
GUARD = "guard"
_SHARED, _COMMON = Path("/run/lock"), Path("/tmp")
_NAME_BYTES = 4096
_OF_A_CONTROLLER = "let it end, or stop it there ('bench abort SESSION'); then start again"
_OF_A_GUARD = (
    "it tries until everything is confirmed off (guard.jsonl of its session says what is not); whoever is at the bench "
    "takes it over by 'bench resume|drill|talk --take-over'"
)


def bus_keys(resources: Iterable[str]) -> tuple[str, ...]:
    """Return what must be locked to use these VISA addresses: a GPIB board as a whole, anything else by its address."""
    return tuple(sorted({bus_of(resource) for resource in resources}))


def bench_lock(resources: Iterable[str], what: str, clock: Clock, *, take_over: bool = False) -> BenchLock:
    """Return the lock of a controller on these VISA addresses; it waits for a guard that is making the bench safe."""
    return BenchLock(bus_keys(resources), what, clock, patience_s=GUARD_PATIENCE_S, take_over=take_over)


def lock_folder() -> Path:
    """Return the folder of lock files of this machine: one for every user, whatever one of them may write to."""
    try:
        return _SHARED if _SHARED.stat().st_mode & stat.S_IWOTH else _COMMON
    except OSError:
        return _COMMON


class BenchLock:
    """The right to use some instruments; context manager.

    Args:
        keys: of ``bus_keys``.   what: "run", "talk", "drill", "guard" ...
        patience_s: how long to wait for a guard that is making the bench safe; nobody else is waited for.
        take_over: a guard that is still at it is asked to let the bench go.
    Raises: InputError B-RUN-092 if somebody else holds one of the keys, naming the holder; B-RUN-093 if a lock file
            cannot be opened.
    """

    def __init__(
        self, keys: Iterable[str], what: str, clock: Clock, *, folder: Path | None = None, patience_s: float = 0.0,
        take_over: bool = False,
    ) -> None:  # fmt: skip
        self._keys = tuple(keys)
        self._clock = clock
        self._folder = lock_folder() if folder is None else folder
        self._patience_s, self._take_over = patience_s, take_over
        self._held: list[int] = []
        since = utc_moment(clock.utc_ns()).isoformat()
        who = {"pid": os.getpid(), "host": socket.gethostname(), "user": user_name()}
        self._holder: dict[str, Any] = {"v": 1, **who, "what": what, "since": since}

    def __enter__(self) -> BenchLock:
        self.take()
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def take(self) -> None:
        """Take every key, in one order everywhere, or none. Raises: InputError B-SYS-001 where nothing would lock."""
        if self._keys:
            require("a bench of instruments")
        begun_ns = self._clock.now_ns()
        while True:
            taken = self.attempt()
            if taken is None:
                return
            key, holder = taken
            if self._take_over and holder.get("what") == GUARD:
                self._take_over = False
                ask_to_let_go(holder)
            if self._clock.now_ns() >= begun_ns + to_ns(self._patience_with(holder)):
                raise InputError(
                    "B-RUN-092",
                    f"the bench is in use by {_named(holder)}",
                    where=key,
                    next_step=_OF_A_GUARD if holder.get("what") == GUARD else _OF_A_CONTROLLER,
                )
            self._clock.sleep(_POLL_S)

    def _patience_with(self, holder: Values) -> float:
        """Return seconds; one that has not named itself yet may be a guard that the machine gives no time."""
        if not holder:
            return min(self._patience_s, UNNAMED_PATIENCE_S)
        return self._patience_s if holder.get("what") == GUARD else 0.0

    @property
    def held(self) -> bool:
        """Whether every key is held."""
        return len(self._held) == len(self._keys)

    def name_session(self, session: str, folder: Path | None = None) -> None:
        """Let the lock name the session of its holder, and where that can be asked to let go."""
        self._holder |= {"session": session} if folder is None else {"session": session, "folder": str(folder)}
        for descriptor in self._held:
            self._sign(descriptor)

    def release(self) -> None:
        """Give every key back; idempotent."""
        for descriptor in self._held:
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
            os.close(descriptor)
        self._held.clear()

    def attempt(self) -> tuple[str, Values] | None:
        """Take all keys; otherwise none, and the key that somebody else holds is returned with its holder."""
        for key in self._keys:
            descriptor = self._open(key)
            try:
                lock_file(descriptor)
            except BlockingIOError:
                holder = self._read_holder(descriptor)
                os.close(descriptor)
                self.release()
                return key, holder
            self._held.append(descriptor)
            self._sign(descriptor)
        return None

    def _open(self, key: str) -> int:
        """Without O_CREAT first: kernels may forbid it for a file of another user in a folder that all share."""
        path = self._folder / f"bench-{hashlib.sha256(key.encode()).hexdigest()[:16]}.lock"
        flags = os.O_RDWR | ALONE | NO_LINK
        try:
            with suppress(FileNotFoundError):
                return os.open(path, flags)
            with suppress(FileExistsError):
                descriptor = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
                os.fchmod(descriptor, 0o666)  # whatever the umask: the next user must be able to open it
                return descriptor
            return os.open(path, flags)
        except OSError as error:
            raise InputError(
                "B-RUN-093",
                f"the lock of {key} cannot be opened: {error.strerror}",
                where=str(path),
                next_step="remove the file if nobody uses the bench, or correct its permissions",
            ) from error

    def _sign(self, descriptor: int) -> None:
        text = json.dumps(self._holder).encode()
        with suppress(OSError):  # a full disk: the lock itself needs no room
            os.ftruncate(descriptor, 0)
            write_at(descriptor, text, 0)

    def _read_holder(self, descriptor: int) -> Values:
        """Return who holds the lock; waits a moment for one that has just taken it."""
        end_ns = self._clock.now_ns() + to_ns(_SETTLE_S)
        while True:
            with suppress(ValueError, OSError):
                holder: dict[str, Any] = json.loads(read_at(descriptor, _NAME_BYTES, 0))
                if why := unknown_form(holder):
                    return {"form": why}
                if holder.get("host") != self._holder["host"] or _lives(int(holder["pid"])):
                    return holder
            if self._clock.now_ns() >= end_ns:
                return {}
            self._clock.sleep(_POLL_S)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _named(holder: Values) -> str:
    if not holder:
        return "another process that has not named itself"
    if "form" in holder:
        return f"another process, whose lock is {holder['form']}"
    session = f", session {holder['session']}" if "session" in holder else ""
    who = f"'{holder['what']}' of {holder['user']}@{holder['host']}"
    return f"{who}, pid {holder['pid']}, since {holder['since']}{session}"
