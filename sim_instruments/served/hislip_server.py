"""HiSLIP on one port of the loopback interface: pairs the two channels of each session.

The sub-address hislip0, hislip1, ... picks the instrument. Each session has a thread of its own, so that no instrument
waits for another.

Source: IVI-6.1, 6.1 (initialization transaction).

One HiSLIP session on the server's side: both channels of one client of one instrument, served by one thread.

Synchronized mode only. Commands that have arrived are carried out before anything of the asynchronous channel, so a
serial poll sees their effect, and so are the last ones of a client that has gone, unless another has the lock. The
message number in AsyncStatusQuery is not looked at: clients in use fill it differently, and here nothing is on the way
when the query is answered.

Source: IVI-6.1: 3.1.1 (responses, interrupted), 6.5 locks, 6.11 interrupted, 6.12 device clear, 6.14 status query.
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import struct
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bench.model.clock import NS, Clock
from sim_instruments.served.hislip_exchange import WAIT_MS, Exchange, LockAnswer, ServedInstrument
from sim_instruments.served.hislip_wire import (
    FIRST_VENDOR_TYPE,
    HEADER,
    MAX_MESSAGE_BYTES,
    RMT_DELIVERED,
    Fatal,
    FatalProtocolError,
    Inbox,
    Message,
    Mistake,
    RefusedMessage,
    Type,
    is_ready,
    receive_now,
    say,
    say_fatal,
    shut,
)
from sim_instruments.served.socket_server import TcpServer

LAST_MS = 5000  # for commands of a client that is gone; on a busy machine two connections do not keep the order
_LOCAL_CONTROLS = range(7)


class HislipSession:
    """Serves one client until it goes, breaks the protocol, or ``closing`` is set.

    Args: instrument: what it talks to.   sync, asynchronous: its two connections; the session closes them.
    """

    def __init__(
        self, instrument: ServedInstrument, sync: socket.socket, asynchronous: socket.socket, closing: threading.Event
    ) -> None:
        self._instrument = instrument
        self._sync, self._async = sync, asynchronous
        self._exchange = Exchange(instrument)
        self._inboxes = {sync: Inbox(), asynchronous: Inbox()}
        self._input = bytearray()
        self._clearing = False
        self._wanted_lock: tuple[str, int] | None = None
        self._largest_payload = MAX_MESSAGE_BYTES - HEADER.size
        self._closing = closing
        self._handlers: dict[int, Callable[[Message], None]] = {
            Type.ASYNC_LOCK: self._lock,
            Type.ASYNC_REMOTE_LOCAL_CONTROL: self._remote_local,
            Type.ASYNC_MAX_MESSAGE_SIZE: self._agree_size,
            Type.ASYNC_DEVICE_CLEAR: self._begin_clear,
            Type.ASYNC_STATUS_QUERY: self._status,
            Type.ASYNC_LOCK_INFO: self._lock_info,
        }

    def run(self) -> None:
        """Serve the client until it is gone; then its locks are given back and both connections closed.

        Raises: OSError if it goes while something is sent.
        """
        threading.current_thread().name = f"hislip session {self._instrument.device.role}"
        try:
            while self._serve() and not self._closing.is_set():
                pass
        except FatalProtocolError as error:
            say_fatal(self._sync, error)
            say_fatal(self._async, error)
        finally:
            self._instrument.locks.forget(self)
            for sock in (self._sync, self._async):
                sock.close()

    # --- the loop ----------------------------------------------------------------------------------------------

    def _serve(self) -> bool:
        """Do what there is to do next; False if the client is gone."""
        shut_out = self._shut_out
        idle = not shut_out and self._wanted_lock is None
        self._exchange.wait(self._async, *[self._sync] * (not shut_out), idle=idle)
        asked = receive_now(self._async)  # taken first, handled last: what was sent before it has arrived by now
        alive = self._take_commands()
        if alive and asked:
            alive = self._handle(self._async, asked)
        elif alive and asked == b"":
            self._take_last_commands()
            return False
        if not self._instrument.hung:
            self._send_due()
            if self._wanted_lock is not None:
                self._try_lock(*self._wanted_lock)
        return alive

    @property
    def _shut_out(self) -> bool:
        """Commands stay in the connection while another client has the lock; the end of a device clear does not."""
        return not self._clearing and self._instrument.locks.shut_out(self)

    @property
    def _clock(self) -> Clock:
        return self._instrument.world.clock

    def _take_commands(self) -> bool:
        """Carry out all that has arrived on the synchronous channel; False if the client is gone."""
        while not self._shut_out and (chunk := receive_now(self._sync)) is not None:
            if not chunk or not self._handle(self._sync, chunk):
                return False
        return True

    def _take_last_commands(self) -> None:
        """The asynchronous channel is closed: what was sent on the other one before may still be on its way."""
        while not self._shut_out and is_ready(self._sync, limit_ms=LAST_MS) and self._take_commands():
            pass

    def _handle(self, sock: socket.socket, chunk: bytes) -> bool:
        """Handle the messages that are complete; False if one of them ends the session."""
        handle = self._on_sync if sock is self._sync else self._on_async
        for message in self._inboxes[sock].feed(chunk):
            if self._instrument.hung and message.type != Type.ASYNC_MAX_MESSAGE_SIZE:  # part of connecting
                continue
            try:
                if message.type == Type.FATAL_ERROR:
                    return False
                if message.type != Type.ERROR:
                    handle(message)
            except RefusedMessage as error:
                mistake, text = error.args
                say(sock, Type.ERROR, mistake, 0, text.encode())
        return True

    def _send_due(self) -> None:
        while not self._clearing and (reply := self._exchange.take_due()) is not None:
            size = self._largest_payload
            pieces = [reply.payload[at : at + size] for at in range(0, len(reply.payload), size)]
            for number, piece in enumerate(pieces, 1):
                kind = Type.TEXT_END if reply.end and number == len(pieces) else Type.TEXT
                say(self._sync, kind, 0, reply.message_id, piece)

    # --- synchronous channel -----------------------------------------------------------------------------------

    def _on_sync(self, message: Message) -> None:
        if message.type == Type.DEVICE_CLEAR_COMPLETE:
            self._end_clear()
        elif self._clearing:
            return
        elif message.type in (Type.TEXT, Type.TEXT_END):
            self._text(message)
        elif message.type == Type.TRIGGER:
            self._acknowledge(message)
            self._tell_interrupted(self._exchange.trigger(message.parameter), message.parameter)
        else:
            raise _refusal(message)

    def _text(self, message: Message) -> None:
        self._acknowledge(message)
        if message.too_large or len(self._input) + len(message.payload) > MAX_MESSAGE_BYTES:
            self._input.clear()
            raise RefusedMessage(Mistake.TOO_LARGE, f"a message may have {MAX_MESSAGE_BYTES} bytes, header included")
        self._input += message.payload
        if message.type == Type.TEXT_END or self._input.endswith(b"\n"):
            command = bytes(self._input)
            self._input.clear()
            self._tell_interrupted(self._exchange.command(command, message.parameter), message.parameter)

    def _acknowledge(self, message: Message) -> None:
        if message.control & RMT_DELIVERED:
            self._exchange.confirm()

    def _tell_interrupted(self, overtaken: bool, message_id: int) -> None:
        """A reply that was not sent yet is gone: said on both channels; one that was sent is the client's to drop."""
        if overtaken:
            say(self._async, Type.ASYNC_INTERRUPTED, 0, message_id)
            say(self._sync, Type.INTERRUPTED, 0, message_id)

    def _end_clear(self) -> None:
        if not self._clearing:
            raise RefusedMessage(Mistake.UNIDENTIFIED, "no device clear is under way")
        self._clearing = False
        say(self._sync, Type.DEVICE_CLEAR_ACKNOWLEDGE)

    # --- asynchronous channel ----------------------------------------------------------------------------------

    def _on_async(self, message: Message) -> None:
        handler = self._handlers.get(message.type)
        if handler is None:
            raise _refusal(message)
        if message.too_large:
            raise RefusedMessage(Mistake.TOO_LARGE, f"a message may have {MAX_MESSAGE_BYTES} bytes, header included")
        handler(message)

    def _begin_clear(self, _: Message) -> None:
        self._clearing = True
        self._input.clear()
        self._exchange.clear()
        say(self._async, Type.ASYNC_DEVICE_CLEAR_ACKNOWLEDGE)

    def _status(self, message: Message) -> None:
        self._acknowledge(message)
        say(self._async, Type.ASYNC_STATUS_RESPONSE, self._exchange.status_byte() & 0xFF)

    def _remote_local(self, message: Message) -> None:
        if message.control not in _LOCAL_CONTROLS:
            raise RefusedMessage(Mistake.UNKNOWN_CONTROL_CODE, f"remote/local control {message.control}")
        say(self._async, Type.ASYNC_REMOTE_LOCAL_RESPONSE)

    def _agree_size(self, message: Message) -> None:
        if len(message.payload) != 8:
            raise FatalProtocolError(Fatal.BAD_HEADER, "the payload of a maximum message size has 8 bytes")
        (largest,) = struct.unpack("!Q", message.payload)
        self._largest_payload = max(1, min(largest, MAX_MESSAGE_BYTES) - HEADER.size)
        mine = struct.pack("!Q", MAX_MESSAGE_BYTES)
        say(self._async, Type.ASYNC_MAX_MESSAGE_SIZE_RESPONSE, payload=mine)

    def _lock(self, message: Message) -> None:
        """Ask for a lock, waiting for it on the bench's clock, or give one back."""
        if message.control == 0:
            say(self._async, Type.ASYNC_LOCK_RESPONSE, self._instrument.locks.release(self))
        elif message.control == 1:
            deadline_ns = self._clock.now_ns() + message.parameter * (NS // 1000)
            self._try_lock(message.payload.decode("latin-1"), deadline_ns)
        else:
            raise RefusedMessage(Mistake.UNKNOWN_CONTROL_CODE, f"lock control {message.control}")

    def _try_lock(self, key: str, deadline_ns: int) -> None:
        answer = self._instrument.locks.request(self, key)
        if answer == LockAnswer.FAILURE and self._clock.now_ns() < deadline_ns:
            self._wanted_lock = (key, deadline_ns)
            return
        self._wanted_lock = None
        say(self._async, Type.ASYNC_LOCK_RESPONSE, answer)

    def _lock_info(self, _: Message) -> None:
        exclusive, clients = self._instrument.locks.holders()
        say(self._async, Type.ASYNC_LOCK_INFO_RESPONSE, int(exclusive), clients)


def _refusal(message: Message) -> Exception:
    if message.type in (Type.INITIALIZE, Type.ASYNC_INITIALIZE):
        return FatalProtocolError(Fatal.BAD_INITIALIZATION, "the session is open already")
    if message.type >= FIRST_VENDOR_TYPE:
        return RefusedMessage(Mistake.UNKNOWN_VENDOR_MESSAGE, f"message type {message.type}")
    return RefusedMessage(Mistake.UNKNOWN_TYPE, f"message type {message.type}")


MOST_SESSIONS = 64
MOST_WAITING = 64  # connections that are not a session yet; the oldest gives way
_VERSION = 0x0100  # 1.0: what both sides of every version understand
_VENDOR = int.from_bytes(b"IB", "big")


@dataclass
class _Call:
    """A session, or what becomes one with its second channel."""

    instrument: ServedInstrument
    second: socket.socket | None = None


class HislipServer(TcpServer):
    """Serves the instruments until ``close``.

    Args: instruments: number n is reached as hislip<n>.   host: a loopback address.   port: 0 takes a free one.
    Raises: OSError if the port is taken.
    """

    most_connections = MOST_SESSIONS + 2 * MOST_WAITING  # further ones are told so, or give way

    def __init__(self, instruments: Sequence[ServedInstrument], host: str, port: int) -> None:
        self._instruments = {f"hislip{number}": instrument for number, instrument in enumerate(instruments)}
        self._ids = itertools.cycle(range(1, 1 << 16))
        self._waiting: list[socket.socket] = []  # the oldest first
        self._calls: dict[int, _Call] = {}
        super().__init__("hislip", host, port)

    def serve(self, sock: socket.socket) -> None:
        """Serve a session on the thread of its first channel; that of the second one ends at once."""
        self._waiting.append(sock)
        if len(self._waiting) > MOST_WAITING:
            shut(self._waiting.pop(0))
        number = next(self._ids)
        try:
            session = self._opened(number, sock)
            if session is not None:
                session.run()
        except FatalProtocolError as error:
            say_fatal(sock, error)
        finally:
            self._calls.pop(number, None)

    def _opened(self, number: int, sock: socket.socket) -> HislipSession | None:
        """Return the session that a connection begins; None if it goes, or is the second channel of another one."""
        inbox, call = Inbox(), None
        try:
            while call is None or call.second is None:
                # the second channel is brought by the thread that took it
                if not is_ready(sock, limit_ms=WAIT_MS if call else None) or (call and call.second):
                    continue
                if not (chunk := receive_now(sock)):
                    return None
                for message in inbox.feed(chunk):
                    if call is not None:
                        raise FatalProtocolError(Fatal.ONE_CHANNEL_ONLY, "the asynchronous channel is not open yet")
                    if message.type == Type.ASYNC_INITIALIZE:
                        self._join(message.parameter, sock)
                        return None
                    call = self._calls[number] = _Call(self._instrument_at(message))
                    say(sock, Type.INITIALIZE_RESPONSE, 0, min(_VERSION, message.parameter >> 16) << 16 | number)
        finally:
            with contextlib.suppress(ValueError):  # it had to give way
                self._waiting.remove(sock)
        return HislipSession(call.instrument, sock, call.second, self.closing)

    def _instrument_at(self, message: Message) -> ServedInstrument:
        if message.type != Type.INITIALIZE:
            raise FatalProtocolError(Fatal.BAD_INITIALIZATION, "a connection begins with an initialization")
        name = message.payload.decode("latin-1")
        if name not in self._instruments:
            known = f"hislip0 to hislip{len(self._instruments) - 1}"
            raise FatalProtocolError(Fatal.BAD_INITIALIZATION, f"no instrument at {name[:40]!r}; there are {known}")
        if sum(call.second is not None for call in list(self._calls.values())) >= MOST_SESSIONS:
            raise FatalProtocolError(Fatal.TOO_MANY_CLIENTS, f"{MOST_SESSIONS} sessions are open")
        return self._instruments[name]

    def _join(self, number: int, sock: socket.socket) -> None:
        """Hand a connection to the session that waits for it."""
        call = self._calls.get(number)
        if call is None or call.second is not None:
            raise FatalProtocolError(Fatal.BAD_INITIALIZATION, f"no session {number} waits for its second channel")
        call.second = socket.socket(fileno=sock.detach())  # before the answer: then its client may send commands
        say(call.second, Type.ASYNC_INITIALIZE_RESPONSE, 0, _VENDOR)
