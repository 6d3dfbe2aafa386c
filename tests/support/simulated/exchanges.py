"""Exchanges with a driver as rows of a table: what it is told, what goes over the bus for that, what comes of it."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

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
BEFORE = {"hp_3458a": 2}  # commands that come before who it is
FRAMES = {"leica_nivel_220": "\x16\x02N1C1 {}\x03\r\n"}
ENDS = {"leica_nivel_220": "", "hp_3458a": "\r\n"}


def exchange(name: str, script: str) -> list[tuple[Any, Any]]:
    """Return the pairs of a script for ``scripted``; `` | `` stands between its events.

    ``COMMAND``; ``COMMAND!``, after which nothing is wrong; ``QUESTION -> REPLY``; ``QUESTION ~> REPLY``, which is
    polled for and there at the second look. ``<start>``, ``<who>`` (its question) and ``<safe>`` are those of this
    file, ``<start:3>`` the first three pairs; ``<ok>`` is the question for errors without one. ``<clear>``,
    ``<poll 16>``, ``<read> REPLY``, ``<silent>`` are events of the bus, ``<timeout>``, ``<bus error>`` may be replies.
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
        "who": IDENTIFY[name][: 1 + BEFORE.get(name, 0)],
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


def slow(command: bytes, *replies: bytes) -> list[tuple[Any, Any]]:
    """A question whose answer is polled for: there at the second look, each one that is given in turn."""
    return [pair for reply in replies for pair in ((command, None), (POLL, 0), (POLL, 16), (READ, reply))]


NO_ERROR = (b"SYST:ERR?\n", b'+0,"No error"\n')
END_ALWAYS = [(b"END ALWAYS;QFORMAT NORM\n", None)] * 2
NO_EVENT = [(b"*ESR?\n", b"0\n"), (b"ERRS?\n", b"0\n")]
CONTROLS = "\x16\x02\x03\r\n"  # what frames a telegram


def after(command: bytes, ok: tuple[bytes, bytes] = NO_ERROR) -> list[tuple[bytes, bytes | None]]:
    """A set command that is accepted."""
    return [(command, None), ok]


IDENTIFY = {
    "fluke_5720a": [
        (b"*IDN?\n", b"FLUKE,5720A,7005201,1.4+1.1+1.0\n"),
        (b"FAULT?\n", b"0\n"),
        (b"ISR?\n", b"4096\n"),
        (b"CUR_POST?\n", b"NORMAL\n"),
    ],
    "keithley_7002": [
        (b"*IDN?\n", b"KEITHLEY INSTRUMENTS INC.,MODEL 7002,0654321,B01 /A02\n"),
        NO_ERROR,
        *after(b":INIT:CONT OFF\n"),
        *after(b":ABOR\n"),
    ],
    "hp_3458a": [*END_ALWAYS, (b"ID?\n", b"HP3458A\r\n"), (b"ERRSTR?\n", b'0,"NO ERROR"\r\n')],
    "agilent_33250a": [(b"*IDN?\n", b"Agilent Technologies,33250A,0,2.01-1.01-2.00-03-2\n"), NO_ERROR],
    "agilent_53230a": [
        (b"*IDN?\n", b"Agilent Technologies,53230A,MY50001234,02.05-1519\n"),
        NO_ERROR,
        (b"*RST\n", None),
        NO_ERROR,
        (b"ROSC:SOUR EXT\n", None),
        NO_ERROR,
    ],
    "thermotron_3800": [(b"IDEN?\n", b"3800 REV 3\n"), (b"ALRM1?\n", b"0\n")],
    "hp_6632b": [
        (b"*IDN?\n", b"HEWLETT-PACKARD,6632B,US36001234,A.01.01\n"),
        NO_ERROR,
        (b"SENS:CURR:RANG 5;:SENS:SWE:TINT 15.6E-6;POIN 2048\n", None),
        NO_ERROR,
    ],
    "agilent_e3631a": [
        (b"*IDN?\n", b"HEWLETT-PACKARD,E3631A,0,1.4-5.0-1.0\n"),
        NO_ERROR,
        (b"OUTP:TRAC?\n", b"0\n"),
    ],
    "agilent_34970a": [
        (b"*IDN?\n", b"HEWLETT-PACKARD,34970A,0,13-2-2\n"),
        NO_ERROR,
        (b"INST:DMM?\n", b"1\n"),
        *after(b"ABOR\n"),
    ],
    "agilent_34401a": [(b"*IDN?\n", b"HEWLETT-PACKARD,34401A,0,10-5-2\n"), NO_ERROR],
    "pendulum_cnt_91": [
        *[(b"*IDN?\n", b"PENDULUM, CNT-91, 1234567, V1.01 28 Jun 2004\n"), NO_ERROR, (b"INIT:CONT?\n", b"0\n")]
    ],
    "acutrol_3000": [
        (b"*IDN?\n", b"ACUTRONIC,ACUTROL3000,1201,3.2\n"),
        (b"*STB?\n", b"0\n"),
        (b":util:form?\n", b"FLOAT\n"),
    ],
    "srs_sr830": [
        (b"OUTX 1;*IDN?\n", b"Stanford_Research_Systems,SR830,s/n48123,ver1.07\n"),
        *NO_EVENT,
    ],
    "krohn_hite_3988": [(b"V\n", b"KROHN-HITE V3.5\n")],
    "leica_nivel_220": [
        (b"\x16\x02N1C1 RB D\x03\r\n", b"\x16\x02C1N1 000005 1.0\x03"),
        *slow(b"\x16\x02N1C1 RS C\x03\r\n", b"\x02\xe7\x16\x02C1N1 ON\x03"),
        *slow(b"\x16\x02N1C1 RS M\x03\r\n", b"\x01\xb0\x16\x02C1N1 CONT\x03"),
        *slow(b"\x16\x02N1C1 R N\x03\r\n", b"\x16\x02C1N1 008\x03"),
    ],
}

