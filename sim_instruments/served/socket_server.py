"""Servers on the loopback interface, and two of them: raw sockets, as SCPI instruments offer them, and a GPIB adapter.

On a raw socket lines come in and lines go out, a TCP port for each instrument. There is no END, no serial poll and no
device clear; commands are carried out in order, each after the reply to the one before has been sent. A late reply
cannot be told apart from the answer to the next question: that is the nature of a raw socket.
"""

from __future__ import annotations

import re
import socket
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress

from bench.model.clock import Clock, to_ns
from sim_instruments.served.hislip_exchange import WAIT_MS, Exchange, ServedInstrument
from sim_instruments.served.hislip_wire import is_ready, receive_now, send_all, shut

MOST_LINES = 256  # commands taken in advance; more stay in the connection
LONGEST_LINE_BYTES = 1 << 20
_JOIN_LIMIT_S = 5.0


class LoopbackServer:
    """Takes connections, each on a thread of its own, until ``close``; ``closing`` is set then.

    Args: name: of its threads.   listener: what it listens at; it closes that.
    """

    most_connections = 64

    def __init__(self, name: str, listener: socket.socket) -> None:
        self._name, self._listener = name, listener
        self.closing = threading.Event()
        self._threads: dict[socket.socket, threading.Thread] = {}
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def serve(self, sock: socket.socket) -> None:
        """Serve one client on its non-blocking connection; returns, or raises OSError, when it is gone."""
        raise NotImplementedError

    def close(self) -> None:
        """End every client and the server; idempotent. No thread, port or connection is left."""
        self.closing.set()
        shut(self._listener)
        self._thread.join(_JOIN_LIMIT_S)
        for sock in self._threads:
            shut(sock)
        for thread in self._threads.values():
            thread.join(_JOIN_LIMIT_S)

    def _run(self) -> None:
        with self._listener:
            while not self.closing.is_set():
                with suppress(OSError):  # the caller is gone again, or the server is being closed
                    self._begin(self._listener.accept()[0])

    def _begin(self, sock: socket.socket) -> None:
        self._threads = {other: thread for other, thread in self._threads.items() if thread.is_alive()}
        if len(self._threads) >= self.most_connections:
            sock.close()
            return
        sock.setblocking(False)
        thread = self._threads[sock] = threading.Thread(target=self._serve, args=[sock], name=self._name, daemon=True)
        thread.start()

    def _serve(self, sock: socket.socket) -> None:
        with sock, suppress(OSError):
            self.serve(sock)


class TcpServer(LoopbackServer):
    """Takes connections at a port of a loopback address.

    Args: port: 0 takes a free one.   Raises: OSError if it is taken.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        listener = socket.create_server((host, port), backlog=64)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # its connections inherit that, tcp(7)
        self.port: int = listener.getsockname()[1]
        super().__init__(name, listener)


class SocketServer(TcpServer):
    """Serves one instrument."""

    def __init__(self, instrument: ServedInstrument, host: str, port: int) -> None:
        self._instrument = instrument
        super().__init__(f"raw socket {instrument.device.role}", host, port)

    def serve(self, sock: socket.socket) -> None:
        """Serve one client, until it goes."""
        connection = _Connection(self._instrument, sock)
        while connection.serve() and not self.closing.is_set():
            pass


class _Connection:
    """One client of one instrument."""

    def __init__(self, instrument: ServedInstrument, sock: socket.socket) -> None:
        self._instrument, self._sock = instrument, sock
        self._exchange = Exchange(instrument)
        self._begun = b""
        self._ended = False  # the client sends no more; what it sent is still answered
        self._lines: deque[bytes] = deque()

    def serve(self) -> bool:
        """Do what there is to do next; False if there is nothing any more."""
        if not self._may_act():
            takes = not self._ended and len(self._lines) < MOST_LINES
            self._exchange.wait(*[self._sock] * takes, idle=not self._lines)
        if not self._ended and len(self._lines) < MOST_LINES:
            self._take()
        if not self._instrument.hung:
            while (due := self._exchange.take_due()) is not None:
                send_all(self._sock, due.payload)
                self._exchange.confirm()
        if self._may_act():
            self._exchange.command(self._lines.popleft(), 0)
        return not self._ended or bool(self._lines) or self._exchange.due_ns() is not None

    def _may_act(self) -> bool:
        """Return whether the next command may be carried out."""
        free = not self._instrument.hung and not self._instrument.locks.shut_out(self)
        return free and bool(self._lines) and self._exchange.due_ns() is None

    def _take(self) -> None:
        chunk = receive_now(self._sock)
        if chunk is None:
            return
        *lines, self._begun = (self._begun + chunk).split(b"\n")
        if not self._instrument.hung:
            self._lines.extend(lines)
        self._ended = not chunk or len(self._begun) > LONGEST_LINE_BYTES


_ADAPTER_LINE = re.compile(rb"((?:\x1b.|[^\x1b\r\n])*)[\r\n]", re.DOTALL)
_EOS = {"0": b"\r\n", "1": b"\r", "2": b"\n", "3": b""}
VERSION = "Prologix GPIB-ETHERNET Controller version 01.06.06.00"


class _Adapter:
    """A Prologix GPIB-ETHERNET with its client: lines that begin with "++" are its own, others the instrument's.

    Source: Prologix GPIB-USB Controller User Manual, 2011, 7 and 8 (the commands are those of both models).
    """

    def __init__(
        self, exchanges: Mapping[str, Exchange], clock: Clock, sock: socket.socket, closing: threading.Event
    ) -> None:
        self._exchanges, self._clock, self._sock, self._closing = exchanges, clock, sock, closing
        self._settings = {"addr": "0", "auto": "1", "eos": "0", "read_tmo_ms": "1000"}

    def take(self, line: bytes) -> None:
        """Carry out one line."""
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
        while talker is not None and self._clock.now_ns() < end_ns and not self._closing.is_set():
            if (due := talker.take_due()) is not None:
                send_all(self._sock, due.payload)
                talker.confirm()
                return
            self._closing.wait(WAIT_MS / 1000)

    def _say(self, text: str) -> None:
        send_all(self._sock, f"{text}\r\n".encode())


class AdapterServer(TcpServer):
    """Serves all instruments behind one adapter, at GPIB addresses 1, 2, ... in their order; one client at a time."""

    def __init__(self, instruments: Sequence[ServedInstrument], host: str, port: int) -> None:
        self._exchanges = {str(number): Exchange(instrument) for number, instrument in enumerate(instruments, start=1)}
        self._clock = instruments[0].world.clock
        self._turn = threading.Lock()
        super().__init__("adapter", host, port)

    def serve(self, sock: socket.socket) -> None:
        """Serve one client, once the one before is gone, until it goes."""
        begun = b""
        with self._turn:
            adapter = _Adapter(self._exchanges, self._clock, sock, self.closing)
            while is_ready(sock, limit_ms=None) and (chunk := receive_now(sock)):
                begun += chunk
                while (line := _ADAPTER_LINE.match(begun)) and not self.closing.is_set():
                    begun = begun[line.end() :]
                    adapter.take(line[1])
