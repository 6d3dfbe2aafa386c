"""Ring-laser records of 2 s whose intervals are held against the truth, in the right world of ``doubt_lock_in``."""

import doubt_lock_in as worlds
from coverage_blocks import in_right_world

SYSTEM = "lock_in"
_OF_ITSELF = ("random_walk_ratio raw", "alignment_time_ratio raw")  # 1 by definition


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth."""
    seen = worlds.seen(seed, None, 0.0)
    found = in_right_world(seen.entries, seen.truths)
    return {name: held for name, held in found.items() if name not in _OF_ITSELF}
