"""Sessions as they were recorded: read once, kept for whoever looks; all this takes long and belongs in a thread."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from bench.model.errors import BenchError
from bench.record import TrendWindow
from bench.replay import RAW_S_PER_POINT, history, raw_window, trend_place
from bench.web.partial import finished_estimates
from bench.web.points import Points, binned
from bench.web.recorded.listing import results_of
from bench.web.recorded.recording import Recording, read_recording
from bench.web.recorded.state import RecordedState, Scenery, scenery_of
from bench.web.recorded.trends import Trends

KEPT_SESSIONS = 3
_Stamp = tuple[int, ...]


@dataclass(frozen=True)
class _Kept:
    stamp: _Stamp
    recording: Recording
    scenery: Scenery
    final: dict[str, Any]


class Past:
    """Recordings of sessions, at most three of them in memory. Safe to be used from several threads."""

    def __init__(self, cache: Path | None = None) -> None:
        self._lock = Lock()
        self._trends = Trends(cache)
        self._kept: OrderedDict[Path, _Kept] = OrderedDict()

    def state(self, folder: Path) -> RecordedState:
        """State of a session, to be moved about. Raises: InputError B-REC-010, SessionDamaged B-REC-012, B-REC-014."""
        kept = self._read(folder)
        return RecordedState(kept.recording, kept.scenery)

    def final(self, folder: Path) -> dict[str, Any]:
        """State document of a session as its recording ends; little more than its name if it cannot be read."""
        try:
            return self._read(folder).final
        except BenchError as error:
            return unreadable(folder, error)

    def points(self, folder: Path, t0_utc_s: float, t1_utc_s: float, width_s: float) -> Points:
        """Return all signals of a session between two times, in points of a width.

        Raises: BenchError if the session cannot be read or decoded.
        """
        names = [str(one["name"]) for one in self._read(folder).scenery.signals]
        if width_s < 1.0:
            trend = trend_place(folder, self._trends.place(folder))
            window = raw_window(folder, names, t0_utc_s, t1_utc_s, trend)
        else:
            most = round((t1_utc_s - t0_utc_s) / width_s) + 2
            window = history(folder, names, t0_utc_s, t1_utc_s, most, self._trends.made(folder))
        return binned(window.t_utc_s, window.low, window.high, width_s)

    def history(self, folder: Path, names: Sequence[str], t0_utc_s: float, t1_utc_s: float, n: int) -> TrendWindow:
        """Return signals of a session over time, in about ``n`` points at most or as single readings.

        Raises: BenchError if the session cannot be read, or has no signal of that name.
        """
        is_raw = t1_utc_s - t0_utc_s < RAW_S_PER_POINT * n
        cache = self._trends.place(folder) if is_raw else self._trends.made(folder)
        return history(folder, names, t0_utc_s, t1_utc_s, n, cache)

    def stop(self) -> None:
        """Give up what takes long."""
        self._trends.stop()

    def _read(self, folder: Path) -> _Kept:
        stamp = tuple(path.stat().st_mtime_ns for path in (folder, folder / "results.json") if path.exists())
        with self._lock:
            kept = self._kept.get(folder)
            if kept is None or kept.stamp != stamp:
                kept = _kept(folder, stamp)
                self._kept[folder] = kept
            self._kept.move_to_end(folder)
            while len(self._kept) > KEPT_SESSIONS:
                self._kept.popitem(last=False)
            return kept


def _kept(folder: Path, stamp: _Stamp) -> _Kept:
    recording = read_recording(folder)
    scenery = scenery_of(recording)
    state = RecordedState(recording, scenery).at(recording.last_utc_s)
    estimates = finished_estimates(results_of(folder), recording.last_utc_s)
    return _Kept(stamp, recording, scenery, {**state, "estimates": estimates})


def unreadable(folder: Path, error: BenchError) -> dict[str, Any]:
    """State document of a session that cannot be read, as far as there is one."""
    empty: dict[str, Any] = dict.fromkeys(
        ("wait", "step", "eta", "prompt", "estimates", "uut", "title", "started_utc_s")
    )
    lists: dict[str, Any] = {name: [] for name in ("alarms", "log", "signals", "graphs")}
    return {
        **empty, **lists, "proto": 1, "run": folder.name, "boot_id": "", "source": "replay", "state": "stopped",
        "outcome": {"error": error.code, "text": error.message},
    }  # fmt: skip
