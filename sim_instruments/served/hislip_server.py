"""HiSLIP on one port of the loopback interface: takes connections, pairs the two channels of each session.

The sub-address hislip0, hislip1, ... picks the instrument. Each session then has a thread of its own, so that no
instrument waits for another.

Source: IVI-6.1, 6.1 (initialization transaction).
"""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field

from sim_instruments.served.hislip_exchange import ServedInstrument
from sim_instruments.served.hislip_session import HislipSession
from sim_instruments.served.hislip_wire import (
    Fatal,
    FatalProtocolError,
    Inbox,
    Message,
    Type,
    receive_now,
    say,
    say_fatal,
)
from sim_instruments.served.socket_server import LoopbackServer

MOST_SESSIONS = 64
MOST_WAITING = 64  # connections that are not a session yet; the oldest gives way
_VERSION = 0x0100  # 1.0: what both sides of every version understand
_VENDOR = int.from_bytes(b"IB", "big")


@dataclass(eq=False)
class _Caller:
    """A connection that is not part of a session yet; with an instrument, its synchronous half waits for the other."""

    sock: socket.socket
    inbox: Inbox = field(default_factory=Inbox)
    instrument: ServedInstrument | None = None
    session_id: int = 0


class HislipServer(LoopbackServer):
    """Serves the instruments until ``close``.

    Args: instruments: number n is reached as hislip<n>.   host: a loopback address.   port: 0 takes a free one.
    Raises: OSError if the port is taken.
    """

    def __init__(self, instruments: Sequence[ServedInstrument], host: str, port: int) -> None:
        self._instruments = {f"hislip{number}": instrument for number, instrument in enumerate(instruments)}
        self._listener = socket.create_server((host, port), backlog=64)
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._waiting: dict[socket.socket, _Caller] = {}
        self._last_id = 0
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        super().__init__("hislip server", [self._listener])

    # --- connections -------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._closing:
                for key, _ in self._selector.select():
                    if key.fileobj is self._listener:
                        self._accept()
                    elif isinstance(key.fileobj, socket.socket) and key.fileobj in self._waiting:
                        self._listen_to(self._waiting[key.fileobj])
        finally:
            for caller in list(self._waiting.values()):
                self._hang_up(caller)
            self._selector.close()
            self._listener.close()

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:  # the caller is gone again, or the server is being closed
            return
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while len(self._waiting) >= MOST_WAITING:
            self._hang_up(next(iter(self._waiting.values())))
        self._waiting[sock] = _Caller(sock)
        self._selector.register(sock, selectors.EVENT_READ)

    def _listen_to(self, caller: _Caller) -> None:
        try:
            chunk = receive_now(caller.sock)
            if chunk is None:
                return
            if not chunk:
                self._hang_up(caller)
                return
            for message in caller.inbox.feed(chunk):
                self._on_first(caller, message)
        except FatalProtocolError as error:
            say_fatal(caller.sock, error)
            self._hang_up(caller)
        except OSError:
            self._hang_up(caller)

    def _hang_up(self, caller: _Caller) -> None:
        self._release(caller)
        caller.sock.close()

    def _release(self, caller: _Caller) -> None:
        if self._waiting.pop(caller.sock, None) is not None:
            with contextlib.suppress(KeyError):
                self._selector.unregister(caller.sock)

    # --- initialization ----------------------------------------------------------------------------------------

    def _on_first(self, caller: _Caller, message: Message) -> None:
        if caller.instrument is not None:
            raise FatalProtocolError(Fatal.ONE_CHANNEL_ONLY, "the asynchronous channel is not open yet")
        if message.type == Type.INITIALIZE:
            self._initialize(caller, message)
        elif message.type == Type.ASYNC_INITIALIZE:
            self._pair(caller, message.parameter)
        else:
            raise FatalProtocolError(Fatal.BAD_INITIALIZATION, "a connection begins with an initialization")

    def _initialize(self, caller: _Caller, message: Message) -> None:
        name = message.payload.decode("latin-1")
        instrument = self._instruments.get(name)
        if instrument is None:
            known = f"hislip0 to hislip{len(self._instruments) - 1}"
            raise FatalProtocolError(Fatal.BAD_INITIALIZATION, f"no instrument at {name[:40]!r}; there are {known}")
        if self._alive() >= MOST_SESSIONS:
            raise FatalProtocolError(Fatal.TOO_MANY_CLIENTS, f"{MOST_SESSIONS} sessions are open")
        self._last_id = self._last_id % 0xFFFF + 1
        caller.instrument, caller.session_id = instrument, self._last_id
        version = min(_VERSION, message.parameter >> 16)
        say(caller.sock, Type.INITIALIZE_RESPONSE, 0, version << 16 | self._last_id)

    def _pair(self, caller: _Caller, session_id: int) -> None:
        waiting = self._waiting.values()
        halves = (half for half in waiting if half.instrument is not None and half.session_id == session_id)
        first = next(halves, None)
        if first is None or first.instrument is None:
            raise FatalProtocolError(Fatal.BAD_INITIALIZATION, f"no session {session_id} waits for its second channel")
        say(caller.sock, Type.ASYNC_INITIALIZE_RESPONSE, 0, _VENDOR)
        self._release(first)
        self._release(caller)
        session = HislipSession(first.instrument, first.sock, caller.sock)
        self._serve(session, f"hislip session {first.instrument.device.role}")
