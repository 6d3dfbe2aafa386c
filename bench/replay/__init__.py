"""A recorded session decoded again and compared."""

from bench.replay.build_trend import build_trend
from bench.replay.compare import ABSENT, Difference, compare
from bench.replay.course import Course, DecodedFrames, decoded_frames, read_course
from bench.replay.delimited import CONTROL, LogParser
from bench.replay.described import frames_of, session_frames
from bench.replay.history import RAW_S_PER_POINT, history, needs_build, raw_window, trend_place
from bench.replay.parts import Splice, moved_rows
from bench.replay.rows import Replayed, replay_rows
from bench.replay.series import IMPORT, LINK, MAPPING, file_lines, first_bytes, replay_series, survey, text_forms

__all__ = [
    "ABSENT",
    "CONTROL",
    "IMPORT",
    "LINK",
    "MAPPING",
    "RAW_S_PER_POINT",
    "Course",
    "DecodedFrames",
    "Difference",
    "LogParser",
    "Replayed",
    "Splice",
    "build_trend",
    "compare",
    "decoded_frames",
    "file_lines",
    "first_bytes",
    "frames_of",
    "history",
    "moved_rows",
    "needs_build",
    "raw_window",
    "read_course",
    "replay_rows",
    "replay_series",
    "session_frames",
    "survey",
    "text_forms",
    "trend_place",
]
