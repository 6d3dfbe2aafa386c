"""How a session ended for which nobody answers any more, from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.model.errors import BenchError
from bench.record import SessionReader
from bench.record.writer import OPEN_MARKER


def ending(folder: Path) -> Mapping[str, Any] | None:
    """``{"outcome": ...}`` of the state document; None while the recorder has the session open, or died with it.

    The outcome is null if the session does not say how it ended.
    """
    if (folder / OPEN_MARKER).exists() or not folder.is_dir():
        return None
    try:
        return {"outcome": _outcome(folder)}
    except (BenchError, OSError):
        return {"outcome": None}


def _outcome(folder: Path) -> Mapping[str, Any] | None:
    found: Mapping[str, Any] | None = None
    text = ""
    for kind, _, fields in SessionReader(folder).events():
        if kind == "error":
            text = str(fields.get("text", ""))
        elif kind == "resume":
            found = None
        elif kind == "end":
            code = fields.get("error")
            found = {"error": code, "text": text if code else ""}
    return found
