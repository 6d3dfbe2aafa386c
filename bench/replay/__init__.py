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
