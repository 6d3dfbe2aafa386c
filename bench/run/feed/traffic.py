"""The instrument panel: last command and reply of every instrument, how long it took to answer, and its error queue."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

LONGEST_TEXT = 200
_NUMBER = re.compile(r"\s*([+-]?\d+)")
# Questions for the error queue or the standing faults, as the drivers ask them; a reply of 0 says that all is well.
QUEUE_QUESTIONS = frozenset({"SYST:ERR?", "FAULT?", "ERRSTR?", "ALRM1?"})


@dataclass
class _Line:
    driver: str | None = None
    resource: str | None = None
    identity: str | None = None
    command: str | None = None
    reply: str | None = None
    t_utc_s: float | None = None
    sent_utc_s: float | None = None
    answer_ms: float | None = None
    error: str | None = None
    errors: int = 0
    state: Literal["ok", "away", "error"] = "ok"


class InstrumentPanel:
    """One line for each instrument, by role; fed with every command and reply.

    ``errors`` counts the entries of the error queue that were not "no error". ``state``: "error" from such an entry (or
    an event ``error`` of the role) until the queue is found empty again, "away" while the run waits for the instrument.
    """

    def __init__(self, identities: Mapping[str, Any], places: Mapping[str, tuple[str, str]]) -> None:
        self._lines: dict[str, _Line] = {}
        for role in [*places, *(role for role in identities if role not in places)]:
            driver, resource = places.get(role, (None, None))
            self._lines[role] = _Line(driver, resource, _identity(identities.get(role)))

    def on_traffic(self, role: str, direction: str, text: str, t_utc_s: float) -> None:
        """A command to ("tx") or a reply of ("rx") an instrument."""
        line = self._lines.setdefault(role, _Line())
        line.t_utc_s = t_utc_s
        text = text.strip()
        if direction == "tx":
            line.command, line.reply, line.sent_utc_s, line.answer_ms = text[:LONGEST_TEXT], None, t_utc_s, None
            return
        line.reply = text[:LONGEST_TEXT]
        if line.sent_utc_s is not None:
            line.answer_ms, line.sent_utc_s = round(max(0.0, t_utc_s - line.sent_utc_s) * 1e3, 3), None
        if line.command is not None and line.command.lstrip(":") in QUEUE_QUESTIONS:
            _judge(line)

    def trouble(self, role: str, text: str) -> None:
        """An instrument did not do what it was asked to."""
        if role in self._lines:
            self._lines[role].error, self._lines[role].state = text[:LONGEST_TEXT], "error"

    def away(self, roles: frozenset[str]) -> None:
        """The instruments that the run waits for; the others are there."""
        for role, line in self._lines.items():
            if role in roles:
                line.state = "away"
            elif line.state == "away":
                line.state = "ok"

    @property
    def roles(self) -> tuple[str, ...]:
        """Every instrument that is known."""
        return tuple(self._lines)

    def documents(self) -> dict[str, dict[str, Any]]:
        """Return all lines, as part of the state document."""
        return {role: _document(line) for role, line in self._lines.items()}


def _document(line: _Line) -> dict[str, Any]:
    return {name: value for name, value in vars(line).items() if name != "sent_utc_s"}


def _judge(line: _Line) -> None:
    match = _NUMBER.match(line.reply or "")
    if match is None:
        return
    if int(match[1]) == 0:
        line.state = "ok" if line.state == "error" else line.state
    else:
        line.errors += 1
        line.error, line.state = line.reply, "error"


def _identity(identity: Any) -> str | None:
    if not isinstance(identity, Mapping):
        return None if identity is None else str(identity)
    words = (identity.get("manufacturer"), identity.get("model"), identity.get("serial"), identity.get("firmware"))
    return " ".join(str(word) for word in words if word) or None
