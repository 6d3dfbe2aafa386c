"""Exchanges with a driver as rows of a table: what it is told, what goes over the bus for that, what comes of it."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from known_drivers import IDENTIFY, MAKE_SAFE
from scripted import BUS_ERROR, CLEAR, POLL, READ, SILENT, TIMEOUT, refused, scripted

ANYTHING = object()
FAILURES = {"<timeout>": TIMEOUT, "<bus error>": BUS_ERROR}
NOTHING_WRONG = {
    "fluke_5720a": "FAULT? -> 0",
    "hp_3458a": 'ERRSTR? -> 0,"NO ERROR"',
    "thermotron_3800": "ALRM1? -> 0",
    "acutrol_3000": "*STB? -> 0",
    "srs_sr830": "*ESR? -> 0 | ERRS? -> 0",
}
FRAMES = {"leica_nivel_220": "\x16\x02N1C1 {}\x03\r\n"}
ENDS = {"leica_nivel_220": "\r\n", "hp_3458a": "\r\n"}


def exchange(name: str, script: str) -> list[tuple[Any, Any]]:
    """Return the pairs of a script for ``scripted``; `` | `` stands between its events.

    ``COMMAND``; ``COMMAND!``, after which nothing is wrong; ``QUESTION -> REPLY``; ``QUESTION ~> REPLY``, which is
    polled for and there at the second look. ``<start>`` and ``<safe>`` are those of ``known_drivers``, ``<start:3>``
    the first three pairs; ``<ok>`` is the question for errors without an error. ``<clear>``, ``<poll 16>``,
    ``<read> REPLY`` and ``<silent>`` are events of the bus, ``<timeout>`` and ``<bus error>`` may stand for a reply.
    """
    return [pair for event in script.split(" | ") if event for pair in _pairs(name, event)]


def _pairs(name: str, event: str) -> list[tuple[Any, Any]]:
    """Return the pairs of one event."""
    if event.startswith("<"):
        return _marked(name, *event.removeprefix("<").split(">", 1))
    if event.endswith("!"):
        return [*_pairs(name, event[:-1]), *_marked(name, "ok", "")]
    command, arrow, reply = event.partition(" -> ")
    if not arrow and " ~> " in event:
        command, _, reply = event.partition(" ~> ")
        return [(_command(name, command), None), (POLL, 0), (POLL, 16), (READ, _reply(name, reply))]
    return [(_command(name, command), _reply(name, reply) if arrow else None)]


def _marked(name: str, mark: str, rest: str) -> list[tuple[Any, Any]]:
    """Return the pairs that a mark stands for."""
    word, _, number = mark.replace(":", " ").partition(" ")
    pairs: dict[str, list[tuple[Any, Any]]] = {
        "start": IDENTIFY[name][: int(number) if number else None], "safe": MAKE_SAFE[name], "silent": SILENT,
        "clear": [(CLEAR, None)], "timeout": [(TIMEOUT, None)], "poll": [(POLL, int(number or 0))],
        "read": [(READ, _reply(name, rest.removeprefix(" ")))],
    }  # fmt: skip
    if word == "ok":
        return exchange(name, NOTHING_WRONG.get(name, 'SYST:ERR? -> +0,"No error"'))
    return pairs[word]


def _command(name: str, text: str) -> bytes:
    return FRAMES.get(name, "{}\n").replace("{}", text).encode("latin-1")


def _reply(name: str, text: str) -> Any:
    return FAILURES.get(text) or (text + ENDS.get(name, "\n")).encode("latin-1")


@dataclass(frozen=True)
class Call:
    """An action of a driver, and the value that it gives (of a dict some of it) or the error that it raises."""

    action: str
    arguments: tuple[Any, ...]
    value: Any = ANYTHING
    code: str = ""
    match: str = ""

    def on(self, driver: Any) -> None:
        """Do it and judge what comes of it."""
        with refused(self.code, self.match or None) if self.code else nullcontext():
            found = getattr(driver, self.action)(*self.arguments)
            if isinstance(self.value, dict):
                found = {key: found[key] for key in self.value}
            assert self.value is ANYTHING or found == self.value


def does(action: str, *arguments: Any) -> Call:
    """Return a call that raises nothing."""
    return Call(action, arguments)


def gives(value: Any, action: str, *arguments: Any) -> Call:
    """Return a call that returns a value."""
    return Call(action, arguments, value)


def refuses(code: str, match: str, action: str, *arguments: Any) -> Call:
    """Return a call that raises an error with this code and a text in which ``match`` is found."""
    return Call(action, arguments, code=code, match=match)


@dataclass(frozen=True)
class Row:
    """One exchange; ``leaves`` are members of the driver behind it."""

    name: str
    claim: str
    script: str
    calls: tuple[Call, ...]
    leaves: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def play(self) -> None:
        """Play it: every byte and every call must be as the row says, and nothing may be left."""
        with scripted(self.name, exchange(self.name, self.script), **self.options) as driver:
            for call in self.calls:
                call.on(driver)
            for member, value in self.leaves.items():
                found = attrgetter(member)(driver)
                assert (found() if callable(found) else found) == value, member


def row(name: str, claim: str, script: str, *calls: Call, leaves: dict[str, Any] | None = None, **options: Any) -> Row:
    """Return a row; ``options`` are those of the driver in a station."""
    return Row(name, claim, script, calls, leaves or {}, options)
