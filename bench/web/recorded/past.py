"""Sessions as they were recorded: read once, kept for whoever looks; all this takes long and belongs in a thread."""

from __future__ import annotations

import hashlib
import math
import os
import shutil
import subprocess
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from bench.model.errors import BenchError, InputError
from bench.model.lab import cache_folder
from bench.model.posix import TREND, own_process
from bench.record import FOLDER, TrendReader, TrendWindow
from bench.replay import RAW_S_PER_POINT, history, needs_build, raw_window, trend_place
from bench.session.partial_fits import finished_estimates
from bench.session.recorded_state import (
    RecordedState,
    Recording,
    Scenery,
    outline_of,
    read_recording,
    scenery_of,
    state_at_the_end,
    unheard,
)
from bench.web.points import Points, binned
from bench.web.recorded.listing import FILES, Stamp, results_of, stamp_of
from bench.web.recorded.outcome import outcome_of
from bench.web.security.refusal import Refusal

KEPT_SESSIONS = 3
KEPT_TRENDS = 20  # a campaign of 38 hours takes some 25 MB
LONGEST_S = 600.0
MOST_POINTS = 4000
MOST_SIGNALS = 40
_DEFAULT_POINTS = 1000


@dataclass(frozen=True)
class _Kept:
    stamp: Stamp
    recording: Recording
    scenery: Scenery
    end: dict[str, Any]
    final: dict[str, Any]


class Past:
    """Recordings of sessions, at most three of them in memory. Safe to be used from several threads."""

    def __init__(self, cache: Path | None = None) -> None:
        self._lock = Lock()
        self._trends = Trends(cache)
        self._kept: OrderedDict[Path, _Kept] = OrderedDict()

    def state(self, folder: Path) -> RecordedState:
        """Return state of a session, to move about. Raises: InputError B-REC-010, SessionDamaged B-REC-012, -014."""
        kept = self._read(folder)
        return RecordedState(kept.recording, kept.scenery, kept.end)

    def final(self, folder: Path) -> dict[str, Any]:
        """Return state document of a session as its recording ends; little more than its name if it cannot be read."""
        try:
            return self._read(folder).final
        except BenchError as error:
            return unreadable(folder, error)

    def outline(self, folder: Path) -> dict[str, Any] | None:
        """Return signals, graphs, start and span of a session, of which a page draws the history before it has a state.

        None if the session has no trend of its own, which says the span without reading the recording.
        Raises: InputError B-REC-010; SessionDamaged B-REC-012, B-REC-014.
        """
        span_s = None if trend_place(folder) is None else TrendReader(folder).span_s()
        if span_s is None:
            return None
        first_s, last_s = span_s
        return {
            **outline_of(folder), "started_utc_s": first_s,
            "replay": {"first_utc_s": first_s, "last_utc_s": last_s, "at_utc_s": last_s},
        }  # fmt: skip

    def points(self, folder: Path, t0_utc_s: float, t1_utc_s: float, width_s: float) -> Points:
        """Return all signals of a session between two times, in points of a width.

        Raises: BenchError if the session cannot be read or decoded.
        """
        names = [str(signal["name"]) for signal in self._read(folder).scenery.signals]
        if width_s < 1.0:
            trend = trend_place(folder, self._trends.place(folder))
            window = raw_window(folder, names, t0_utc_s, t1_utc_s, trend)
        else:
            most = round((t1_utc_s - t0_utc_s) / width_s) + 2
            window = history(folder, names, t0_utc_s, t1_utc_s, most, self._trends.made(folder))
        return binned(window.t_utc_s, window.low, window.high, width_s)

    def history(self, folder: Path, query: HistoryQuery) -> TrendWindow:
        """Return signals of a session over time, in about as many points as asked for or as single readings.

        Raises: BenchError if the session cannot be read, or has no signal of that name.
        """
        is_raw = query.t1_utc_s - query.t0_utc_s < RAW_S_PER_POINT * query.n
        cache = self._trends.place(folder) if is_raw else self._trends.made(folder)
        return history(folder, query.signals, query.t0_utc_s, query.t1_utc_s, query.n, cache)

    def stop(self) -> None:
        """Give up what takes long."""
        self._trends.stop()

    def _read(self, folder: Path) -> _Kept:
        stamp = stamp_of(folder)
        with self._lock:
            kept = self._kept.get(folder)
            if kept is None or kept.stamp != stamp:
                kept = _kept(folder, stamp)
                self._kept[folder] = kept
            self._kept.move_to_end(folder)
            while len(self._kept) > KEPT_SESSIONS:
                self._kept.popitem(last=False)
            return kept


