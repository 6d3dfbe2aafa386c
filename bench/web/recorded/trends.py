"""Where the trend of a session is; of sessions that have none it is made, by a process of its own, in a cache."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from threading import Lock

from bench.model.errors import InputError
from bench.model.processes import TREND, own_process
from bench.record import FOLDER
from bench.replay import needs_build, trend_place

KEPT_TRENDS = 20  # a campaign of 38 hours takes some 25 MB
LONGEST_S = 600.0


class Trends:
    """Trends of sessions, those made here in a folder of this user's cache. Safe to be used from several threads."""

    def __init__(self, cache: Path | None = None) -> None:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        self._cache = cache or base / "inertial-bench" / "trend"
        self._one = Lock()
        self._building: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def place(self, folder: Path) -> Path | None:
        """The cache of a session as bench.replay.history wants it, not made yet; None if the session has its own."""
        if trend_place(folder) is not None:
            return None
        return self._cache / hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()[:16]

    def made(self, folder: Path) -> Path | None:
        """As ``place``, the trend being there now. Raises: InputError B-WEB-022 if it cannot be made."""
        cache = self.place(folder)
        if cache is None:
            return None
        if needs_build(folder, cache / folder.name):
            with self._one:
                if needs_build(folder, cache / folder.name):  # still: another thread may have made it
                    self._build(folder, cache)
                    self._prune()
        return cache

    def stop(self) -> None:
        """Give up what is being made."""
        self._stopped = True
        if self._building is not None:
            with suppress(ProcessLookupError):
                self._building.kill()

    def _build(self, folder: Path, cache: Path) -> None:
        words = own_process(TREND, str(folder), str(cache / folder.name))
        failed = "the page server ends"
        if not self._stopped:
            with subprocess.Popen(words, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
                self._building = process
                try:
                    _, said = process.communicate(timeout=LONGEST_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    _, said = process.communicate()
                self._building = None
            if process.returncode == 0:
                return
            failed = (said.decode(errors="replace").strip().splitlines() or ["it was given up"])[-1]
        raise InputError(
            "B-WEB-022",
            f"the trend of this session cannot be made ({failed})",
            where=str(folder),
            next_step="zoom in to see single readings; 'bench recover' lists what the session holds",
        )

    def _prune(self) -> None:
        made = sorted(self._cache.glob(f"*/*/{FOLDER}"), key=lambda path: path.stat().st_mtime)
        for path in made[:-KEPT_TRENDS]:
            shutil.rmtree(path.parent.parent, ignore_errors=True)
