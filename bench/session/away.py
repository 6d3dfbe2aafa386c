"""Results of a run that was away for a time nobody knows: what depends on that time is doubtful.

Where the clock went back between two parts of a session, times behind the splice lie right behind those before it
(bench.replay.parts). A fit cannot know that. So the same analysis is made again as if the run had been away for an
hour, a day and a week: what comes out the same needs no time difference across the splice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from bench.analysis import LEAST_MOVE, Analysis, Estimate, Evidence, weigh
from bench.model.clock import to_ns
from bench.model.events import Event, Resume
from bench.record import RecordRow
from bench.replay import Splice, moved_rows
from bench.session.wording import say

LONGER_S = (3600.0, 86_400.0, 7 * 86_400.0)  # a reset, a night or a day without power, a holiday

Placed = tuple[list[RecordRow], list[tuple[int, Event]]]


def placed_later(
    rows: Sequence[RecordRow], events: Sequence[tuple[int, Event]], splices: Sequence[Splice], longer_s: float
) -> Placed:
    """Return records and events (t_ns, event) of a session as if each unknown time away were longer by ``longer_s``."""
    longer_ns = to_ns(longer_s)
    shifts = [0]
    for splice in splices:
        shifts.append(shifts[-1] + (0 if splice.placed else longer_ns))
    parts = [(sum(splice.at_ns <= row.window.t_start_ns for splice in splices), row) for row in rows]
    part, later = 0, list[tuple[int, Event]]()
    for t_ns, event in events:
        part = min(part + isinstance(event, Resume), len(splices))
        later.append((t_ns + shifts[part], event))
    return moved_rows(parts, shifts), later


def doubted(analysis: Analysis, others: Sequence[Analysis | None], splices: Sequence[Splice]) -> Analysis:
    """Return an analysis with doubt at what the ``others``, with longer times away, have otherwise; None failed."""
    steps = ", ".join(str(splice.step) for splice in splices if not splice.placed)
    moves = [(entry, max(moved)) for entry, *moved in zip(analysis.estimates, *_moves(analysis, others), strict=True)]
    sentence = say("away.depends", steps=steps)
    evidence = [
        Evidence(
            "unknown_time_away", sentence, move if math.isfinite(move) else None, 0.0, move,
            (entry.quantity,), entry.conditions,
        )
        for entry, move in moves
        if move > LEAST_MOVE
    ]  # fmt: skip
    note = say("away.note", steps=steps, count=len(evidence), of=len(moves))
    return replace(analysis, evidence=[*analysis.evidence, *evidence], notes=[*analysis.notes, note])


def _moves(analysis: Analysis, others: Sequence[Analysis | None]) -> Iterator[list[float]]:
    """Yield, for each other analysis, how far each estimate is from it in expanded uncertainties."""
    names = [entry.quantity for entry in analysis.estimates]
    for other in others:
        if other is None or names != [entry.quantity for entry in other.estimates]:
            yield [math.inf] * len(names)
            continue
        before, after = (weigh(one.evidence).against for one in (analysis, other))
        yield [_move(*pair, before, after) for pair in zip(analysis.estimates, other.estimates, strict=True)]


def _move(entry: Estimate, other: Estimate, before: Sequence[Evidence], after: Sequence[Evidence]) -> float:
    """Return the larger change of value and expanded uncertainty; infinite where only the other one is doubted."""
    if any(check.bears_on(other) for check in after) and not any(check.bears_on(entry) for check in before):
        return math.inf
    apart = [_apart(getattr(entry, name), getattr(other, name)) for name in ("value", "expanded_uncertainty")]
    expanded = entry.expanded_uncertainty
    return max(math.inf if part and not expanded > 0.0 else part / expanded if part else 0.0 for part in apart)


def _apart(one: float, other: float) -> float:
    """Return how far two numbers are apart: two unknown ones not at all, one alone without end."""
    if math.isnan(one) or math.isnan(other):
        return 0.0 if math.isnan(one) and math.isnan(other) else math.inf
    return abs(one - other)
