"""Recordings of a time offset whose intervals are held against the truth, in the right world of ``doubt_time_sync``."""

import doubt_time_sync as worlds
from coverage_blocks import in_right_world

SYSTEM = "time_sync"


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth."""
    seen = worlds.seen(seed, None, 0.0)
    return in_right_world(seen.entries, seen.truths)
