"""The feed of a run: a Unix socket that answers what the run does and its newest points (docs/live-protocol.md).

One thread answers all, out of memory of fixed size. Nobody is waited for: a client has one reply under way at a time
and is dropped when it does not read it, sends no whole line, or asks for nothing for ``idle_s``; one that asks more
often than each ``GAP_S`` waits. Nothing that goes wrong here reaches the run.
"""

from __future__ import annotations

import json
import selectors
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.model.clock import NS, WallClock, to_ns
from bench.record import canonical_json
from bench.run.control.local_socket import POLL_S, Client, LocalServer
from bench.run.feed.client import LENGTHS
from bench.run.feed.points import PointBatch

LONGEST_LINE = 4096
GAP_S = 0.05
STATE_S = 0.1  # a state document serves everybody for that long


@dataclass(eq=False)
class _Client(Client):
    """Beside: when it may be answered next, and what of the last reply is not sent yet."""

    next_ns: int = 0
    out: memoryview = field(default_factory=lambda: memoryview(b""))


class FeedServer(LocalServer[_Client]):
    """Answers from the moment it is made until ``close``. Real time counts here, whatever the clock of the run.

    Args: head: what every reply says (proto, boot_id, signals).   state: the state document.
          points: complete points from a number on. Both are called on the thread of the server and must not wait.
    Raises: OSError if the socket cannot be made.
    """

    client = _Client
    idle_s = 10.0

    def __init__(
        self,
        path: Path,
        head: dict[str, Any],
        state: Callable[[], dict[str, Any]],
        points: Callable[[int], PointBatch],
    ) -> None:
        self._head, self._state, self._points = head, state, points
        self._newest_state: tuple[int, bytes] = (-1, b"")
        super().__init__(path, WallClock(), "feed")

    def _patience_s(self) -> float:
        """Until the next client that has to wait may be answered."""
        resting = [client.next_ns for client in self._clients if not client.out and b"\n" in client.received]
        now_ns = self._clock.now_ns()
        return min(POLL_S, max(0.001, (min(resting, default=now_ns + NS) - now_ns) / NS))

    def _turn(self, client: _Client, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                self._hear(client)
            if client in self._clients and events & selectors.EVENT_WRITE:
                self._send(client)
        except OSError:
            self._drop(client)

    def _hear(self, client: _Client) -> None:
        with suppress(BlockingIOError):
            chunk = client.socket.recv(LONGEST_LINE)
            if not chunk:
                self._drop(client)
                return
            client.received += chunk
        if b"\n" not in client.received and len(client.received) > LONGEST_LINE:
            self._drop(client)

    def _go_on(self, client: _Client, now_ns: int) -> None:
        """Answer the next request of a client, if its last reply is gone and it is its turn."""
        if client.out:
            self._watch(client, selectors.EVENT_WRITE)
        elif b"\n" not in client.received:
            self._watch(client, selectors.EVENT_READ)
        elif now_ns < client.next_ns:
            self._watch(client, 0)
        else:
            line, _, rest = bytes(client.received).partition(b"\n")
            client.received = bytearray(rest)
            client.next_ns, client.until_ns = now_ns + to_ns(GAP_S), now_ns + to_ns(self.idle_s)
            reply = self._reply(line, now_ns)
            if reply is None:
                self._drop(client)
                return
            client.out = memoryview(reply)
            try:
                self._send(client)
            except OSError:
                self._drop(client)

    def _send(self, client: _Client) -> None:
        with suppress(BlockingIOError):
            client.out = client.out[client.socket.send(client.out) :]
        if client in self._clients:
            self._watch(client, selectors.EVENT_WRITE if client.out else selectors.EVENT_READ)

    def _reply(self, line: bytes, now_ns: int) -> bytes | None:
        """Return the reply to one request; None for one that is not understood, or that cannot be answered."""
        try:
            request = json.loads(line)
            since, with_state = request.get("since", 0), request.get("state", False)
            if type(since) is not int or type(with_state) is not bool:
                return None
            points = self._points(since)
            header = canonical_json({**self._head, "seq": points.seq, "first": points.first, "n": points.n})
            if with_state:
                header = header[:-1] + b',"state":' + self._state_bytes(now_ns) + b"}"
        except Exception:  # whatever a client asks and whatever state the run is in: the run goes on
            return None
        return LENGTHS.pack(len(header), len(points.packed)) + header + points.packed

    def _state_bytes(self, now_ns: int) -> bytes:
        made_ns, state = self._newest_state
        if made_ns < 0 or now_ns - made_ns > to_ns(STATE_S):
            state = canonical_json(self._state())
            self._newest_state = (now_ns, state)
        return state
