"""What the guard of a run did, for whoever looks at a run that does not answer any more."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.run.guard.diary import read_diary

DIARY = "guard.jsonl"


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
