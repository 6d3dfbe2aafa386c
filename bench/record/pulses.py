"""Pulse counts of a record's frames: which frames cannot be true, and when in the record the pulses came.

Plausibility: a 16-bit check passes about one in 65,536 garbled frames, and the physics of a charge-balance converter
behind a gate of fixed length finds those. At each edge of its clock it gives at most one pulse, so N plus P pulses
never exceed the clock's own count; and the counts of the two clocks that make the gate agree within 1 % over a record
(real clocks do within 0.01 %, and an edge of the gate is worth one count). Timing: what estimators of a rate need of
the frames, without keeping the frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.model.arrays import Array, Flags, Integers

Columns = Mapping[str, Array]
STEADY = ("master_count", "af_clock")
CLOCK = "af_clock"
PULSES = ("npp", "ppp")
TOLERANCE = 0.01
EDGE_COUNTS = 2
TIMED = ("npp", "ppp")
_EXACT = 1 << 53  # float64 holds every whole number below


def implausible(pieces: Sequence[Columns]) -> Flags | None:
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


def pulse_timing(pieces: Sequence[Mapping[str, Array]], first_counter: int) -> dict[str, Integers]:
    """Moments of the pulses of a record in which no frame is missing, and its first and last frame with a pulse.

    Args: pieces: consecutive parts of the record, each with its count fields by name, (n,) or (n, channels).
          first_counter: unwrapped counter of the first frame.
    Returns: int64 arrays (channels,) by "<field>.<key>" for "npp" and "ppp", with x_j pulses in frame j = 1, 2, ...:
        "moment1" = sum of j x_j, "moment2" = sum of j^2 x_j; "first" and "last" = unwrapped counter of the first and
        last frame with a pulse (-1: there is none), "at_first" and "at_last" = pulses in that frame (0: none).
        Fields that a frame format does not have are left out.
    """
    timing: dict[str, Integers] = {}
    for name in (name for name in TIMED if pieces and name in pieces[0]):
        counts = np.concatenate([piece[name] for piece in pieces])
        counts = counts[:, None] if counts.ndim == 1 else counts
        found = {**_moments(counts), **_ends(counts, first_counter)}
        timing |= {f"{name}.{key}": value for key, value in found.items()}
    return timing


def _moments(counts: Array) -> dict[str, Integers]:
    """Exact weighted sums of (n, channels): in float64, three times as fast, as long as that holds every digit."""
    place = np.arange(1, len(counts) + 1, dtype=np.int64)
    weights = np.stack((place, place * place))
    if len(counts) ** 3 * int(counts.max(initial=0)) < _EXACT:
        sums = (weights.astype(np.float64) @ counts.astype(np.float64)).astype(np.int64)
    else:
        sums = weights @ counts.astype(np.int64)
    return {"moment1": sums[0], "moment2": sums[1]}


def _ends(counts: Array, first_counter: int) -> dict[str, Integers]:
    """Return first and last frame with a pulse, by channel."""
    channels = np.ascontiguousarray(counts.T)
    pulsed = channels != 0
    first, last = pulsed.argmax(axis=1), len(counts) - 1 - pulsed[:, ::-1].argmax(axis=1)
    none = ~pulsed.any(axis=1)
    each = np.arange(len(channels))
    return {
        "first": np.where(none, -1, first_counter + first),
        "last": np.where(none, -1, first_counter + last),
        "at_first": channels[each, first].astype(np.int64),
        "at_last": np.where(none, 0, channels[each, last].astype(np.int64)),
    }
