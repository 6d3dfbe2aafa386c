"""SCPI front end of live instruments: header matching, compound messages, error queue, IEEE-488.2 common commands."""

from __future__ import annotations

import contextlib
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, ClassVar, TypeVar

from bench.model.clock import NS
from sim_instruments.bus.kept import Setting, settings_of
from sim_instruments.bus.live import CommandDevice, CommandError

UNDEFINED_HEADER = (-113, "Undefined header")
MISSING_PARAMETER = (-109, "Missing parameter")
BAD_NUMBER = (-104, "Data type error")
BAD_WORD = (-224, "Illegal parameter value")
SETTINGS_CONFLICT = (-221, "Settings conflict")
OUT_OF_RANGE = (-222, "Data out of range")
QUEUE_OVERFLOW = (-350, "Queue overflow")
QUERY_INTERRUPTED = (-410, "Query INTERRUPTED")
QUERY_UNTERMINATED = (-420, "Query UNTERMINATED")

INVALID_SUFFIX = (-131, "Invalid suffix")
SUFFIX_NOT_ALLOWED = (-138, "Suffix not allowed")

ERROR_AVAILABLE = 4
EVENT_SUMMARY = 32
_EVENT_BIT = {1: 32, 2: 16, 3: 8, 4: 4}  # hundreds of a SCPI error number -> bit of the event status register

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?)\s*([A-Z%]*)")
_MULTIPLIERS = {"": 1.0, "G": 1e9, "MA": 1e6, "K": 1e3, "M": 1e-3, "U": 1e-6, "N": 1e-9, "P": 1e-12}

Method = TypeVar("Method", bound=Callable[..., Any])
Answers = Mapping[str, Callable[[Any], str]]
Handler = Callable[[str], str | None]
Handlers = Mapping[str, Handler]


class ScpiError(CommandError):
    """An error that goes into the instrument's queue; ``args`` are its number and text."""


def command(pattern: str) -> Callable[[Method], Method]:
    """Declare a method as the handler of a SCPI header such as ``[:SENSe]:FREQuency:GATE:TIME?``.

    The method gets the parameter text and returns the reply (None for a command without one). Several may be stacked.
    """

    def mark(method: Method) -> Method:
        patterns = getattr(method, "_scpi_patterns", ())
        method._scpi_patterns = (*patterns, pattern)  # type: ignore[attr-defined]
        return method

    return mark


def header_expression(pattern: str) -> re.Pattern[str]:
    """Return the expression of a header pattern: short and long form of each node, optional nodes in brackets.

    Source: SCPI-99 vol. 1, 6.2.5 (forms of a node) and 6.2.5.2 (a numeric suffix that is left out is 1).
    """
    if pattern.startswith("*"):
        return re.compile(re.escape(pattern))
    parts = []
    for node in re.findall(r"\[:?[A-Za-z]+\d*\]|:?[A-Za-z]+\d*|\?", pattern):
        if node == "?":
            parts.append(r"\?")
            continue
        name, digits = re.fullmatch(r"([A-Za-z]+)(\d*)", node.strip("[]:")).groups()  # type: ignore[union-attr]
        short = "".join(letter for letter in name if letter.isupper())
        suffix = "1?" if digits in ("", "1") else digits  # a node without a suffix is the first one
        text = f":(?:{short}|{name.upper()}){suffix}"
        parts.append(f"(?:{text})?" if node.startswith("[") else text)
    return re.compile("".join(parts))


def words(text: str) -> list[str]:
    """Return the parameters of a command, separated by commas that stand outside parentheses and quotes."""
    parts = re.findall(r"""(?:\([^)]*\)|"[^"]*"|'[^']*'|[^,])+""", text)
    return [part.strip() for part in parts]


def _multiplier(suffix: str, unit: str) -> float:
    """Return what the suffix of a number multiplies it by. Raises: ScpiError for a suffix that is not of the unit.

    Source: IEEE 488.2-1992, 7.7.3 (MA is mega, but for hertz and ohm, where M is).
    """
    if not suffix:
        return 1.0
    if not unit:
        raise ScpiError(*SUFFIX_NOT_ALLOWED)
    if not suffix.endswith(unit) or (prefix := suffix.removesuffix(unit)) not in _MULTIPLIERS:
        raise ScpiError(*INVALID_SUFFIX)
    return 1e6 if prefix == "M" and unit in ("HZ", "OHM") else _MULTIPLIERS[prefix]


