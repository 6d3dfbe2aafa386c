"""Temperatures of a run from before somebody began to watch it, from the trend that is written beside its session."""

from __future__ import annotations

from pathlib import Path

from bench.model.errors import BenchError
from bench.record.trend_reader import TrendReader
from bench.tui.watch import HOUR_S, UNIT, Seen

POINTS = 400


def remember_earlier(seen: Seen, folder: Path) -> None:
    """Fill the last hour of the trend; a session without one, or one that cannot be read, begins now."""
    now = seen.document.get("t_utc_s")
    if now is None:
        return
    try:
        found = TrendReader(folder).window([UNIT], now - HOUR_S, now, POINTS)
    except (BenchError, OSError, ValueError):
        return
    seen.keep_trend(found.t_utc_s, found.low[:, 0], found.high[:, 0])
