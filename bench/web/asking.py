"""One request to the control socket of a run, without ever holding up the server."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from bench.run.control.local_socket import find_socket

ANSWER_S = 5.0
LONGEST_REPLY = 1 << 20


class NoAnswer(Exception):
    """Nobody is there, or whoever is there said nothing that is understood; ``sent``: the run may have heard it."""

    def __init__(self, why: str, sent: bool) -> None:
        super().__init__(why)
        self.sent = sent


async def ask_run(folder: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Send one request to the run of a session and return its reply. Raises: NoAnswer after 5 s at most."""
    sent = False
    try:
        async with asyncio.timeout(ANSWER_S):
            reader, writer = await asyncio.open_unix_connection(find_socket(folder), limit=LONGEST_REPLY)
            try:
                writer.write(json.dumps(request, ensure_ascii=False).encode() + b"\n")
                sent = True
                reply = json.loads(await reader.readline())
            finally:
                writer.close()
    except TimeoutError as error:
        raise NoAnswer(f"nothing came within {ANSWER_S:g} s", sent) from error
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise NoAnswer("no run of this session is alive", sent) from error
    except (OSError, ValueError) as error:
        raise NoAnswer(getattr(error, "strerror", None) or "the reply is none", sent) from error
    return reply if isinstance(reply, dict) else {}
