"""One instrument's message session: a lock per bus, a time limit per command, a transcript, and the recovery ladder.

Only reads are repeated. A time-out always ends with a device clear, so that a late reply is never taken for the answer
to the next question.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from pyvisa.constants import StatusCode
from pyvisa.errors import Error as VisaError
from pyvisa.errors import VisaIOError
from pyvisa.resources import MessageBasedResource

from bench.model.clock import Clock
from bench.model.errors import InstrumentError
from bench.model.ports import Transcript
from instruments.values import OverloadReadingError

READ_ATTEMPTS = 3
TIMED_OUT = "B-INST-001"
BUS_FAILED = "B-INST-003"
NOT_UNDERSTOOD = "B-INST-004"
OVERLOAD = "B-INST-007"
_BUS_ERRORS = (VisaError, OSError)

_registry_lock = threading.Lock()
_locks: dict[str, threading.RLock] = {}

T = TypeVar("T")


def bus_lock(resource_name: str) -> threading.RLock:
    """The lock of the bus a resource is on: one per GPIB board, one per resource on anything else."""
    bus = resource_name.split("::", maxsplit=1)[0] if resource_name.upper().startswith("GPIB") else resource_name
    with _registry_lock:
        return _locks.setdefault(bus.upper(), threading.RLock())


class BusSession:
    """Sends commands to one resource and reads replies; every text goes to the transcript with the clock's time.

    Args: resource: open PyVISA resource; its terminators are set to line feed.   role: name in the station file.
    """

    def __init__(self, resource: MessageBasedResource, role: str, clock: Clock, transcript: Transcript) -> None:
        self._resource = resource
        self._role = role
        self._clock = clock
        self._transcript = transcript
        self._timeout_s = 0.0
        self.where = f"{role} ({resource.resource_name})"
        self.lock = bus_lock(resource.resource_name)
        self.recover: Callable[[], object] = list  # set by the driver: drains the error queue after a failed read
        resource.write_termination = "\n"
        resource.read_termination = "\n"

    def write(self, command: str, timeout_s: float) -> None:
        """Send one command, once. Raises: InstrumentError B-INST-001 (time-out), B-INST-003 (bus)."""
        with self.lock:
            self._note("tx", command)
            self._limit(timeout_s)
            try:
                self._resource.write(command)
            except _BUS_ERRORS as error:
                raise self._failure(error, command) from error

    def read(self, parse: Callable[[str], T], command: str, timeout_s: float) -> T:
        """Read the reply to ``command`` once and understand it.

        Raises: InstrumentError B-INST-001, B-INST-003, B-INST-004 (not understood), B-INST-007 (overload).
        """
        with self.lock:
            self._limit(timeout_s)
            reply = self._receive(command)
            self._note("rx", reply)
            try:
                return parse(reply.strip())
            except OverloadReadingError as error:
                raise InstrumentError(OVERLOAD, f"{command!r} gave {reply!r}: {error}", where=self.where) from error
            except (ValueError, OverflowError) as error:
                raise self._not_understood(command, reply, str(error)) from error

    def query(self, command: str, parse: Callable[[str], T], timeout_s: float, *, repeatable: bool = True) -> T:
        """Ask and understand the reply; a repeatable read is tried again after device clear and error drain."""
        attempts = READ_ATTEMPTS if repeatable else 1
        with self.lock:
            for _ in range(attempts - 1):
                try:
                    return self._ask_once(command, parse, timeout_s)
                except InstrumentError as error:
                    if error.code not in (TIMED_OUT, NOT_UNDERSTOOD) or not self._recovered():
                        raise
            return self._ask_once(command, parse, timeout_s)

    def status_byte(self, timeout_s: float) -> int:
        """Serial poll. Raises: InstrumentError B-INST-001, B-INST-003."""
        with self.lock:
            self._limit(timeout_s)
            try:
                status = int(self._resource.read_stb())
            except _BUS_ERRORS as error:
                raise self._failure(error, "<serial poll>") from error
            self._note("rx", f"<status byte {status}>")
            return status

    def close(self) -> None:
        """Release the session."""
        self._resource.close()

    def _recovered(self) -> bool:
        try:
            self.recover()
        except InstrumentError:
            return False
        return True

    def _ask_once(self, command: str, parse: Callable[[str], T], timeout_s: float) -> T:
        self.write(command, timeout_s)
        return self.read(parse, command, timeout_s)

    def _receive(self, command: str) -> str:
        try:
            return str(self._resource.read())
        except UnicodeDecodeError as error:
            self._note("rx", repr(error.object))
            raise self._not_understood(command, repr(error.object), "it is not ASCII") from error
        except _BUS_ERRORS as error:
            raise self._failure(error, command) from error

    def _not_understood(self, command: str, reply: str, why: str) -> InstrumentError:
        self._clear()
        message = f"the reply {reply[:80]!r} to {command!r} is not understood: {why}"
        return InstrumentError(NOT_UNDERSTOOD, message, where=self.where, next_step="check the model and the cable")

    def _failure(self, error: Exception, command: str) -> InstrumentError:
        if isinstance(error, VisaIOError) and error.error_code == StatusCode.error_timeout:
            self._clear()
            message = f"no answer to {command!r} within {self._timeout_s:g} s"
            return InstrumentError(TIMED_OUT, message, where=self.where, next_step="check power, address and cable")
        message = f"the bus failed on {command!r}: {error}"
        return InstrumentError(BUS_FAILED, message, where=self.where, next_step="check the interface and the cable")

    def _clear(self) -> None:
        self._note("tx", "<device clear>")
        try:
            self._resource.clear()
        except (*_BUS_ERRORS, NotImplementedError) as error:
            self._note("rx", f"<device clear failed: {error}>")

    def _limit(self, timeout_s: float) -> None:
        if timeout_s != self._timeout_s:
            self._resource.timeout = round(1000 * timeout_s)
            self._timeout_s = timeout_s

    def _note(self, direction: str, text: str) -> None:
        self._transcript(self._role, direction, text, self._clock.now_ns())