def _kept(folder: Path, stamp: Stamp) -> _Kept:
    recording = read_recording(folder)
    scenery = scenery_of(recording)
    state = state_at_the_end(recording, scenery)
    results = results_of(folder)
    estimates = finished_estimates(results, recording.last_utc_s)
    session = session_document(folder, results, recording.last_utc_s - recording.first_utc_s)
    return _Kept(stamp, recording, scenery, state, {**state, "estimates": estimates, "session": session})


def session_document(folder: Path, results: dict[str, Any], duration_s: float) -> dict[str, Any]:
    """Return the entry ``session`` of the state document of a run that is over: outcome, duration and files."""
    files = {what: (folder / name).is_file() for what, name in FILES.items()}
    return {"outcome": asdict(outcome_of(folder, results)), "duration_s": duration_s, "files": files}


def unreadable(folder: Path, error: BenchError) -> dict[str, Any]:
    """Return state document of a session that cannot be read, as far as there is one."""
    empty: dict[str, Any] = dict.fromkeys(
        ("wait", "step", "eta", "prompt", "estimates", "uut", "title", "started_utc_s")
    )
    lists: dict[str, Any] = {name: [] for name in ("alarms", "log", "signals", "graphs")}
    return {
        **empty, **lists, "session": session_document(folder, {}, 0.0), **unheard(folder), "attention": "much",
        "proto": 1, "run": folder.name, "boot_id": "", "source": "replay", "state": "stopped",
        "outcome": {"error": error.code, "text": error.message},
    }  # fmt: skip


class Trends:
    """Trends of sessions, those made here in a folder of this user's cache. Safe to be used from several threads."""

    def __init__(self, cache: Path | None = None) -> None:
        self._cache = cache or cache_folder() / "trend"
        self._one = Lock()
        self._building: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def place(self, folder: Path) -> Path | None:
        """Return the cache of a session as bench.replay.history wants it, not made yet; None if it has its own."""
        if trend_place(folder) is not None:
            return None
        return self._cache / hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()[:16]

    def made(self, folder: Path) -> Path | None:
        """Return ``place``, the trend being there now. Raises: InputError B-WEB-022 if it cannot be made."""
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
            where=folder,
            next_step="zoom in to see single readings; 'bench recover' lists what the session holds",
        )

    def _prune(self) -> None:
        made = sorted(self._cache.glob(f"*/*/{FOLDER}"), key=lambda path: path.stat().st_mtime)
        for path in made[:-KEPT_TRENDS]:
            shutil.rmtree(path.parent.parent, ignore_errors=True)


@dataclass(frozen=True)
class HistoryQuery:
    """A page's question for history; times in seconds since 1970 (UTC)."""

    signals: tuple[str, ...]
    t0_utc_s: float
    t1_utc_s: float
    n: int


def history_query(words: Mapping[str, str]) -> HistoryQuery:
    """Read the query of a history request. Raises: Refusal B-WEB-020, status 400, naming what is wrong."""
    signals = tuple(dict.fromkeys(name for name in words.get("signals", "").split(",") if name))
    if not 1 <= len(signals) <= MOST_SIGNALS:
        raise _refused(f"signals names {len(signals)} signals; one to {MOST_SIGNALS} can be asked for, by commas")
    t0_utc_s, t1_utc_s = _time(words, "t0"), _time(words, "t1")
    if not t1_utc_s > t0_utc_s:
        raise _refused(f"t1 ({t1_utc_s} s) must be later than t0 ({t0_utc_s} s)")
    asked = words.get("n", str(_DEFAULT_POINTS))
    if not (asked.isascii() and asked.isdigit() and len(asked) < 10 and int(asked) >= 1):
        raise _refused(f"n is {asked[:20]!r}; it must be a whole number from 1 on")
    return HistoryQuery(signals, t0_utc_s, t1_utc_s, min(int(asked), MOST_POINTS))


def _time(words: Mapping[str, str], key: str) -> float:
    text = words.get(key, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _refused(f"{key} is {text[:20]!r}; it must be a number: seconds since 1970 (UTC)")
    return value


def _refused(message: str) -> Refusal:
    return Refusal(400, "B-WEB-020", f"history: {message}", next_step="ask again, as docs/live-protocol.md says")
