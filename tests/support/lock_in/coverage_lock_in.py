"""Ring-laser records of 2 s whose intervals are held against the truth, in the right world of ``doubt_lock_in``."""

from __future__ import annotations

import doubt_lock_in as worlds

from bench.analysis import is_sound

SYSTEM = "lock_in"


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth."""
    seen = worlds.seen(seed, None, 0.0)
    found: dict[str, bool | None] = {}
    for entry, truth in zip(seen.entries, seen.truths, strict=True):
        method = entry["conditions"]["method"]
        if entry["quantity"].endswith("_ratio") and method == worlds.RAW:
            continue
        near = is_sound(entry) and abs(entry["value"] - truth) <= entry["expanded_uncertainty"]
        found[f"{entry['quantity']} {method}".strip()] = near if is_sound(entry) else None
    return found
