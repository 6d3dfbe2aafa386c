"""Requests of a page to a run: the fields of a command, checked; and the requests sent already, so that nothing is done
twice.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from starlette.requests import Request

from bench.web.security.logins import Login
from bench.web.security.refusal import Refusal

COMMANDS = ("pause", "resume", "abort", "acknowledge", "answer")
NEED_REASON = ("pause", "abort")
LONGEST_REASON = 500
LONGEST_ID = 64
LONGEST_NAME = 200  # of an alarm, a prompt, a run
LARGEST_VALUE = 1e15
_BLANKS = re.compile("[\u00a0\u2000-\u200a\u202f\u3000]+")  # hard and wide ones, as a paste or an input method makes
MOST_KEPT = 1000


@dataclass(frozen=True)
class Command:
    """One command; ``words`` is what the run is told besides who asks."""

    id: str
    run: str
    name: str
    reason: str
    words: dict[str, Any]


async def json_object(request: Request) -> dict[str, Any]:
    """Return the body as a JSON object; empty if it is no object, which no command is."""
    try:
        document = json.loads(await request.body())
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def command_of(document: dict[str, Any]) -> Command:
    """Raises: Refusal B-WEB-017 naming the field that is wrong."""
    if not document:
        raise _wrong("the body is no JSON object")
    command = document.get("command")
    if command not in COMMANDS:
        raise _wrong(f"{str(command)[:40]!r} is no command; known: {', '.join(COMMANDS)}")
    reason = _text(document, "reason", LONGEST_REASON, empty=command not in NEED_REASON)
    words: dict[str, Any] = {"command": command, "reason": reason}
    if command == "acknowledge":
        words["alarm"] = _text(document, "alarm", LONGEST_NAME)
    if command == "answer":
        words |= {"prompt": _text(document, "prompt", LONGEST_NAME), "value": _value(document)}
    return Command(_text(document, "id", LONGEST_ID), _text(document, "run", LONGEST_NAME), command, reason, words)


def taken(document: dict[str, Any]) -> bool:
    """Return whether the command is to be taken or given up. Raises: Refusal B-WEB-017."""
    take = document.get("take")
    if not isinstance(take, bool):
        raise _wrong("take: true or false is due")
    return take


def _text(document: dict[str, Any], key: str, longest: int, *, empty: bool = False) -> str:
    value = document.get(key, "")
    text = _BLANKS.sub(" ", value).strip() if isinstance(value, str) else None
    if text is None or len(text) > longest or not (text or empty) or not text.isprintable():
        need = "a line" if empty else "a line that is not empty,"
        raise _wrong(f"{key}: {need} of at most {longest} characters is due")
    return text


def _value(document: dict[str, Any]) -> float | str | bool | None:
    value = document.get("value")
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int | float):
        if not abs(value) <= LARGEST_VALUE:  # NaN, and whole numbers that no float holds, too
            raise _wrong("value: a finite number is due")
        return value
    return _text(document, "value", LONGEST_REASON, empty=True)


def _wrong(what: str) -> Refusal:
    return Refusal(400, "B-WEB-017", what, next_step="docs/live-protocol.md has the fields of a command")


@dataclass(frozen=True)
class Sent:
    """A command and the reply that has come or will."""

    command: Command
    reply: asyncio.Task[dict[str, Any]]


class SentCommands:
    """Commands that went to a run and what it said, by login and id; the newest ``MOST_KEPT``."""

    def __init__(self) -> None:
        self._sent: OrderedDict[tuple[str, str], Sent] = OrderedDict()

    def known(self, who: Login, command: Command) -> Sent | None:
        """Return what was sent under this id. Raises: Refusal B-WEB-019 if it was another command."""
        sent = self._sent.get((who.id, command.id))
        if sent is not None and sent.command != command:
            raise Refusal(409, "B-WEB-019", "another command had this id", next_step="give each command its own id")
        return sent

    def keep(self, who: Login, command: Command, reply: asyncio.Task[dict[str, Any]]) -> None:
        """Keep a command whose reply is on its way; the oldest one that is answered goes."""
        self._sent[who.id, command.id] = Sent(command, reply)
        if len(self._sent) > MOST_KEPT:
            oldest = next((key for key, sent in self._sent.items() if sent.reply.done()), None)
            if oldest is not None:
                del self._sent[oldest]
