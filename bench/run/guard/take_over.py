"""Taking a bench over from a guard that still tries to make it safe: a file beside its diary, in the session."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.errors import InputError
from bench.model.posix import user_name

TAKE_OVER = "guard.take_over"  # in the folder of a session


@dataclass(frozen=True)
class Request:
    """Who wants the bench."""

    by: str


def take_over_request(folder: Path) -> Request | None:
    """Return the request that lies in the folder of a session, and take it away; None without one."""
    path = folder / TAKE_OVER
    try:
        by = str(json.loads(path.read_bytes())["by"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    with suppress(OSError):
        path.unlink()
    return Request(by)


def ask_to_let_go(holder: Mapping[str, Any]) -> None:
    """Ask the guard that holds a bench to let it go, in the name of this user.

    Args: holder: what the lock says of the guard. Raises: InputError B-RUN-097 where this user may not write.
    """
    path = Path(str(holder.get("folder", ""))) / TAKE_OVER
    draft = path.with_suffix(".draft")
    try:
        draft.write_text(json.dumps({"by": user_name()}), encoding="utf-8")
        draft.rename(path)
    except OSError as error:
        raise InputError(
            "B-RUN-097",
            f"the bench cannot be taken over from the guard of {holder.get('session', 'a session')}: {error.strerror}",
            where=str(path.parent),
            next_step=f"do it as {holder.get('user', 'the user of that run')}, on {holder.get('host', 'its machine')}",
        ) from error
