"""A VISA resource that plays an exact script: any other byte, order or omission fails the test."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError

from bench.model.clock import VirtualClock

TIMEOUT = object()  # instead of a reply: the read times out
BUS_ERROR = object()  # instead of a reply: the bus reports an error
POLL = object()  # instead of a command: a serial poll, the reply is the status byte
READ = object()  # instead of a command: a read without one
CLEAR = object()  # instead of a command: a device clear
SILENT = [(POLL, 0), (CLEAR, None)]  # what follows a time-out

LONGEST_CALL_MS = 1500
_FAILURES = {TIMEOUT: StatusCode.error_timeout, BUS_ERROR: StatusCode.error_connection_lost}


def flatten(pairs: Sequence[tuple[Any, Any]]) -> list[tuple[str, Any]]:
    """Command/reply pairs as single bus events."""
    events: list[tuple[str, Any]] = []
    for command, reply in pairs:
        if command is POLL:
            events.append(("poll", reply))
        elif command is CLEAR:
            events.append(("clear", reply))
        else:
            if command is not READ:
                events.append(("write", command))
            if reply is not None:
                events.append(("read", reply))
    return events


class ScriptedResource:
    """Stands for a MessageBasedResource."""

    resource_name = "GPIB0::4::INSTR"

    def __init__(self, pairs: Sequence[tuple[Any, Any]]) -> None:
        self.events = flatten(pairs)
        self.write_termination = "\r\n"
        self.read_termination: str | None = None
        self.timeout: float | None = 2000
        self.timeouts_ms: list[float] = []
        self.closed = False

    def _next(self, kind: str, content: object = None) -> Any:
        if not self.events:
            pytest.fail(f"nothing more is due, but {kind} {content!r} came")
        due_kind, due = self.events.pop(0)
        if kind != due_kind:
            pytest.fail(f"{due_kind} {due!r} is due, but {kind} {content!r} came")
        return due

    def _note_limit(self) -> None:
        assert self.timeout is not None
        self.timeouts_ms.append(self.timeout)
        if self.timeout > LONGEST_CALL_MS:
            pytest.fail(f"a call may block for {self.timeout} ms")

    def write(self, message: str) -> int:
        sent = (message + self.write_termination).encode("ascii")
        due = self._next("write", sent)
        if due in _FAILURES:
            raise VisaIOError(_FAILURES[due])
        if sent != due:
            pytest.fail(f"{due!r} is due, but {sent!r} was sent")
        self._note_limit()
        return len(sent)

    def read(self) -> str:
        reply = self._next("read")
        self._note_limit()
        if reply in _FAILURES:
            raise VisaIOError(_FAILURES[reply])
        text = reply.decode("ascii")
        if not (self.read_termination and text.endswith(self.read_termination)):
            pytest.fail(f"the script's reply {text!r} has no terminator")
        return text.removesuffix(self.read_termination)

    def read_stb(self) -> int:
        status = self._next("poll")
        if status in _FAILURES:
            raise VisaIOError(_FAILURES[status])
        return int(status)

    def clear(self) -> None:
        if (failure := self._next("clear")) in _FAILURES:
            raise VisaIOError(_FAILURES[failure])

    def close(self) -> None:
        self.closed = True


class Log:
    """A transcript that keeps its lines."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str, str, int]] = []

    def __call__(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        self.lines.append((role, direction, text, t_mono_ns))


class Scripts:
    """Opens the next script each time; an exception among them is raised instead: it does not open."""

    def __init__(self, scripts: Sequence[Sequence[tuple[Any, Any]] | Exception]) -> None:
        self.left = list(scripts)
        self.opened: list[ScriptedResource] = []

    def __call__(self) -> ScriptedResource:
        if not self.left:
            pytest.fail("it is not to be opened again")
        script = self.left.pop(0)
        if isinstance(script, Exception):
            raise script
        self.opened.append(ScriptedResource(script))
        return self.opened[-1]

    def leftovers(self) -> list[Any]:
        """What never happened."""
        return [*self.left, *(event for resource in self.opened for event in resource.events)]


def make(name: str, pairs: Sequence[tuple[Any, Any]], *, rungs: dict[str, Any] | None = None, **options: Any) -> Any:
    """A driver by its plain name on a scripted resource; the resource, clock and log hang on it as test_* members.

    ``rungs``: ``reopen`` and ``interface_clear`` of the driver.
    """
    resource, clock, log = ScriptedResource(pairs), VirtualClock(), Log()
    driver_class = importlib.import_module(f"instruments.{name}").DRIVER
    driver = driver_class(resource, role="unit_of_test", clock=clock, transcript=log, options=options, **(rungs or {}))
    driver.test_resource, driver.test_clock, driver.test_log = resource, clock, log
    return driver


@contextmanager
def scripted(name: str, pairs: Sequence[tuple[Any, Any]], **options: Any) -> Iterator[Any]:
    """``make``, and at the end everything in the script must have happened."""
    driver = make(name, pairs, **options)
    yield driver
    left = driver.test_resource.events
    assert not left, f"never happened: {left!r}"
