"""Raw sockets, as SCPI instruments offer them: a TCP port per instrument, lines in, lines out.

There is no END, no serial poll and no device clear; commands are carried out in order, each after the reply to the one
before has been sent. A late reply cannot be told apart from the answer to the next question: that is the nature of a
raw socket.
"""

from __future__ import annotations

import select
import socket
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from sim_instruments.served.hislip_exchange import Exchange, ServedInstrument
from sim_instruments.served.hislip_wire import receive_now, send_all, shut

MOST_CONNECTIONS = 64
MOST_LINES = 256  # commands taken in advance; more stay in the connection
LONGEST_LINE_BYTES = 1 << 20
WAIT_MS = 5
_NEAR_NS = 5_000_000
_JOIN_LIMIT_S = 5.0


class _Connection:
    """One client of one instrument, until it goes or ``stop`` is called."""

    def __init__(self, instrument: ServedInstrument, sock: socket.socket) -> None:
        self._instrument, self._sock = instrument, sock
        self._exchange = Exchange(instrument)
        self._begun = b""
        self._ended = False  # the client sends no more; what it sent is still answered
        self._lines: deque[bytes] = deque()
        self._stopping = threading.Event()

    def run(self) -> None:
        try:
            while self._serve():
                pass
        except OSError:
            pass
        finally:
            self._sock.close()

    def stop(self) -> None:
        self._stopping.set()
        shut(self._sock)

    def _serve(self) -> bool:
        self._wait()
        if not self._ended and len(self._lines) < MOST_LINES:
            self._take()
        if not self._instrument.hung:
            self._send_due()
            if self._lines and self._exchange.due_ns() is None and not self._instrument.locks.shut_out(self):
                self._exchange.command(self._lines.popleft(), 0)
        busy = bool(self._lines) or self._exchange.due_ns() is not None
        return (busy or not self._ended) and not self._stopping.is_set()

    def _wait(self) -> None:
        """Until a command arrives, the next reply is due, or the next look at the locks."""
        due_ns = self._exchange.due_ns()
        clock = self._instrument.world.clock
        blocked = self._instrument.hung or self._instrument.locks.shut_out(self)
        if due_ns is not None and not blocked and due_ns - clock.now_ns() <= _NEAR_NS:
            clock.sleep_until_ns(due_ns)
        elif due_ns is None and self._lines and not blocked:
            return
        elif self._ended or len(self._lines) >= MOST_LINES:
            self._stopping.wait(WAIT_MS / 1000)
        else:
            arriving = select.poll()
            arriving.register(self._sock, select.POLLIN)
            arriving.poll(None if due_ns is None and not self._lines else WAIT_MS)

    def _take(self) -> None:
        chunk = receive_now(self._sock)
        if chunk is None:
            return
        *lines, self._begun = (self._begun + chunk).split(b"\n")
        if not self._instrument.hung:
            self._lines.extend(lines)
        self._ended = not chunk or len(self._begun) > LONGEST_LINE_BYTES

    def _send_due(self) -> None:
        while (due := self._exchange.take_due()) is not None:
            send_all(self._sock, due[0].payload)
            self._exchange.confirm()


class Client(Protocol):
    """A client that a server serves on a thread of its own."""

    def run(self) -> None:
        """Serve it; returns when it is gone."""

    def stop(self) -> None:
        """End it, from any thread."""


class LoopbackServer:
    """Takes connections on a thread of its own, by ``_run``, until ``close``. Args: listeners: what it listens at."""

    def __init__(self, name: str, listeners: Iterable[socket.socket]) -> None:
        self._listeners = tuple(listeners)
        self._clients: dict[Client, threading.Thread] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End every client and the server; idempotent. No thread, port or connection is left."""
        if self._closing:
            return
        self._closing = True
        for listener in self._listeners:
            shut(listener)
        self._thread.join(_JOIN_LIMIT_S)
        for client, thread in self._clients.items():
            client.stop()
            thread.join(_JOIN_LIMIT_S)
        self._clients.clear()

    def _alive(self) -> int:
        """Return how many clients there are; those that are gone are forgotten."""
        self._clients = {client: thread for client, thread in self._clients.items() if thread.is_alive()}
        return len(self._clients)

    def _serve(self, client: Client, name: str) -> None:
        thread = self._clients[client] = threading.Thread(target=client.run, name=name, daemon=True)
        thread.start()

    def _run(self) -> None:
        raise NotImplementedError


class SocketServer(LoopbackServer):
    """Serves each instrument on a port of its own until ``close``.

    Args: instruments: in the order of ``ports``.   host: a loopback address.   ports: by role; others take a free one.
    Raises: OSError if a port is taken.
    """

    def __init__(self, instruments: Sequence[ServedInstrument], host: str, ports: Mapping[str, int]) -> None:
        self._behind = {
            socket.create_server((host, ports.get(instrument.device.role, 0))): instrument for instrument in instruments
        }
        self.ports: tuple[int, ...] = tuple(listener.getsockname()[1] for listener in self._behind)
        super().__init__("raw sockets", self._behind)

    def _run(self) -> None:
        calls = select.poll()
        by_number = {listener.fileno(): listener for listener in self._listeners}
        for listener in self._listeners:
            listener.setblocking(False)
            calls.register(listener, select.POLLIN)
        while not self._closing:
            for number, _ in calls.poll():
                self._accept(by_number[number])
        for listener in self._listeners:
            listener.close()

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, _ = listener.accept()
        except OSError:  # the caller is gone again, or the server is being closed
            return
        if self._alive() >= MOST_CONNECTIONS:
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        instrument = self._behind[listener]
        self._serve(_Connection(instrument, sock), f"raw socket {instrument.device.role}")