_RATE_0 = ((b"dem:rate", b",0"), (b"mode:rate", b""))
_OUTPUT_OFF = [(b"OUTP OFF\n", None), NO_ERROR, (b"OUTP?\n", b"0\n")]

MAKE_SAFE = {
    "fluke_5720a": [(b"STBY\n", None), (b"FAULT?\n", b"0\n"), (b"ISR?\n", b"4096\n")],
    "keithley_7002": [(b":OPEN ALL\n", None), NO_ERROR, (b":CLOS:STAT?\n", b"(@)\n")],
    "hp_3458a": [(b"TRIG HOLD\n", None), (b"ERRSTR?\n", b'0,"NO ERROR"\r\n')],
    "agilent_33250a": _OUTPUT_OFF,
    "agilent_53230a": [(b"ABOR\n", None), NO_ERROR],
    "thermotron_3800": [(b"MODE?\n", b"2\n")],
    "hp_6632b": _OUTPUT_OFF,
    "agilent_e3631a": _OUTPUT_OFF,
    "agilent_34970a": [(b"ABOR\n", None), NO_ERROR],
    "agilent_34401a": [NO_ERROR],
    "pendulum_cnt_91": [(b"ABOR\n", None), NO_ERROR, (b"STAT:OPER:COND?\n", b"0\n")],
    "acutrol_3000": [
        *[(b":%s %d%s\n" % (what, axis, value), None) for axis in (3, 2, 1) for what, value in _RATE_0],
        (b":util:form float\n", None),
        *[(b":read:rate? %d\n" % axis, b"-0.0012\n") for axis in (3, 2, 1)],
        *[(b":int:open %d\n" % axis, None) for axis in (3, 2, 1)],
        (b"*STB?\n", b"0\n"),
        *[(b":int? %d\n" % axis, b"Open\n") for axis in (1, 2, 3)],
    ],
    "srs_sr830": NO_EVENT,
    "krohn_hite_3988": IDENTIFY["krohn_hite_3988"],
    "leica_nivel_220": IDENTIFY["leica_nivel_220"][:1],
}


def said(message: bytes) -> str:
    """A message as text, without its terminator and frame."""
    return message.decode().strip(CONTROLS)
