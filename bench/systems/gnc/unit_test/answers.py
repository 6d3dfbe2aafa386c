"""Questions to a module and its answers: the exchanges of a test item, decoded or with the reason why not."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bench.analysis import Estimates, estimate
from bench.model.errors import BenchError
from bench.systems.gnc.wording import say

if TYPE_CHECKING:
    from bench.analysis import Exchange

STATUS = ("PASS", "FAIL", "BUSY", "UNKNOWN_COMMAND", "BAD_PARAMETER", "HARDWARE_ERROR", "TIMEOUT")
_PASS = 0
# What a request says, read from its bytes: what is expected must not come from the side that made the request.
_REQUESTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "cpu": ("<I", ("seed",)),
    "timer": ("<IB", ("setting_us", "ticks")),
    "memory": ("<BBBII", ("region", "pattern", "operation", "start", "length")),
    "imu": ("<B", ("samples",)),
    "gps": ("", ()),
    "ad": ("<B", ("dip",)),
    "io": ("<BBB", ("output", "input", "level")),
    "spi": ("<H", ("word",)),
    "sci": ("<", ("pattern",)),
    "can": ("<I", ("identifier", "pattern")),
}


@dataclass(frozen=True)
class Wrong:
    """One wrong result: what was sent, what should have come back, what came."""

    at_s: float
    what: str
    sent: str
    expected: str
    received: str


@dataclass
class Findings:
    """Judgement on the exchanges of one item of one unit; ``remarks`` are reported and never judged."""

    wrong: list[Wrong] = field(default_factory=list)
    measured: Estimates = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def expect(self, ok: bool, answer: Answer, what: str, expected: object, received: object) -> None:
        """Note a wrong result unless ``ok``."""
        if not ok:
            sent = answer.exchange.sent.hex(" ")
            self.wrong.append(Wrong(answer.exchange.begin_s, what, sent, _text(expected), _text(received)))

    def measure(
        self,
        quantity: str,
        unit: str,
        value: float,
        std_uncertainty: float = 0.0,
        conditions: Mapping[str, Any] | None = None,
        limit: float | None = None,
        n: int = 1,
    ) -> None:
        """Note a value that a test gives beside its verdict; ``limit`` None: not judged."""
        self.measured.append(estimate(quantity, unit, value, std_uncertainty, conditions or {}, n=n, limit=limit))

    def missing(self, at_s: float, what: str) -> None:
        """Note a piece of the item that was never asked for: the item cannot pass without it."""
        self.wrong.append(
            Wrong(at_s, say("wrong.untested", what=what), say("nothing"), say("wrong.a_test"), say("nothing"))
        )


@dataclass(frozen=True)
class Answer:
    """An exchange with what its request says and the fields of its answer; ``trouble`` says why there are none."""

    exchange: Exchange
    asked: Mapping[str, Any]
    fields: Mapping[str, Any]
    trouble: str = ""


def _text(value: object) -> str:
    return value if isinstance(value, str) else str(value)  # str() of a sentence forgets its key


def answers_of(exchanges: Iterable[Exchange], layouts: Mapping[str, Any]) -> list[Answer]:
    """Return every exchange, decoded by the layout of its command."""
    return [_answer(exchange, layouts) for exchange in exchanges]


def whole(answers: Sequence[Answer], findings: Findings) -> list[Answer]:
    """The answers that can be judged; the others go into ``findings`` with their reason."""
    for answer in answers:
        if answer.trouble:
            received = answer.exchange.received.hex(" ") or say("nothing")
            findings.expect(False, answer, answer.trouble, say("wrong.an_answer"), received)
    return [answer for answer in answers if answer.fields or not answer.trouble]


def _answer(exchange: Exchange, layouts: Mapping[str, Any]) -> Answer:
    asked = asked_of(exchange)
    trouble = _trouble(exchange)
    if exchange.refused or exchange.status not in (0, 1):
        return Answer(exchange, asked, {}, trouble)
    layout = layouts.get(exchange.name)
    if layout is None:
        return Answer(exchange, asked, {}, say("wrong.no_command", name=exchange.name))
    try:
        return Answer(exchange, asked, layout.decode(exchange.received), trouble)
    except BenchError as error:
        return Answer(exchange, asked, {}, f"{error.message} ({error.code})")


def _trouble(exchange: Exchange) -> str:
    if exchange.status is None:
        return say("wrong.no_answer", attempts=exchange.attempts)
    status = STATUS[exchange.status] if exchange.status < len(STATUS) else str(exchange.status)
    if exchange.refused:
        return say("wrong.refused", status=status)
    return "" if exchange.status == _PASS else say("wrong.status", status=status)


def asked_of(exchange: Exchange) -> dict[str, Any]:
    """Return fields of a request; {} if it is not as long as it must be (the board refuses such a one)."""
    form, names = _REQUESTS.get(exchange.name, ("", ()))
    size = struct.calcsize(form)
    head = names[:-1] if names[-1:] == ("pattern",) and exchange.name != "memory" else names
    if len(exchange.sent) < size or (head == names and len(exchange.sent) != size):
        return {}
    fields = dict(zip(head, struct.unpack(form, exchange.sent[:size]), strict=True))
    return fields if head == names else fields | {"pattern": exchange.sent[size:].hex()}
