"""A VISA resource before an instrument that was written from its manual: no driver, simulator or table was looked at.

An instrument is its rows, every setting of its preset and status tables that changes a reading, an output or a reply,
with what a last user may leave; its physics says what they do. What neither a row nor a table has is refused.
"""

from __future__ import annotations

import random
import re
from ast import literal_eval
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from string import ascii_lowercase
from typing import Any, ClassVar, NamedTuple

from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError

from bench.model.clock import VirtualClock, to_ns

NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?)\s*([A-Z]*)\s*$", re.IGNORECASE)
BLOCKS = (Path(__file__).parent / "settings.txt").read_text(encoding="utf-8").strip().split("\n\n")
SETTINGS = {block.split("\n")[0]: block.split("\n")[1:] for block in BLOCKS}
Table = dict[str, Callable[[Any, list[str]], Any]]  # what a command does, by its header


class Row(NamedTuple):
    """A setting. ``header`` in SCPI notation ("" has no command); ``domain`` "bool", "num", "int", "raw" or words.

    ``left``: as a last user may leave it. ``names``: what a refusal says that names it. ``reset``: *RST presets it.
    """

    header: str
    key: str
    domain: str
    preset: Any
    left: tuple[Any, ...] = ()
    names: str = ""
    reset: bool = True


class State(dict[str, Any]):
    """The settings by their keys, and each as an attribute."""

    __getattr__, __setattr__ = dict.__getitem__, dict.__setitem__  # type: ignore[assignment]


def settings_of(instrument: str) -> tuple[Row, ...]:
    """The rows of an instrument in settings.txt; none of one that is not in it."""
    rows: list[Row] = []
    for line in SETTINGS.get(instrument, ()):
        key, header, domain, preset, left, names, kept = [cell.strip() for cell in (line + ";" * 6).split(";")][:7]
        row = Row(header, key, domain, preset and literal_eval(preset), literal_eval(f"({left},)") if left else ())
        rows += [row._replace(names=names, reset=not kept)] if preset else settings_of(key)
    return tuple(rows)


class Refused(Exception):
    """The instrument refuses a command: an entry of its error queue."""


def word(name: str) -> str:
    """The pattern of a SCPI word: its capitals alone, or all of it."""
    stem = name.rstrip(ascii_lowercase)
    return re.escape(stem) + (f"(?:{name[len(stem) :].upper()})?" if len(stem) < len(name) else "")


@lru_cache(maxsize=1000)
def pattern(header: str) -> re.Pattern[str]:
    """The pattern of a SCPI header: [optional] nodes, short or long words."""
    nodes = re.findall(r"\[[^]]+\]|[^:\[\]]+", header)
    parts = (f"(?::?{word(node.strip('[]:'))})" + "?" * (node[0] == "[") for node in nodes)
    return re.compile("".join(parts) + r"\Z", re.IGNORECASE)


def number(text: str) -> float:
    """A number, its unit aside. Raises: Refused."""
    if (found := NUMBER.match(text)) is None:
        raise Refused('-104,"Data type error"')
    return float(found[1])


