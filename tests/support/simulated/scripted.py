"""A VISA resource that plays an exact script: any other byte, order or omission fails the test."""

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError

from bench.model.clock import VirtualClock
from bench.model.drivers import manual_of
from bench.model.errors import InstrumentError

TIMEOUT = object()  # instead of a reply: the read times out
BUS_ERROR = object()  # instead of a reply: the bus reports an error
POLL = object()  # instead of a command: a serial poll, the reply is the status byte
READ = object()  # instead of a command: a read without one
CLEAR = object()  # instead of a command: a device clear
SILENT = [(POLL, 0), (CLEAR, None)]  # what follows a time-out

LONGEST_CALL_MS = 1500
BY_HAND = (b"XYZ", b"XXX")  # what a person sends
_FAILURES = {TIMEOUT: StatusCode.error_timeout, BUS_ERROR: StatusCode.error_connection_lost}


def is_documented(name: str, command: str) -> bool:
    """Whether what a driver sends stands in the table of its manual."""
    manual = manual_of(name)
    return manual is not None and manual.find(command) is not None


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


class ScriptedLibrary:
    """Reads bytes as they are: a reply that is a list of chunks comes in as many calls."""

    def __init__(self, resource: "ScriptedResource") -> None:
        self._resource = resource

    def read(self, session: int, count: int) -> tuple[bytes, StatusCode]:
        assert session == self._resource.session
        assert self._resource.read_termination is None, "a line feed inside a block would end it"
        chunk, last = self._resource.next_chunk()
        assert len(chunk) <= count
        return chunk, StatusCode.success if last else StatusCode.success_max_count_read


class ScriptedResource:
    """Stands for a MessageBasedResource."""

    resource_name, encoding = "GPIB0::4::INSTR", "ascii"
    session = 7

    def __init__(self, pairs: Sequence[tuple[Any, Any]]) -> None:
        self.events = flatten(pairs)
        self.write_termination = "\r\n"
        self.read_termination: str | None = None
        self.timeout: float | None = 2000
        self.timeouts_ms: list[float] = []
        self.closed = False
        self.visalib = ScriptedLibrary(self)

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
        if isinstance(reply, list):
            pytest.fail(f"{reply!r} is due in parts, but was read as text")
        if reply in _FAILURES:
            raise VisaIOError(_FAILURES[reply])
        text = reply.decode(self.encoding)
        if not (self.read_termination and text.endswith(self.read_termination)):
            pytest.fail(f"the script's reply {text!r} has no terminator")
        return text.removesuffix(self.read_termination)

    def next_chunk(self) -> tuple[bytes, bool]:
        """The next bytes of a reply, and whether they are its last."""
        chunks = self._next("read")
        self._note_limit()
        if not isinstance(chunks, list):
            chunks = [chunks]
        if chunks[0] in _FAILURES:
            raise VisaIOError(_FAILURES[chunks[0]])
        if chunks[1:]:
            self.events.insert(0, ("read", chunks[1:]))
        return chunks[0], not chunks[1:]

    @contextmanager
    def ignore_warning(self, session: int, *warnings: StatusCode) -> Iterator[None]:
        assert session == self.session
        assert warnings
        yield

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
    for kind, content in resource.events:
        if kind == "write" and isinstance(content, bytes) and not content.startswith(BY_HAND):
            assert is_documented(name, content.decode("latin-1")), f"{content!r} is not in instruments/{name}.yaml"
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


@contextmanager
def refused(code: str, match: str | None = None) -> Iterator[pytest.ExceptionInfo[InstrumentError]]:
    """Expect an InstrumentError with exactly this code, and with what ``match`` finds in its text."""
    with pytest.raises(InstrumentError, match=match) as caught:
        yield caught
    assert caught.value.code == code
