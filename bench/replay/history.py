"""The history of a session in a window: single readings where there is room, else least and greatest values."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.model.segments import segment_files
from bench.record import FOLDER, HEAD, OPEN_MARKER, TrendReader, TrendWindow, read_head
from bench.replay.build_trend import build_trend
from bench.replay.raw_window import raw_window

RAW_S_PER_POINT = 0.02  # 20 s on 1000 points: two readings of 100 Hz on each
STALE_S = 600.0  # a trend made of a session that is still written is made again then


def history(
    folder: Path, names: Sequence[str], t0_utc_s: float, t1_utc_s: float, n: int, cache: Path | None = None
) -> TrendWindow:
    """Return points of some signals in a window.

    Args:   n: points a figure has room for.   cache: where the trend is made of a session that has none; this takes
            a while, so not in a process that people wait for.
    Raises: InputError B-FRAME-024 (no such signal), B-REC-010 (no session), B-REC-030 (no trend, and no cache);
            SessionDamaged B-REC-012; OSError if the cache cannot be written.
    """
    trend = trend_place(folder, cache)
    if t1_utc_s - t0_utc_s < RAW_S_PER_POINT * n:
        return raw_window(folder, names, t0_utc_s, t1_utc_s, trend)
    if trend is not None and needs_build(folder, trend):
        build_trend(folder, trend)
    return TrendReader(trend or folder).window(names, t0_utc_s, t1_utc_s, n)


def trend_place(folder: Path, cache: Path | None = None) -> Path | None:
    """The session itself if it has its trend, else its folder in the cache."""
    if read_head(folder / FOLDER) is not None:
        return folder
    return None if cache is None else cache / folder.name


def needs_build(folder: Path, trend: Path) -> bool:
    """Return whether a trend outside its session is not there, or older than the session."""
    if trend == folder:
        return False
    if read_head(trend / FOLDER) is None:
        return True
    newest_s = max((path.stat().st_mtime for path in segment_files(folder)), default=0.0)
    patience_s = STALE_S if (folder / OPEN_MARKER).exists() else 0.0
    return newest_s - (trend / FOLDER / HEAD).stat().st_mtime > patience_s
