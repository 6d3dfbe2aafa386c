"""Raw sockets, as SCPI instruments offer them: a TCP port per instrument, lines in, lines out; and a GPIB adapter.

There is no END, no serial poll and no device clear; commands are carried out in order, each after the reply to the one
before has been sent. A late reply cannot be told apart from the answer to the next question: that is the nature of a
raw socket.
"""

from __future__ import annotations

import re
import select
import socket
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Protocol

from bench.model.clock import Clock, to_ns
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


_ADAPTER_LINE = re.compile(rb"((?:\x1b.|[^\x1b\r\n])*)[\r\n]", re.DOTALL)
_EOS = {"0": b"\r\n", "1": b"\r", "2": b"\n", "3": b""}
VERSION = "Prologix GPIB-ETHERNET Controller version 01.06.06.00"


class _Adapter:
    """A Prologix GPIB-ETHERNET with its client: lines that begin with "++" are its own, others the instrument's.

    Source: Prologix GPIB-USB Controller User Manual, 2011, 7 and 8 (the commands are those of both models).
    """

    def __init__(self, exchanges: Mapping[str, Exchange], clock: Clock, sock: socket.socket) -> None:
        self._exchanges, self._clock, self._sock = exchanges, clock, sock
        self._settings = {"addr": "0", "auto": "1", "eos": "0", "read_tmo_ms": "1000"}
        self._stopping = threading.Event()

    def run(self) -> None:
        begun = b""
        with self._sock, suppress(OSError):
            while not self._stopping.is_set() and (chunk := self._sock.recv(4096)):
                begun += chunk
                while (line := _ADAPTER_LINE.match(begun)) and not self._stopping.is_set():
                    begun = begun[line.end() :]
                    self._take(line[1])

    def stop(self) -> None:
        self._stopping.set()
        shut(self._sock)

    def _take(self, line: bytes) -> None:
        if line.startswith(b"++"):
            word, *values = line[2:].decode("latin-1").split() or [""]
            self._obey(word, values)
        elif line and (listener := self._exchanges.get(self._settings["addr"])) is not None:
            message = re.sub(rb"\x1b(.)", rb"\1", line, flags=re.DOTALL) + _EOS[self._settings["eos"]]
            listener.command(message, 0)
            if self._settings["auto"] == "1":
                self._read()

    def _obey(self, word: str, values: list[str]) -> None:
        addressed = self._exchanges.get(values[0] if word == "spoll" and values else self._settings["addr"])
        if word == "read":
            self._read()
        elif word == "ver":
            self._say(VERSION)
        elif word == "spoll":
            self._say(str(0 if addressed is None else addressed.status_byte()))
        elif word == "clr" and addressed is not None:
            addressed.clear()
        elif values:
            self._settings[word] = values[0]
        elif word in self._settings:
            self._say(self._settings[word])

    def _read(self) -> None:
        """Pass on what the addressed instrument says within the time; nothing, if it says nothing."""
        talker = self._exchanges.get(self._settings["addr"])
        end_ns = self._clock.now_ns() + to_ns(float(self._settings["read_tmo_ms"]) / 1000)
        while talker is not None and self._clock.now_ns() < end_ns and not self._stopping.is_set():
            if (due := talker.take_due()) is not None:
                send_all(self._sock, due[0].payload)
                talker.confirm()
                return
            self._stopping.wait(WAIT_MS / 1000)

    def _say(self, text: str) -> None:
        send_all(self._sock, f"{text}\r\n".encode())


class AdapterServer(LoopbackServer):
    """Serves all instruments behind one adapter, at the GPIB addresses 1, 2, ... in their order, one client at a time.

    Args: instruments, host: as for ``SocketServer``.   port: 0 takes a free one.
    """

    def __init__(self, instruments: Sequence[ServedInstrument], host: str, port: int) -> None:
        self._exchanges = {str(number): Exchange(instrument) for number, instrument in enumerate(instruments, start=1)}
        self._clock = instruments[0].world.clock
        listener = socket.create_server((host, port))
        self.port: int = listener.getsockname()[1]
        super().__init__("adapter", [listener])

    def _run(self) -> None:
        (listener,) = self._listeners
        with listener, suppress(OSError):
            while not self._closing:
                sock, _ = listener.accept()
                self._serve(_Adapter(self._exchanges, self._clock, sock), "adapter")
                for thread in self._clients.values():
                    thread.join()
