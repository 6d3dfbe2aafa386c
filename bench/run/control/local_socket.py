"""Unix sockets of a run for its owner and root alone: where they are, who connects, and one thread for all.

A server is bounded in everything, so that no client can hold it up. Nobody is waited for: a client has one reply under
way at a time, and no more is read of it before every line that it has sent is answered; one that asks more often than
each ``gap_s`` waits. Whoever ends no line within ``longest`` bytes, does not read a reply or asks for nothing for
``idle_s`` is closed; of more than ``MOST_CLIENTS`` at once the oldest is.
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
from typing import Any, ClassVar

from bench.model.clock import NS, Clock, to_ns
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
    """A connected client: ``by`` whom, until when it may be silent, what came of it, what the selector looks for.

    ``next_ns``: when it may be answered next.   ``out``: what of the last reply is not sent yet.
    """

    socket: socket.socket
    by: str
    until_ns: int
    received: bytearray = field(default_factory=bytearray)
    events: int = 0
    next_ns: int = 0
    out: memoryview = field(default_factory=lambda: memoryview(b""))


class LocalServer:
    """Listens from the moment it is made until ``close``; a server says what it replies to a line.

    Its thread starts at once: what a server needs is set before this is called. Raises: OSError if the socket cannot
    be made.
    """

    longest: ClassVar[int]
    idle_s: ClassVar[float]
    gap_s: ClassVar[float]

    def __init__(self, path: Path, clock: Clock, name: str) -> None:
        self._clock = clock
        self._clients: list[Client] = []
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

    def _reply(self, line: bytearray, by: str) -> bytes | None:
        """Return the reply to one line; None to close the connection. It must not wait."""
        raise NotImplementedError

    def _patience_s(self) -> float:
        """Until the next client that has to wait may be answered."""
        resting = [client.next_ns for client in self._clients if not client.out and b"\n" in client.received]
        now_ns = self._clock.now_ns()
        return min(POLL_S, max(0.001, (min(resting, default=now_ns + NS) - now_ns) / NS))

    def _turn(self, client: Client, events: int) -> None:
        """Do what the selector has found that a client can do: take what it sends, or send on."""
        try:
            if events & selectors.EVENT_WRITE:
                client.out = client.out[client.socket.send(client.out) :]
                return
            chunk = client.socket.recv(self.longest)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        client.received += chunk
        if not chunk or (b"\n" not in client.received and len(client.received) > self.longest):
            self._drop(client)

    def _go_on(self, client: Client, now_ns: int) -> None:
        """Answer the next line of a client, if its last reply is gone and it is its turn."""
        if not client.out and b"\n" in client.received and now_ns >= client.next_ns:
            line, _, client.received = client.received.partition(b"\n")
            client.next_ns, client.until_ns = now_ns + to_ns(self.gap_s), now_ns + to_ns(self.idle_s)
            reply = self._reply(line, client.by)
            if reply is None:
                self._drop(client)
                return
            client.out = memoryview(reply)
            self._turn(client, selectors.EVENT_WRITE)
        if client in self._clients:
            is_waiting = 0 if b"\n" in client.received else selectors.EVENT_READ
            self._watch(client, selectors.EVENT_WRITE if client.out else is_waiting)

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
        client = Client(connection, by, self._clock.now_ns() + to_ns(self.idle_s))
        self._clients.append(client)
        self._watch(client, selectors.EVENT_READ)

    def _watch(self, client: Client, events: int) -> None:
        if events == client.events:
            return
        if not client.events:
            self._selector.register(client.socket, events, client)
        elif not events:
            self._selector.unregister(client.socket)
        else:
            self._selector.modify(client.socket, events, client)
        client.events = events

    def _drop(self, client: Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
        with suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.events = 0
        client.socket.close()


class ControlServer(LocalServer):
    """Listens from the moment it is made until ``close``. Raises: OSError if the socket cannot be made."""

    longest = LONGEST_LINE
    idle_s = IDLE_S
    gap_s = 0.0

    def __init__(self, path: Path, answer: Answer, clock: Clock) -> None:
        self._answer = answer
        super().__init__(path, clock, "control")

    def _reply(self, line: bytearray, by: str) -> bytes:
        return json.dumps(self._judged(line, by)).encode() + b"\n"

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
