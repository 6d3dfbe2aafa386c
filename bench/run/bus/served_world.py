"""The process that serves a simulated bench, asked through its control socket: one line of JSON there, one back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.model.errors import InputError
from bench.model.posix import unix_socket

PATIENCE_S = 10.0


def ask(path: Path, words: Sequence[str]) -> dict[str, Any]:
    """One request to the simulated bench whose control socket is at ``path``. Raises: InputError B-SIM-015."""
    try:
        with unix_socket() as control:
            control.settimeout(PATIENCE_S)
            control.connect(str(path))
            control.sendall(json.dumps({"words": list(words)}).encode() + b"\n")
            with control.makefile("rb") as stream:
                reply: dict[str, Any] = json.loads(stream.readline())
    except (OSError, ValueError) as error:
        message = f"no simulated bench answers: {error}"
        raise InputError("B-SIM-015", message, where=str(path), next_step="start one: bench sim STATION") from error
    return reply


def told(path: Path, words: Sequence[str]) -> dict[str, Any]:
    """As ``ask``; a reply that is an error is raised. Raises: InputError B-SIM-015, and the bench's own."""
    reply = ask(path, words)
    if "error" in reply:
        wrong = reply["error"]
        raise InputError(wrong["code"], wrong["message"], where=wrong["where"], next_step=wrong["next_step"])
    return reply
