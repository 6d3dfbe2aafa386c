"""The sessions of a folder as a list: each is read once, and again only after something in its folder has changed.

The page looks into the sessions directly below one folder, and into nothing else. A session may come from elsewhere: no
link in it is followed, and a pipe, at which one would wait for ever, is no file.
"""

from __future__ import annotations

import json
import os
import re
import stat
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from bench.maths.verdict import worst
from bench.model.clock import NS, utc_of_stamp
from bench.model.errors import BenchError
from bench.model.posix import AT_ONCE, NO_LINK, RAW
from bench.model.segments import SEGMENT_NAME
from bench.record import OPEN_MARKER, Walk, layout
from bench.run.guard.diary import DIARY
from bench.web.recorded.outcome import SessionOutcome, outcome_of

FILES = {
    "report": "report.html", "pdf": "report.pdf", "certificate": "certificate.xml",
    "specimen": "certificate.specimen.xml",
}  # fmt: skip
READ_AT_ONCE = 24  # sessions that one request reads; the rest follows with the next requests
_FIRST_SEGMENT = layout.segment_name(1)
_HEAD_BYTES = (1 << 18, 1 << 21)  # the manifest is the first message; its chunk holds the plan too

Row = dict[str, Any]
Stamp = tuple[int, ...]
"""When what is said of a session has changed last, ns: its folder, its results, the diary of its guard."""
RUN_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}")  # no leading dot, so neither "." nor ".."


@dataclass(frozen=True)
class _Entry:
    changed: Stamp
    row: Row


class RunList:
    """Sessions of a folder, newest first; safe to be asked from several threads."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self._entries: dict[str, _Entry] = {}
        self._lock = Lock()

    def rows(self, most: int = READ_AT_ONCE) -> tuple[list[Row], int]:
        """Return a row for each session, and how many of them could not be read yet (their title is null).

        Args: most: sessions that may be read in this call.
        """
        with self._lock:
            folders = sorted(self._folders(), key=lambda folder: folder[0], reverse=True)
            self._forget({name for name, _ in folders})
            unread = 0
            rows = []
            for name, changed in folders:
                entry = self._entries.get(name)
                if entry is None or entry.changed != changed:
                    if most > 0:
                        most -= 1
                        entry = self._entries[name] = _Entry(changed, session_row(self.out / name))
                    elif entry is None:
                        unread += 1
                        entry = _Entry(changed, _unread(name))
                rows.append(entry.row)
            return rows, unread

    def _folders(self) -> list[tuple[str, Stamp]]:
        places = self.out.iterdir() if self.out.is_dir() else ()
        return [(path.name, stamp_of(path)) for path in places if run_folder(self.out, path.name) is not None]

    def _forget(self, there: set[str]) -> None:
        for name in set(self._entries) - there:
            del self._entries[name]


def stamp_of(folder: Path) -> Stamp:
    """Return the stamp of a session; empty if it is not there."""
    try:
        changed = folder.stat().st_mtime_ns
    except OSError:
        return ()
    files = (folder / "results.json", folder / DIARY)
    return (changed, *(path.stat().st_mtime_ns if path.is_file() else 0 for path in files))


def session_row(folder: Path) -> Row:
    """Return one session, by its manifest and its results; what cannot be read is null."""
    manifest, results = _manifest(folder / _FIRST_SEGMENT), results_of(folder)
    campaign = manifest.get("campaign") or {}
    quality = results.get("quality") or {}
    outcome = outcome_of(folder, results) if manifest else SessionOutcome("damaged", "its beginning cannot be read")
    return {
        **_unread(folder.name),
        "title": manifest.get("title"),
        "sequence": manifest.get("sequence"),
        "state": "stopped" if (folder / OPEN_MARKER).exists() else "ended",
        "uut": results.get("uut") or campaign.get("uut"),
        "simulated": manifest.get("simulated"),
        "verdict": verdict_of(results) if results else None,
        "records": {"done": quality.get("records"), "planned": (manifest.get("planned") or {}).get("records")},
        "report": (folder / "report.html").is_file(),
        "outcome": asdict(outcome),
    }


def verdict_of(results: Row) -> str:
    """Return the worst verdict of all estimates; ``none`` if no estimate has one."""
    return worst(str(estimate.get("verdict")) for estimate in results.get("estimates") or ())


def _unread(name: str) -> Row:
    utc_ns = utc_of_stamp(name)
    empty = dict.fromkeys(("title", "sequence", "state", "uut", "simulated", "verdict", "records", "report", "outcome"))
    return {"run": name, "started_utc_s": None if utc_ns is None else utc_ns / NS, **empty}


def _manifest(segment: Path) -> Row:
    for size in _HEAD_BYTES:
        try:
            with segment.open("rb") as stream:
                head = stream.read(size)
            for message in Walk(None).segment(segment.name, head):
                if message.topic == layout.MANIFEST:
                    document = message.document()
                    return document if isinstance(document, dict) else {}
        except (BenchError, OSError, ValueError):
            return {}
    return {}


def results_of(folder: Path) -> Row:
    """Return results.json of a session; empty if there is none that can be read."""
    try:
        document = json.loads(content_of(folder / "results.json") or b"")
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def run_folder(out: Path, name: str) -> Path | None:
    """Return the folder of a session in ``out``; None if it has no such name, is no session or leads elsewhere."""
    if RUN_NAME.fullmatch(name) is None:
        return None
    folder = out / name
    try:
        if folder.is_symlink() or not folder.is_dir():
            return None
        with os.scandir(folder) as entries:
            plain = [entry.is_file(follow_symlinks=False) for entry in entries if SEGMENT_NAME.fullmatch(entry.name)]
    except OSError:
        return None
    return folder if plain and all(plain) else None


def content_of(path: Path) -> bytes | None:
    """Return what a plain file of a session holds; None if it is not there, cannot be read, or is no plain file."""
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | RAW | NO_LINK | AT_ONCE), "rb") as file:
            return file.read() if stat.S_ISREG(os.fstat(file.fileno()).st_mode) else None
    except OSError:
        return None
