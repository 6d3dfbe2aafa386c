"""What was sent to runs already, so that nothing is done twice."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from bench.web.command_request import Command
from bench.web.cookie import Login
from bench.web.refusal import Refusal

MOST_KEPT = 1000


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
        """What was sent under this id. Raises: Refusal B-WEB-019 if it was another command."""
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
