"""A Unix socket that answers lines of JSON: one thread, bounded in everything, so that no client can hold it up.

A connection may send requests of one line each, at most ``LONGEST_LINE`` bytes, and is closed after ``IDLE_S`` without
a whole line. More than ``MOST_CLIENTS`` at once: the oldest is closed. Only the owner of the run and root are heard.
"""

from __future__ import annotations

import json
import selectors
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.clock import NS, Clock
from bench.run.control.local_socket import listen, peer_of

LONGEST_LINE = 16384  # a reason of 500 letters of any script fits, twelve bytes each
MOST_CLIENTS = 16
IDLE_S = 5.0
POLL_S = 0.25

Answer = Callable[[dict[str, Any], str], dict[str, Any]]
"""Takes a request and who asks; gives the reply. Must not wait."""


@dataclass(eq=False)
class _Client:
    socket: socket.socket
    by: str
    until_ns: int
    received: bytes = b""


class ControlServer:
    """Listens from the moment it is made until ``close``. Raises: OSError if the socket cannot be made."""

    def __init__(self, path: Path, answer: Answer, clock: Clock) -> None:
        self._answer = answer
        self._clock = clock
        self._clients: list[_Client] = []
        self._listener = listen(path)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="control", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer nobody any more."""
        self._ended.set()
        self._thread.join()
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()
        self._selector.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            for key, _ in self._selector.select(POLL_S):
                if key.data is None:
                    self._accept()
                else:
                    self._hear(key.data)
            now_ns = self._clock.now_ns()
            for client in [one for one in self._clients if now_ns > one.until_ns]:
                self._drop(client)

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
        client = _Client(connection, by, self._clock.now_ns() + round(IDLE_S * NS))
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)

    def _hear(self, client: _Client) -> None:
        if client not in self._clients:
            return  # dropped for a newer one in the same round
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

    def _reply(self, client: _Client, line: bytes) -> bool:
        client.until_ns = self._clock.now_ns() + round(IDLE_S * NS)
        reply = self._judged(line, client.by)
        try:
            sent = client.socket.send(json.dumps(reply).encode() + b"\n")
        except OSError:  # gone, or it does not read its replies
            sent = 0
        if not sent:
            self._drop(client)
        return bool(sent)

    def _judged(self, line: bytes, by: str) -> dict[str, Any]:
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

    def _drop(self, client: _Client) -> None:
        self._clients.remove(client)
        with suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.socket.close()
