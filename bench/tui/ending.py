"""What a session for which nobody answers any more says from its folder: how it ended, and what its guard did."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.model.errors import BenchError
from bench.model.events import End, Error, Resume, event_of
from bench.record import OPEN_MARKER, SessionReader
from bench.run.guard.diary import read_diary

DIARY = "guard.jsonl"


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
    outcome: Mapping[str, Any] | None = None
    text = ""
    for kind, _, fields in SessionReader(folder).events():
        match event_of(kind, fields):
            case Error(text=said):
                text = said
            case Resume():
                outcome = None
            case End(error=code):
                outcome = {"error": code, "text": text if code else ""}
    return outcome


def guard_word(folder: Path) -> Mapping[str, Any] | None:
    """``{"reason", "safe": True, False or None (at it), "unsafe": roles}``; None if the guard did not act."""
    found: dict[str, Any] | None = None
    for entry in read_diary(folder / DIARY):
        what = entry.get("what")
        if what in ("ready", "dismissed"):
            found = None
        elif what == "act":
            found = {"reason": str(entry.get("text", "")), "safe": None, "unsafe": []}
        elif what in ("safe", "unsafe") and found is not None:
            found |= {"safe": what == "safe", "unsafe": [str(role) for role in entry.get("instruments") or ()]}
    return found