class Rack:
    """An instrument. Its exchange of messages is that of IEEE 488.2: a reply that nobody took is lost with an error."""

    identity = ""
    rows: ClassVar[tuple[Row, ...]] = ()
    asks: ClassVar[Table] = {
        "*IDN": lambda unit, a: unit.identity, "*OPC": lambda unit, a: "1",
        "SYSTem:ERRor": lambda unit, a: unit.next_error(),
    }  # fmt: skip
    tells: ClassVar[Table] = {
        "*CLS": lambda unit, a: unit.errors.clear(), "*RST": lambda unit, a: unit.reset(), "*WAI": lambda unit, a: None,
    }  # fmt: skip
    end, depth, error_bit, is_tree = "\n", 20, 4, True
    no_error, overflow = '+0,"No error"', '-350,"Queue overflow"'
    unknown, unread, unasked = '-113,"Undefined header"', '-410,"Query INTERRUPTED"', '-420,"Query UNTERMINATED"'
    resource_name, session = "GPIB0::4::INSTR", 7

    def __init_subclass__(cls) -> None:
        cls.rows = settings_of(cls.__name__)

    def __init__(self, clock: VirtualClock, seed: int) -> None:
        self.clock, self.draw = clock, random.Random(seed)
        self.write_termination, self.read_termination, self.timeout = "\r\n", None, 2000.0
        self.state = State({row.key: row.preset for row in self.rows})
        self.errors, self.sent = list[str](), list[str]()
        self.output: str | None = None
        self.partial, self.ready_ns = "", 0
        self.open = [self.draw.random() < 0.5 for _ in range(4)]  # what no manual says: both ways by seed
        share = self.draw.choice((0.0, 0.0, 0.08, 0.3, 0.8))
        alone = self.draw.choice([row for row in self.rows if row.left])  # nothing else hides what it does
        for row in self.rows:
            if row.left and (self.draw.random() < share or (not share and row is alone)):
                self.state[row.key] = self.draw.choice(row.left)
        if self.draw.random() < share:
            self.errors = ['-222,"Data out of range"'] * self.draw.choice((1, 3, self.depth))
        if self.draw.random() < share:
            self.output = self.draw.choice(("+1.00000000E+00", '-113,"Undefined header"', "STALE,REPLY"))
        if self.draw.random() < share / 4.0:
            self.partial = self.draw.choice(("VO", "*ID", ":SYST:ER"))
        self.legal()
        self.left = {row.key: self.state[row.key] for row in self.rows if self.state[row.key] != row.preset}

    def legal(self) -> None:
        """Undo combinations that the instrument does not take."""
        self.changed("")

    def is_named(self, text: str) -> bool:
        """Whether a refusal names a setting that was wrong."""
        names = (row.names for row in self.rows if row.key in self.left and row.names)
        return any(re.search(name, text, re.IGNORECASE) for name in names)

    @property
    def is_energised(self) -> bool:
        return bool(self.state.get("output"))

    def write(self, message: str) -> int:
        message += self.write_termination or ""
        self.sent.append(f"> {message.strip()}")
        text, self.partial = (self.partial + message).strip("\r\n"), ""
        if self.output is not None:
            self.output, self.ready_ns = None, 0
            self.fault(self.unread)
        self.take(text)
        return len(message)

    def take(self, text: str) -> None:
        path, replies = "", []
        if self.state.get("language", "SCPI") != "SCPI" and not re.match(r":?SYST(EM)?:LANG", text, re.IGNORECASE):
            return  # an error that the other language alone tells
        for command in filter(None, map(str.strip, text.split(";"))):
            whole = path + command if self.is_tree and command[0] not in ":*" else command
            if command[0] != "*":
                path = whole.split()[0].rpartition(":")[0] + ":" * (":" in whole.split()[0])
            try:
                replies.append(self.do(whole))
            except Refused as refusal:
                self.fault(str(refusal))
                break
        if replies := [reply for reply in replies if reply is not None]:
            self.output = ";".join(replies)

    def do(self, command: str) -> str | None:
        head, _, tail = command.partition(" ")
        arguments = [part.strip() for part in re.split(r",(?![^(]*\))", tail)] if tail.strip() else []
        is_question, head = head.endswith("?"), head.rstrip("?").lstrip(":")
        for header, act in (self.asks if is_question else self.tells).items():
            if pattern(header).match(head):
                reply: str | None = act(self, arguments)
                return reply
        for row in self.rows:
            if row.header and pattern(row.header).match(head):
                if is_question:
                    return self.reply(row, arguments)
                if not arguments:
                    raise Refused('-109,"Missing parameter"')
                return self.set(row, arguments)
        raise Refused(self.unknown)

    def set(self, row: Row, arguments: list[str]) -> None:
        self.state[row.key] = self.value(row, arguments[0])
        self.changed(row.key)

    def value(self, row: Row, text: str) -> Any:
        if row.domain in ("num", "int", "raw"):
            return {"num": number, "int": lambda text: int(number(text)), "raw": str}[row.domain](text)
        for choice in row.domain.replace("bool", "ON|1|OFF|0").split("|"):
            if re.fullmatch(word(choice), text.upper()):
                return text.upper() in ("ON", "1") if row.domain == "bool" else choice.rstrip(ascii_lowercase)
        raise Refused('-224,"Illegal parameter value"')

    def reply(self, row: Row, arguments: list[str]) -> str:
        return self.shown(row, self.state[row.key])

    def shown(self, row: Row, value: Any) -> str:
        return f"{value:+.10E}" if row.domain == "num" else str(int(value) if row.domain == "bool" else value)

    def changed(self, key: str) -> None:
        """What else a setting changes. Raises: Refused."""

    def reset(self) -> None:
        self.state |= {row.key: row.preset for row in self.rows if row.reset}
        self.changed("*RST")

    def fault(self, entry: str) -> None:
        self.errors = [*self.errors, entry] if len(self.errors) < self.depth else [*self.errors[:-1], self.overflow]

    def next_error(self) -> str:
        return self.errors.pop(0) if self.errors else self.no_error

    def after(self, seconds: float, output: str) -> str:
        """A reply that takes its time."""
        self.ready_ns = self.clock.now_ns() + to_ns(seconds)
        return output

    def time_out(self) -> VisaIOError:
        if self.output is None:
            self.fault(self.unasked)
        self.clock.sleep(self.timeout / 1000.0)
        self.sent.append("< time-out")
        return VisaIOError(StatusCode.error_timeout)

    def read(self) -> str:
        if self.output is None or self.ready_ns > self.clock.now_ns() + to_ns(self.timeout / 1000.0):
            raise self.time_out()
        self.clock.sleep_until_ns(self.ready_ns)
        text, self.output = self.output + self.end, None
        self.sent.append(f"< {text.strip()}")
        return text.removesuffix(self.read_termination or "\0")

    def read_stb(self) -> int:
        self.clock.sleep(0.001)
        is_there = self.output is not None and self.ready_ns <= self.clock.now_ns()
        return 16 * is_there + self.error_bit * bool(self.errors)

    def clear(self) -> None:
        self.sent.append("> device clear")
        self.output, self.partial, self.ready_ns = None, "", 0

    def close(self) -> None:
        """Let go of the session: nothing is held."""