class ScpiDevice(CommandDevice):
    """A SCPI instrument: one reply per message, real error queue, ``*OPC?`` waits for what is pending.

    ``answers`` are those that its state alone gives, by the header of the question; ``settings`` is the table
    (``sim_instruments.bus.kept``) of what needs no more than to be held.
    """

    answers: ClassVar[Answers] = {}
    settings = ""
    no_error = '+0,"No error"'
    scpi_version = "1999.0"
    error_format = '{0:+d},"{1}"'
    queue_length = 20

    def power_up(self) -> None:
        super().power_up()
        self.errors: deque[tuple[int, str]] = deque()
        self.event_status = 128  # power on
        self.busy_until_ns = 0
        self._restore(settings_of(_SETTINGS))
        self._handlers = self._declared()
        self._known: dict[str, Handler | None] = {}
        self._reset("")

    # --- for models --------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Bring the settings to the power-on (and ``*RST``) state."""

    def restore(self, *attributes: str) -> None:
        """Bring what these attributes hold to what it is after ``*RST``."""
        self._restore(setting for setting in settings_of(self.settings) if setting.attribute in attributes)

    def _restore(self, settings: Iterable[Setting]) -> None:
        for setting in settings:
            if setting.default is not None:
                setting.hold(self, setting.default)

    def error(self, number: int, text: str) -> None:
        """Append to the error queue; the last place becomes 'queue overflow' when it is full."""
        self.event_status |= _EVENT_BIT.get(-number // 100, 8)
        if len(self.errors) >= self.queue_length:
            self.errors[-1] = QUEUE_OVERFLOW
        else:
            self.errors.append((number, text))

    def number(self, text: str, low: float, high: float, unit: str = "", **names: float) -> float:
        """Return a numeric parameter inside [low, high]; MIN, MAX and the given names stand for values.

        With a ``unit`` the number may carry it, with a multiplier before it: ``1 kHz``.
        """
        word = text.strip().upper()
        named = {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high} | names
        if word in named:
            return named[word]
        if not word:
            raise ScpiError(*MISSING_PARAMETER)
        if word in ("NAN", "INF", "NINF", "INFINITY"):
            raise ScpiError(*OUT_OF_RANGE)
        match = _NUMBER.fullmatch(word)
        if match is None:
            raise ScpiError(*BAD_NUMBER)
        value = float(match[1]) * _multiplier(match[2], unit.upper())
        if not low <= value <= high:
            raise ScpiError(*OUT_OF_RANGE)
        return value

    def word(self, text: str, *allowed: str) -> str:
        """Return the short form of one of the allowed words, given as long forms with the short one in capitals."""
        word = text.strip().strip("\"'").upper()
        for choice in allowed:
            short = "".join(letter for letter in choice if not letter.islower())
            if word in (short, choice.upper()):
                return short
        raise ScpiError(*(BAD_WORD if word else MISSING_PARAMETER))

    def boolean(self, text: str) -> bool:
        """Return whether it is ON or a number that rounds to another one than 0. Source: SCPI-99 vol. 1, 7.3."""
        with contextlib.suppress(ValueError):
            return round(float(text)) != 0
        return self.word(text, "ON", "OFF") == "ON"

    def busy(self, seconds: float) -> None:
        """Let something overlapped go on for that long; ``*OPC?`` waits for it."""
        self.busy_until_ns = max(self.busy_until_ns, self.now_ns + round(seconds * NS))

    # --- messages ----------------------------------------------------------------------------------------------

    def execute(self, message: str) -> None:
        self._path = ""
        super().execute(message)

    def carry_out(self, command: str) -> str | None:
        header, _, parameters = command.partition(" ")
        if not header:
            return None
        handler, self._path = self._find(header, self._path)
        if handler is None:
            raise ScpiError(*UNDEFINED_HEADER)
        return handler(parameters.strip())

    def _find(self, header: str, path: str) -> tuple[Handler | None, str]:
        """Return the handler of a header and the node path the next header of the same message continues from."""
        name = header.upper()
        if name[0] in "*:" or not path:
            absolute = name if name[0] in "*:" else ":" + name
            return self._handler(absolute), path if name[0] == "*" else absolute.rpartition(":")[0]
        handler = self._handler(f"{path}:{name}")
        if handler is not None:
            return handler, f"{path}:{name}".rpartition(":")[0]
        return self._handler(":" + name), (":" + name).rpartition(":")[0]

    def _handler(self, name: str) -> Handler | None:
        try:
            return self._known[name]
        except KeyError:
            handler = next((method for expression, method in self._handlers if expression.fullmatch(name)), None)
            self._known[name] = handler
            return handler

    def further(self) -> Handlers:
        """Return handlers of headers that are alike, which no method declares one by one."""
        return {}

    def _apply(self) -> None:
        """Act on what is set."""

    def _declared(self) -> list[tuple[re.Pattern[str], Handler]]:
        handlers: dict[str, Handler] = {
            pattern: getattr(self, attribute)
            for attribute in sorted(dir(type(self)))
            for pattern in getattr(getattr(type(self), attribute), "_scpi_patterns", ())
        }
        for setting in settings_of(_SETTINGS) + settings_of(self.settings):
            header = setting.header.removesuffix("?")
            if header == setting.header:
                handlers[header] = partial(self._hold, setting)
            if setting.form != "-":
                handlers[f"{header}?"] = partial(self._tell, setting)
        handlers |= {pattern: partial(self._told, tell) for pattern, tell in {**_ANSWERS, **self.answers}.items()}
        handlers |= self.further()
        return [(header_expression(pattern), handler) for pattern, handler in handlers.items()]

    def _hold(self, setting: Setting, text: str) -> None:
        setting.hold(self, setting.read(self, text))
        if setting.applied:
            self._apply()

    def _tell(self, setting: Setting, text: str) -> str:
        """Tell a setting; ``MIN`` and ``MAX`` behind the question ask for the limits of a number."""
        if text and setting.limited:
            return setting.form.format(setting.read(self, text))
        return setting.tell(self)

    def _told(self, tell: Callable[[Any], str], _: str) -> str:
        return tell(self)

    # --- bus events --------------------------------------------------------------------------------------------

    def on_interrupted(self) -> None:
        self.error(*QUERY_INTERRUPTED)

    def on_starved(self) -> None:
        if not self.faults.mute:
            self.error(*QUERY_UNTERMINATED)

    def status_byte(self) -> int:
        """Bit 2: an error is queued, bit 4: a reply is ready, bit 5: enabled event, bit 6: service requested."""
        status = super().status_byte() | (ERROR_AVAILABLE if self.errors else 0)
        status |= EVENT_SUMMARY if self.event_status & self.event_enable else 0
        return status | (64 if status & self.service_enable else 0)

    # --- commands every model has ------------------------------------------------------------------------------

    @command("*RST")
    def _reset(self, _: str) -> None:
        self._restore(settings_of(self.settings))
        self.reset()

    @command("*CLS")
    def _clear_status(self, _: str) -> None:
        self.errors.clear()
        self.event_status = 0

    @command("*OPC?")
    def _complete(self, _: str) -> str:
        self._wait("")
        return "1"

    @command("*OPC")
    def _operation_complete(self, _: str) -> None:
        self.event_status |= 1

    @command("*TRG")
    def _bus_trigger(self, _: str) -> None:
        self.trigger()

    @command("*WAI")
    def _wait(self, _: str) -> None:
        self.reply_at(self.busy_until_ns)

    @command(":SYSTem:ERRor[:NEXT]?")
    def _next_error(self, _: str) -> str:
        if not self.errors:
            return self.no_error
        return self.error_format.format(*self.errors.popleft())


_ANSWERS: Answers = {  # of every model
    "*IDN?": lambda self: self.told_identity,
    "*STB?": lambda self: str(self.status_byte()),
    "*ESR?": lambda self: self.read_out("event_status"),
}
_SETTINGS = """
*ESE             | event_enable   | 0 | 0 255
*SRE             | service_enable | 0 | 0 255
*PSC             |                | ON
*TST?            |                | 0
*OPT?            |                | 0
:SYSTem:VERSion? | scpi_version   | -
"""
