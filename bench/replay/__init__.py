"""A recorded session decoded again and compared."""

from bench.replay.build_trend import build_trend
from bench.replay.compare import ABSENT, Difference, compare
from bench.replay.delimited import LogParser
from bench.replay.history import RAW_S_PER_POINT, history, needs_build, raw_window, trend_place
from bench.replay.parts import Splice, moved_rows
from bench.replay.rows import Replayed, replay_rows
from bench.replay.series import IMPORT, LINK, MAPPING, Survey, file_lines, replay_series, survey

__all__ = [
    "ABSENT",
    "IMPORT",
    "LINK",
    "MAPPING",
    "RAW_S_PER_POINT",
    "Difference",
    "LogParser",
    "Replayed",
    "Splice",
    "Survey",
    "build_trend",
    "compare",
    "file_lines",
    "history",
    "moved_rows",
    "needs_build",
    "raw_window",
    "replay_rows",
    "replay_series",
    "survey",
    "trend_place",
]
