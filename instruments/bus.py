"""One instrument's message session: a lock per bus, commands that are sent once, questions that may be asked again.

No call blocks longer than 1.5 s. What takes longer is triggered, then polled for.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from typing import Protocol, TypeVar

from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError
from instruments.values import CutOffError, OverloadReadingError, block_content
from instruments.wire import MESSAGE_AVAILABLE, SLICE_S, BusError, Wire

TIMED_OUT = "B-INST-001"
BUS_FAILED = "B-INST-003"
NOT_UNDERSTOOD = "B-INST-004"
OVERLOAD = "B-INST-007"
SERIAL_POLL = "<serial poll>"
DOUBTFUL = (TIMED_OUT, BUS_FAILED, NOT_UNDERSTOOD)  # what the instrument did with a command is not known
CLOSE_S = 1.0  # for good: then the program ends, and the connection with it
_POLL_S = 0.25
_LOOK_AT_DEVICE = "check power, address and cable"

_registry_lock = threading.Lock()
_locks: dict[str, threading.RLock] = {}

T = TypeVar("T")


class Climb(Protocol):
    """The remedies for a question that failed, before it is given up (instruments.ladder)."""

    def __call__(self, error: InstrumentError, ask: Callable[[], T]) -> T:
        """Return the answer after all. Raises: the last error."""


def bus_lock(resource_name: str) -> threading.RLock:
    """Return the lock of the bus a resource is on: one per GPIB board, one per resource on anything else."""
    bus = resource_name.split("::", maxsplit=1)[0] if resource_name.upper().startswith("GPIB") else resource_name
    with _registry_lock:
        return _locks.setdefault(bus.upper(), threading.RLock())


class BusSession(Wire):
    """Sends commands to one resource and reads replies.

    ``where`` names it for errors; ``lock`` is that of its bus; ``climb`` is asked when a question fails.
    """

    climb: Climb | None = None
    _depth = 0  # conversations under way, one inside the other

    @cached_property
    def lock(self) -> threading.RLock:
        """Lock of the bus."""
        return bus_lock(self._resource.resource_name)

    def write(self, command: str, timeout_s: float) -> None:
        """Send one command, once. Raises: InstrumentError B-INST-001 (time-out), B-INST-003 (bus)."""
        self._keep_apart()
        with self._conversation():
            self.note("tx", command)
            try:
                self.call(timeout_s, partial(self._resource.write, command))
            except BusError as error:
                raise self._failure(error, command) from error
            finally:
                self._spoke_ns = self._clock.now_ns()

    def read(self, parse: Callable[[str], T], command: str, timeout_s: float) -> T:
        """Read the reply to ``command`` once and understand it.

        Raises: InstrumentError B-INST-001, B-INST-003, B-INST-004 (not understood), B-INST-007 (overload).
        """
        with self._conversation():
            return self._understood(parse, command, self._receive(command, timeout_s))

    def query(
        self,
        command: str,
        parse: Callable[[str], T],
        timeout_s: float,
        *,
        repeatable: bool = True,
        patience_s: float = 0.0,
    ) -> T:
        """Ask and understand the reply; a ``repeatable`` question that fails goes up the ladder.

        With ``patience_s`` (second) the reply may take that long: it is polled for, and no call blocks meanwhile.
        """

        def ask() -> T:
            self._put(command, timeout_s)
            if patience_s > 0.0:
                return self._understood(parse, command, self._await_reply(command, timeout_s, patience_s))
            return self.read(parse, command, timeout_s)

        self._keep_apart()  # before the lock: the other instruments of the bus need not wait
        with self._conversation():
            try:
                return ask()
            except InstrumentError as error:
                if not repeatable or self.climb is None or self.hurried or error.code not in DOUBTFUL:
                    raise
                return self.climb(error, ask)

    def fetch(self, question: str, timeout_s: float) -> bytes | None:
        """Ask for a definite-length block and return its content; nobody is waited for and nothing is repeated.

        None at once if the bus is in use: by another thread, or by this one, further up (under the virtual clock a
        callback runs inside the calls of others). A block that is cut off is handed on as far as it came; after that,
        as after an error, the next call clears the instrument, and nothing else. Returns after twice ``timeout_s``.
        Raises: InstrumentError B-INST-001, B-INST-003, B-INST-004, unless part of a block has come.
        """
        if not self.lock.acquire(blocking=False):
            return None
        try:
            if self._depth:
                return None
            with self._conversation(), self.hurry(timeout_s):
                if not self.in_step:
                    self.in_step = self._device_cleared()
                    self._require_step(question)
                    return None
                self.write(question, timeout_s)
                return self._block(question, timeout_s)
        finally:
            self.lock.release()

    def status_byte(self, timeout_s: float) -> int:
        """Serial poll. Raises: InstrumentError B-INST-001, B-INST-003."""
        with self._conversation():
            try:
                return self.poll_status(timeout_s)
            except BusError as error:
                raise self._failure(error, SERIAL_POLL) from error

    def close(self) -> None:
        """Release the session; one that is gone holds nobody up."""
        self.release(CLOSE_S)

    @contextmanager
    def _conversation(self) -> Iterator[None]:
        """Hold the bus while this session talks; a sign of life each half second while somebody else does."""
        while not self.lock.acquire(timeout=SLICE_S):
            self.note("tx", "<bus busy>")
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            self.lock.release()

    def _keep_apart(self) -> None:
        if self._spacing_ns:
            self._clock.sleep_until_ns(self._spoke_ns + self._spacing_ns // (2 if self.hurried else 1))

    def _put(self, question: str, timeout_s: float) -> None:
        if self.lost:
            self.tried(self._clock.now_ns())
            age_s = (self._clock.now_ns() - self.heard_ns) / NS
            message = f"{question!r} was not asked: nobody is there, the last answer came {age_s:.1f} s ago"
            raise InstrumentError(self.lost, message, where=self.where, next_step=_LOOK_AT_DEVICE)
        if not self.in_step or self.came_unasked():
            self.clear()
        self._require_step(question)
        self.write(question, timeout_s)

    def _require_step(self, question: str) -> None:
        if not self.in_step:
            message = f"{question!r} was not asked: a reply to an earlier question may still come"
            raise InstrumentError(TIMED_OUT, message, where=self.where, next_step=_LOOK_AT_DEVICE)

    def _await_reply(self, command: str, timeout_s: float, patience_s: float) -> str:
        """Return the reply, once a serial poll says that it is there; without serial poll it is heard bit by bit."""
        end_ns = self._clock.now_ns() + to_ns(patience_s)
        while True:
            try:
                if self.poll_status() & MESSAGE_AVAILABLE:
                    return self._receive(command, timeout_s)
            except BusError as error:
                if not error.unsupported:
                    raise self._failure(error, command) from error
                if (reply := self.hear(timeout_s)) is not None and not self.came_late(command, reply):
                    self.note("rx", reply)
                    return reply
            if self._clock.now_ns() >= end_ns:
                raise self._failure(BusError(TimeoutError(), end_ns, patience_s), command)
            self._clock.sleep(_POLL_S)

    def _receive(self, command: str, timeout_s: float) -> str:
        try:
            reply = str(self.call(timeout_s, self._resource.read))
        except UnicodeDecodeError as error:
            self.note("rx", repr(error.object))
            raise self._not_understood(command, repr(error.object), "it is not ASCII") from error
        except BusError as error:
            raise self._failure(error, command) from error
        self.heard()
        self._spoke_ns = self._clock.now_ns()
        if self.came_late(command, reply):
            return self._receive(command, timeout_s)
        self.note("rx", reply)
        return reply

    def _block(self, question: str, timeout_s: float) -> bytes:
        came = bytearray()
        failure: BusError | None = None
        try:
            self.collect(came, timeout_s)
        except BusError as error:
            failure = error
        self._spoke_ns = self._clock.now_ns()
        try:
            content = block_content(came)
        except CutOffError as short:
            self.in_step = False
            if failure is not None and not short.content:
                raise self._failure(failure, question) from failure
            self.note("rx", f"<{short}>")
            return short.content
        except ValueError as error:
            raise self._not_understood(question, repr(bytes(came[:80])), str(error)) from error
        self.note("rx", f"<{len(content)} bytes>")
        return content

    def _understood(self, parse: Callable[[str], T], command: str, reply: str) -> T:
        try:
            return parse(reply.strip())
        except OverloadReadingError as error:
            raise InstrumentError(OVERLOAD, f"{command!r} gave {reply!r}: {error}", where=self.where) from error
        except (ValueError, OverflowError) as error:
            raise self._not_understood(command, reply, str(error)) from error

    def _not_understood(self, command: str, reply: str, why: str) -> InstrumentError:
        self._fall_out_of_step()
        message = f"the reply {reply[:80]!r} to {command!r} is not understood: {why}"
        return InstrumentError(NOT_UNDERSTOOD, message, where=self.where, next_step="check the model and the cable")

    def _failure(self, error: BusError, command: str) -> InstrumentError:
        if not error.timed_out:
            self.in_step = False
            self.missed(error, BUS_FAILED)
            message = f"the bus failed on {command!r}: {error}"
            next_step = "check the interface and the cable"
            return InstrumentError(BUS_FAILED, message, where=self.where, next_step=next_step)
        self.owe(command)
        message = f"no answer to {command!r} within {error.limit_s:g} s"
        if not (self.hurried or command == SERIAL_POLL):
            message += self.look_for_life()
        self.missed(error, TIMED_OUT)
        self._fall_out_of_step()
        return InstrumentError(TIMED_OUT, message, where=self.where, next_step=_LOOK_AT_DEVICE)

    def _fall_out_of_step(self) -> None:
        self.in_step = False
        if not (self.hurried or self.lost):
            self.clear()
