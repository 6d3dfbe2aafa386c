"""HiSLIP on one port of the loopback interface: takes connections, pairs the two channels of each session.

The sub-address hislip0, hislip1, ... picks the instrument. Each session then has a thread of its own, so that no
instrument waits for another.

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
import select
import selectors
import socket
import struct
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from bench.model.clock import NS, Clock
from sim_instruments.served.hislip_exchange import Exchange, LockAnswer, ServedInstrument
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
    receive_now,
    say,
    say_fatal,
    shut,
)
from sim_instruments.served.socket_server import LoopbackServer

WAIT_MS = 5  # while a reply is not due yet, or a lock of another client is waited for
LAST_MS = 5000  # for commands of a client that is gone; on a busy machine two connections do not keep the order
_NEAR_NS = 5_000_000  # a reply due sooner is slept for on the bench's clock
_LOCAL_CONTROLS = range(7)


class HislipSession:
    """Serves one client until it goes, breaks the protocol, or ``stop`` is called.

    Args: instrument: what it talks to.   sync, asynchronous: its two connections; the session closes them.
    """

    def __init__(self, instrument: ServedInstrument, sync: socket.socket, asynchronous: socket.socket) -> None:
        self._instrument = instrument
        self._sync, self._async = sync, asynchronous
        self._exchange = Exchange(instrument)
        self._inboxes = {sync: Inbox(), asynchronous: Inbox()}
        self._input = bytearray()
        self._clearing = False
        self._wanted_lock: tuple[str, int] | None = None
        self._largest_payload = MAX_MESSAGE_BYTES - HEADER.size
        self._stopping = threading.Event()
        self._handlers: dict[int, Callable[[Message], None]] = {
            Type.ASYNC_LOCK: self._lock,
            Type.ASYNC_REMOTE_LOCAL_CONTROL: self._remote_local,
            Type.ASYNC_MAX_MESSAGE_SIZE: self._agree_size,
            Type.ASYNC_DEVICE_CLEAR: self._begin_clear,
            Type.ASYNC_STATUS_QUERY: self._status,
            Type.ASYNC_LOCK_INFO: self._lock_info,
        }

    def run(self) -> None:
        """Serve the client; returns when it is gone, with its locks given back and both connections closed."""
        try:
            while self._serve():
                pass
        except OSError:
            pass
        except FatalProtocolError as error:
            say_fatal(self._sync, error)
            say_fatal(self._async, error)
        finally:
            self._instrument.locks.forget(self)
            for sock in (self._sync, self._async):
                sock.close()

    def stop(self) -> None:
        """End the session, from any thread."""
        self._stopping.set()
        for sock in (self._sync, self._async):
            shut(sock)

    # --- the loop ----------------------------------------------------------------------------------------------

    def _serve(self) -> bool:
        self._wait()
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
        return alive and not self._stopping.is_set()

    @property
    def _shut_out(self) -> bool:
        """Commands stay in the connection while another client has the lock; the end of a device clear does not."""
        return not self._clearing and self._instrument.locks.shut_out(self)

    def _wait(self) -> None:
        """Until a client's message, the next reply, or the next look at the locks."""
        awaited = select.poll()
        awaited.register(self._async, select.POLLIN)
        shut_out = self._shut_out
        if not shut_out:
            awaited.register(self._sync, select.POLLIN)
        due_ns = self._exchange.due_ns()
        if self._instrument.hung:
            awaited.poll(WAIT_MS)
        elif due_ns is not None and due_ns - self._clock.now_ns() <= _NEAR_NS:
            if not awaited.poll(0):
                self._clock.sleep_until_ns(due_ns)
        elif due_ns is not None or shut_out or self._wanted_lock is not None:
            awaited.poll(WAIT_MS)
        else:
            awaited.poll()

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
        coming = select.poll()
        coming.register(self._sync, select.POLLIN)
        while not self._shut_out and coming.poll(LAST_MS) and self._take_commands():
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
        while not self._clearing and (due := self._exchange.take_due()) is not None:
            reply, message_id = due
            size = self._largest_payload
            pieces = [reply.payload[at : at + size] for at in range(0, len(reply.payload), size)]
            for number, piece in enumerate(pieces, 1):
                kind = Type.TEXT_END if reply.end and number == len(pieces) else Type.TEXT
                say(self._sync, kind, 0, message_id, piece)

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
