"""The audit of wishes from the page, refused or not: lines of JSON beside the tokens."""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path

from bench.model.clock import Clock, utc_text
from bench.model.posix import NO_LINK, RAW

FILE = "serve.jsonl"
LARGEST = 5_000_000  # bytes; then the file becomes serve.1.jsonl, which becomes serve.2.jsonl, and so on
KEPT = 4


class Audit:
    """Appends to ``serve.jsonl`` in ``folder``, mode 0600. What cannot be written keeps no command back: it is said
    on standard error once, because an abort must work on a full disk too."""

    def __init__(self, folder: Path, clock: Clock, largest: int = LARGEST) -> None:
        self.folder = folder
        self._clock = clock
        self._largest = largest
        self._lock = threading.Lock()
        self._told = False

    def write(self, what: str, **fields: object) -> None:
        """One line: the time, what was wanted, and who, from where, with what result."""
        line = json.dumps({"t_utc": utc_text(self._clock.utc_ns()), "what": what, **fields}, ensure_ascii=True)
        with self._lock:
            try:
                self._append(line.encode() + b"\n")
                self._told = False
            except OSError as error:
                if not self._told:
                    print(f"bench serve: the audit {self.folder / FILE} is not written: {error}", file=sys.stderr)  # noqa: T201
                self._told = True

    def _append(self, line: bytes) -> None:
        path = self.folder / FILE
        if path.exists() and path.stat().st_size + len(line) > self._largest:
            for number in range(KEPT - 1, 0, -1):
                older = self.folder / f"serve.{number}.jsonl"
                if older.exists():
                    older.replace(self.folder / f"serve.{number + 1}.jsonl")
            path.replace(self.folder / "serve.1.jsonl")
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | RAW | NO_LINK, 0o600)
        try:
            os.write(descriptor, line)
        finally:
            os.close(descriptor)
