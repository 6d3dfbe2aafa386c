"""Plausibility of pulse counts: a 16-bit check passes about one in 65,536 garbled frames, the gate finds those.

Physics of a charge-balance converter behind a gate of fixed length: at each edge of its clock it gives at most one
pulse, so N plus P pulses never exceed the clock's own count; and the counts of the two clocks that make the gate agree
within 1 % over a record (real clocks do within 0.01 %, and an edge of the gate is worth one count).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]

STEADY = ("master_count", "af_clock")
CLOCK = "af_clock"
PULSES = ("npp", "ppp")
TOLERANCE = 0.01
EDGE_COUNTS = 2


def implausible(pieces: Sequence[Columns]) -> NDArray[np.bool_] | None:
    """Return which frames of a record cannot be true; None if all can.

    Args: pieces: consecutive parts of the record, each with its count fields by name, (n,) or (n, channels).
    Returns: (frames,) bool over all parts in order, or None. Fields a frame format does not have are not judged.
    """
    if not pieces or _all_plausible(pieces):
        return None
    columns = {name: np.concatenate([piece[name] for piece in pieces]).astype(np.int64) for name in pieces[0]}
    wrong = np.zeros(len(next(iter(columns.values()))), np.bool_)
    for name in _present(pieces, STEADY):
        middle = np.median(columns[name])
        wrong |= np.abs(columns[name] - middle) > TOLERANCE * middle + EDGE_COUNTS
    if _has_clock(pieces):
        pulses = sum(columns[name] for name in PULSES)
        limit = columns[CLOCK] + EDGE_COUNTS
        over = pulses > (limit if np.ndim(pulses) == 1 else limit[:, None])
        wrong |= over if over.ndim == 1 else over.any(axis=1)
    return wrong if wrong.any() else None


def _all_plausible(pieces: Sequence[Columns]) -> bool:
    """Cheap and sufficient: extremes of the whole record."""
    for name in _present(pieces, STEADY):
        low = min(int(piece[name].min()) for piece in pieces)
        high = max(int(piece[name].max()) for piece in pieces)
        if high - low > TOLERANCE * low:
            return False
    if not _has_clock(pieces):
        return True
    highest = sum(max(int(piece[name].max()) for piece in pieces) for name in PULSES)
    return highest <= min(int(piece[CLOCK].min()) for piece in pieces)


def _present(pieces: Sequence[Columns], names: Sequence[str]) -> list[str]:
    return [name for name in names if name in pieces[0]]


def _has_clock(pieces: Sequence[Columns]) -> bool:
    return all(name in pieces[0] for name in (CLOCK, *PULSES))
