"""Floor 3: a recorded session decoded again and compared."""

from bench.replay.compare import compare
from bench.replay.rows import replay_rows

__all__ = ["compare", "replay_rows"]
