"""How a session ended, in one word that a person can act on, by what its last segment says and seals.

The hash chain at the end of the recording is believed, not a file beside it: results that name another recording are no
results of this one. Only the end is read; 'bench recover' and 'bench report --verify' read everything.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

from bench.analysis import (
    Estimate,
    doubt_lines,
    estimates_of,
    is_sound,
    limits_of,
    limits_text,
    placed,
    stated_value,
    use_of,
)
from bench.maths.verdict import INDETERMINATE, WORST_FIRST, is_refused, passed, worst
from bench.model.errors import BenchError, InputError
from bench.model.events import End, Error, Safe, event_of
from bench.model.segments import SEGMENT_NAME
from bench.record import OPEN_MARKER, Message, SegmentChunks, layout
from bench.run.guard.diary import guard_word

BY_OPERATOR = ("B-RUN-010", "B-RUN-011")
_LAST_CHUNKS = 24  # the end of a run is within them: events and the chain, behind what the links still held
_TOPICS = frozenset({layout.EVENT, layout.CHAIN})
DOUBTFUL, NOT_JUDGED = "doubtful", "not_judged"
_WORDS = {**{verdict: str(verdict) for verdict in WORST_FIRST}, INDETERMINATE: DOUBTFUL}  # a verdict keeps its name
OUTCOMES = (*_WORDS.values(), NOT_JUDGED, "no_results", "fault", "stopped", "damaged")


@dataclass(frozen=True)
class SessionOutcome:
    """``word``: one of ``OUTCOMES``. ``why``: one line, may be "".

    ``verdicts`` counts the estimates by verdict, ``doubtful`` those that are not sound. ``off``: whether everything was
    confirmed off at the end, None if nobody says so; a guard that acted after the run counts, also while it is at it.
    """

    word: str
    why: str = ""
    verdicts: Mapping[str, int] | None = None
    doubtful: int = 0
    off: bool | None = None


def outcome_of(folder: Path, results: Mapping[str, Any]) -> SessionOutcome:
    """Return how a session ended. Args: results: its results.json, empty without one."""
    segments = sorted(path for path in folder.glob("session.*.mcap") if SEGMENT_NAME.fullmatch(path.name))
    try:
        ended = _Ending(segments)
    except (BenchError, OSError, ValueError, KeyError, TypeError) as damage:
        return SessionOutcome("damaged", " ".join(str(damage).split())[:200])
    return _at_the_end(folder, ended, results)


def _at_the_end(folder: Path, ended: _Ending, results: Mapping[str, Any]) -> SessionOutcome:
    guard = guard_word(folder)
    off = None if guard is None else bool(guard["safe"])
    if (folder / OPEN_MARKER).exists():
        word, why = ("stopped", "") if guard is None else ("fault", guard["reason"])
        return SessionOutcome(word, why, off=off)
    if not ended.chain:
        return SessionOutcome("damaged", f"{ended.last.name} is not sealed: its end is missing")
    if off is None and ended.safe is not None:
        off = not ended.safe.failures
    error = ended.end.error if ended.end is not None else None
    if error is not None:
        word = "stopped" if error in BY_OPERATOR else "fault"
        return SessionOutcome(word, ended.error_text or error, off=off)
    if not results:
        return SessionOutcome("no_results", off=off)
    said = (results.get("provenance") or {}).get("session_sha256")
    if said != ended.chain:
        return SessionOutcome("damaged", "results.json belongs to another recording than the one beside it", off=off)
    return _judged(results, off)


def _judged(results: Mapping[str, Any], off: bool | None) -> SessionOutcome:
    try:
        estimates = estimates_of(results)
    except InputError as error:
        return SessionOutcome("damaged", error.message, off=off)
    verdicts = dict[str, int](Counter(entry.verdict for entry in estimates))
    unsound = sum(not is_sound(entry) for entry in estimates)
    verdict = worst(verdicts)
    word = DOUBTFUL if unsound and passed([verdict]) else _WORDS.get(verdict, NOT_JUDGED)
    return SessionOutcome(
        word, "; ".join([*_refused(estimates), *doubt_lines(estimates)])[:300], verdicts, unsound, off
    )


def _refused(estimates: Sequence[Estimate]) -> Iterator[str]:
    """Yield the refused value that leaves its limits furthest, with its place; nothing where none is refused."""
    refused = [entry for entry in estimates if is_refused(entry.verdict) and entry.value is not None]
    places = [(use_of(entry.value, limits), limits, entry) for entry in refused if (limits := limits_of(entry))]
    for _, limits, entry in sorted(places, key=itemgetter(0))[-1:]:
        where = placed(entry.quantity, entry.conditions)
        yield f"{where}: {stated_value(entry)} {entry.unit}, limit {limits_text(limits)}"


class _Ending:
    """The last words of a recording; Raises: OSError, BenchError, ValueError where they cannot be read."""

    def __init__(self, segments: Sequence[Path]) -> None:
        for number, path in enumerate(segments, 1):
            if path.name != layout.segment_name(number):
                raise ValueError(f"{layout.segment_name(number)} is missing")
        self.last = segments[-1]
        self.chain = ""
        self.end: End | None = None
        self.safe: Safe | None = None
        self.error_text = ""
        for message in _last_messages(segments[-1]):
            if message.topic == layout.CHAIN:
                self._seal(segments[-1], message.document())
            else:
                self._take(message)

    def _seal(self, path: Path, said: Mapping[str, Any]) -> None:
        if path.stat().st_size < int(said["bytes"]):
            raise ValueError(f"{path.name} is shorter than it was")
        self.chain = str(said["sha256"])

    def _take(self, message: Message) -> None:
        kind, fields = message.event()
        match event_of(kind, fields):
            case End() as end:
                self.end = end
            case Safe() as safe:
                self.safe = safe
            case Error(text=text):
                self.error_text = text


def _last_messages(path: Path) -> Iterator[Message]:
    chunks = SegmentChunks(path)
    yield from chunks.messages(chunks.places[-_LAST_CHUNKS:], _TOPICS)
