"""Unix sockets of a run for its owner and root alone: where they are, who connects, and one thread for all.

A server is bounded in everything, so that no client can hold it up: more than ``MOST_CLIENTS`` at once, and the oldest
is closed; one that asks for nothing for ``idle_s`` is closed too.
"""

from __future__ import annotations

import hashlib
import json
import os
import selectors
import socket
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from bench.model.clock import Clock, to_ns
from bench.model.posix import peer, unix_socket, user_id, user_name

CONTROL, LIVE = "control", "live"
LONGEST_PATH = 107
BACKLOG = 128  # clients that may wait to be accepted; more are turned away by the system
MOST_CLIENTS = 16
POLL_S = 0.25
LONGEST_LINE = 16384  # a reason of 500 letters of any script fits, twelve bytes each
IDLE_S = 5.0

Answer = Callable[[dict[str, Any], str], dict[str, Any]]
"""Takes a request and who asks; gives the reply. Must not wait."""


def socket_path(folder: Path, what: str = CONTROL) -> Path:
    """Return path for a socket of a session, short where it must be; writes ``control.path`` (``live.path``) then."""
    path = (folder / f"{what}.sock").resolve()
    if len(os.fsencode(path)) <= LONGEST_PATH:
        return path
    runtime = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()) / f"inertial-bench-{user_id()}"
    runtime.mkdir(mode=0o700, exist_ok=True)
    if runtime.stat().st_uid != user_id():
        raise PermissionError(f"{runtime} belongs to somebody else")
    path = runtime / f"{hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()[:16]}.{what}.sock"
    (folder / f"{what}.path").write_text(str(path), encoding="utf-8")
    return path


def find_socket(folder: Path, what: str = CONTROL) -> Path:
    """Return path of a socket of a session that may be running."""
    pointer = folder / f"{what}.path"
    return Path(pointer.read_text(encoding="utf-8")) if pointer.is_file() else folder.resolve() / f"{what}.sock"


def forget_socket(folder: Path, path: Path, what: str = CONTROL) -> None:
    """Nobody answers there any more."""
    path.unlink(missing_ok=True)
    (folder / f"{what}.path").unlink(missing_ok=True)


def listen(path: Path) -> socket.socket:
    """Return a socket that listens at a path, without waiting; what was left there is replaced. Raises: OSError."""
    listener = unix_socket()
    try:
        path.unlink(missing_ok=True)
        before = os.umask(0o177)
        try:
            listener.bind(str(path))
        finally:
            os.umask(before)
        listener.listen(BACKLOG)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def peer_of(connection: socket.socket) -> str | None:
    """Return name and process of who connected; None for another user, who is not heard (root is)."""
    there = peer(connection)
    if there is None or there[1] not in (user_id(), 0):
        return None
    return f"{user_name(there[1])} (process {there[0]})"


@dataclass(eq=False)
class Client:
    """A connected client: ``by`` whom, until when it may be silent, what came of it, what the selector looks for."""

    socket: socket.socket
    by: str
    until_ns: int
    received: bytearray = field(default_factory=bytearray)
    events: int = 0


C = TypeVar("C", bound=Client)


class LocalServer(Generic[C]):
    """Listens from the moment it is made until ``close``; a server says what a client is and what is done with it.

    Its thread starts at once: what a server needs is set before this is called. Raises: OSError if the socket cannot
    be made.
    """

    client: type[C]
    idle_s: ClassVar[float]

    def __init__(self, path: Path, clock: Clock, name: str) -> None:
        self._clock = clock
        self._clients: list[C] = []
        self._listener = listen(path)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._ended = threading.Event()
        self._woken, self._waker = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ, data=self._ended)
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer nobody any more."""
        self._ended.set()
        self._waker.send(b"\0")
        self._thread.join()
        for client in list(self._clients):
            self._drop(client)
        for opened in (self._listener, self._woken, self._waker):
            opened.close()
        self._selector.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            for key, events in self._selector.select(self._patience_s()):
                if key.data is None:
                    self._accept()
                elif key.data in self._clients:  # not dropped for a newer one in the same round
                    self._turn(key.data, events)
            now_ns = self._clock.now_ns()
            for client in list(self._clients):
                if now_ns > client.until_ns:
                    self._drop(client)
                else:
                    self._go_on(client, now_ns)

    def _patience_s(self) -> float:
        return POLL_S

    def _turn(self, client: C, events: int) -> None:
        """Do what the selector has found that a client can do."""
        raise NotImplementedError

    def _go_on(self, client: C, now_ns: int) -> None:
        """Do what is due for a client in each round."""

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # gone again; or no descriptor is left, and whoever waits there would be tried without end
            self._ended.wait(POLL_S)
            return
        by = peer_of(connection)
        if by is None:
            connection.close()
            return
        connection.setblocking(False)
        if len(self._clients) >= MOST_CLIENTS:
            self._drop(self._clients[0])
        client = self.client(connection, by, self._clock.now_ns() + to_ns(self.idle_s))
        self._clients.append(client)
        self._watch(client, selectors.EVENT_READ)

    def _watch(self, client: C, events: int) -> None:
        if events == client.events:
            return
        if not client.events:
            self._selector.register(client.socket, events, client)
        elif not events:
            self._selector.unregister(client.socket)
        else:
            self._selector.modify(client.socket, events, client)
        client.events = events

    def _drop(self, client: C) -> None:
        if client in self._clients:
            self._clients.remove(client)
        with suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.events = 0
        client.socket.close()


class ControlServer(LocalServer[Client]):
    """Listens from the moment it is made until ``close``. Raises: OSError if the socket cannot be made."""

    client = Client
    idle_s = IDLE_S

    def __init__(self, path: Path, answer: Answer, clock: Clock) -> None:
        self._answer = answer
        super().__init__(path, clock, "control")

    def _turn(self, client: Client, events: int) -> None:
        try:
            chunk = client.socket.recv(LONGEST_LINE)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            self._drop(client)
            return
        client.received += chunk
        while b"\n" in client.received:
            line, _, client.received = client.received.partition(b"\n")
            if not self._reply(client, line):
                return
        if len(client.received) > LONGEST_LINE:
            self._drop(client)

    def _reply(self, client: Client, line: bytearray) -> bool:
        client.until_ns = self._clock.now_ns() + to_ns(IDLE_S)
        reply = self._judged(line, client.by)
        try:
            sent = client.socket.send(json.dumps(reply).encode() + b"\n")
        except OSError:  # gone, or it does not read its replies
            sent = 0
        if not sent:
            self._drop(client)
        return bool(sent)

    def _judged(self, line: bytearray, by: str) -> dict[str, Any]:
        try:
            request = json.loads(line) if len(line) <= LONGEST_LINE else None
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict):
            return {"ok": False, "error": f"a request is one line of JSON, an object, at most {LONGEST_LINE} bytes"}
        try:
            return self._answer(request, by)
        except Exception as error:  # whatever a client asks, the run goes on
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}
