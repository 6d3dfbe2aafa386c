"""``bench recover``: what a damaged session still holds."""

from __future__ import annotations

import json
from pathlib import Path

from bench.commands.console import console
from bench.model.errors import ExitStatus
from bench.record.recover import recover_session


def recover(session: Path, as_json: bool) -> int:
    """List damage and what is whole; exit status 5 when anything is damaged."""
    found = recover_session(session)
    if as_json:
        print(json.dumps(found.as_json(), indent=1))  # noqa: T201
    else:
        for line in found.lines():
            console().print(line)
    return ExitStatus.SESSION_DAMAGED if found.damaged else ExitStatus.PASS
