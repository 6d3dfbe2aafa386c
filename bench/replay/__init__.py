"""Floor 3: a recorded session decoded again, compared, or served as the ports of a bench."""

from bench.replay.compare import Difference, compare
from bench.replay.recorded_link import RecordedLink
from bench.replay.rows import Replayed, replay_rows
from bench.replay.windows import RecordedWindow, recorded_windows

__all__ = ["Difference", "RecordedLink", "RecordedWindow", "Replayed", "compare", "recorded_windows", "replay_rows"]
