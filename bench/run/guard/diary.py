"""The guard's diary, one JSON line each, brought to the disk by a thread: a slow disk must not delay a safe state."""

from __future__ import annotations

import json
import os
import queue
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.model.clock import NS, Clock, utc_moment
from bench.model.errors import NEXT_FORM, unknown_form
from bench.model.posix import ALONE

DIARY = "guard.jsonl"  # in the folder of a session


class Diary:
    """Appends ``{"utc": ..., "t_s": seconds since the guard acted, "v": 1, "what": ..., ...}``; never raises."""

    def __init__(self, path: Path, clock: Clock) -> None:
        self._clock = clock
        self._path = path
        self._start_ns = clock.now_ns()
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    def restart(self) -> None:
        """``t_s`` counts from now."""
        self._start_ns = self._clock.now_ns()

    def note(self, what: str, **fields: Any) -> None:
        """Something was done or seen."""
        utc_ns = self._clock.utc_ns()
        utc = utc_moment(utc_ns).replace(microsecond=utc_ns % NS // 1000)
        t_s = round((self._clock.now_ns() - self._start_ns) / NS, 3)
        entry = {"utc": utc.isoformat(timespec="milliseconds"), "t_s": t_s, "v": 1, "what": what, **fields}
        self._lines.put(json.dumps(entry, separators=(",", ":"), default=str).encode() + b"\n")

    def close(self, limit_s: float) -> None:
        """Wait until everything is on the disk, at most ``limit_s``."""
        self._lines.put(None)
        self._thread.join(limit_s)

    def _write(self) -> None:
        descriptor = -1
        with suppress(OSError):
            descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | ALONE, 0o644)
        while (line := self._lines.get()) is not None:
            with suppress(OSError):
                os.write(descriptor, line)
                os.fsync(descriptor)


def read_diary(path: Path) -> list[dict[str, Any]]:
    """Return the whole lines of a guard's diary, oldest first; empty if there is none."""
    try:
        lines = path.read_bytes().split(b"\n")[:-1]
    except OSError:
        return []
    entries = []
    for line in lines:
        with suppress(ValueError):
            entries.append(json.loads(line))
    return entries


def guard_word(folder: Path) -> Mapping[str, Any] | None:
    """Return what the guard of a run that is gone did; None if it did not act.

    ``{"reason", "safe": True where nothing contradicts it, False or None (at it), "unsafe": state by role, "" if
    unknown, "utc": of its last word, "by": who took the bench over before it was confirmed, "" if nobody}``. While it
    is at it ``unsafe`` grows and shrinks with what each instrument said.
    """
    word: dict[str, Any] | None = None
    for entry in read_diary(folder / DIARY):
        if why := unknown_form(entry):  # it may say that something is on, or that nothing is
            reason = f"its log is {why}: {NEXT_FORM}"
            return {"reason": reason, "safe": None, "unsafe": {}, "utc": entry.get("utc"), "by": ""}
        what = entry.get("what")
        if what in ("ready", "dismissed"):
            word = None
        elif what == "act":
            word = {"reason": str(entry.get("text", "")), "safe": None, "unsafe": {}, "utc": entry.get("utc"), "by": ""}
        elif word is None:
            continue
        elif what == "instrument":
            word["unsafe"].pop(entry.get("role"), None)
            if not entry.get("safe"):
                word["unsafe"][str(entry.get("role"))] = str(entry.get("state", "unreachable"))
        elif what in ("safe", "unsafe"):
            states = entry.get("instruments") or {}
            unsafe = dict(states) if isinstance(states, dict) else dict.fromkeys(map(str, states), "")
            word |= {"safe": what == "safe" and not unsafe, "unsafe": unsafe, "utc": entry.get("utc")}
        elif what == "taken over":
            word |= {"safe": False, "by": str(entry.get("by", "")), "utc": entry.get("utc")}
    return word
