"""A Unix socket that answers lines of JSON at once.

A connection may send requests of one line each, at most ``LONGEST_LINE`` bytes, and is closed after ``IDLE_S`` without
a whole line.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.model.clock import NS, Clock
from bench.run.control.local_socket import Client, LocalServer

LONGEST_LINE = 16384  # a reason of 500 letters of any script fits, twelve bytes each
IDLE_S = 5.0

Answer = Callable[[dict[str, Any], str], dict[str, Any]]
"""Takes a request and who asks; gives the reply. Must not wait."""


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
        client.until_ns = self._clock.now_ns() + round(IDLE_S * NS)
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
