"""The position where a run goes on after it was interrupted: a number in the plan's list of steps."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.model.events import Decision, End, Event, Exchange, Prompt, Reading, Record, Resume, Retake, Skip
from bench.model.ports import Drivers
from bench.model.stopping import FIRST, STAGE, STAGE_INDEX, UNTIL
from bench.plan import (
    Plan,
    PlannedCall,
    PlannedCommand,
    PlannedDecision,
    PlannedPrompt,
    PlannedRecord,
    PlannedSoak,
    PlannedVerify,
    Step,
    Steps,
    driver_actions,
    left_out_by,
)
from bench.record import JournalEntry
from bench.run.setpoints import is_motion


@dataclass(frozen=True)
class Resumption:
    """A session that is gone on with: from step ``start``, behind the ``records`` it holds already.

    ``manifest`` is the session's; ``withdrawn`` are numbers of records that are taken again; ``expected`` what the
    bench was set to when it stopped (setpoints); ``unit_answer`` is what the unit said when it was asked who
    it is; ``settled`` is False if the soak before the position was left unstable; ``event`` is the "resume" that
    the session is gone on with; ``read`` are the events of what was read and decided.
    """

    folder: Path
    manifest: Mapping[str, Any]
    start: int
    event: Resume
    records: int = 0
    withdrawn: tuple[int, ...] = ()
    expected: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    unit_answer: bytes | None = None
    settled: bool = True
    read: tuple[Event, ...] = ()

    def found(self, identities: Mapping[str, Any], differences: Sequence[str]) -> Resumption:
        """Return the same with what the bench is now, in the event."""
        return replace(self, event=replace(self.event, identities=identities, differences=differences))


@dataclass(frozen=True)
class Position:
    """The place a stopped run goes on from: its next step, the records that stay (the highest), those taken again."""

    start: int
    records: int
    withdrawn: tuple[int, ...]


def stopped_at(plan: Plan, entries: Sequence[JournalEntry], events: Sequence[Event]) -> Position:
    """Return position of a stopped run, from its journal and the events of its session.

    Either may have lost its end in a power cut. A record counts if its event is there; the point of the first one that
    is missing is taken again, and so is a point whose record was not verified any more. Of a run that could still say
    how it ended the journal is whole: a record behind it was not accepted. What a step has noted in the session counts
    like a record; a test of the unit is done again from the beginning of its item.
    """
    taken, skipped = _taken(plan, events)
    last = last_turn(events)
    told = isinstance(last, End)
    if isinstance(last, End) and last.error is None and "error" not in last.unknown:  # killed behind its last step
        number = len(plan.steps)
    else:
        number = _next_step(plan, entries, taken, skipped, told=told)
        # the steps that have noted in the session what, beside records, results are made of
        noted = {event.step for event in events if isinstance(event, Exchange | Reading | Prompt | Decision)}
        number = _first_lost(plan, number, taken, skipped, noted)
    if number < len(plan.steps):
        steps = plan.phase(plan.steps[number].phase)
        inside = number - steps[0].number
        first = point_start(steps, inside, readings_of(steps, _drivers(plan, steps)))
        inside = 0 if steps[0].phase == "finally" else _item_start(steps, first)
        number = steps[inside].number
    again = tuple(sorted(record for record, step in taken.items() if step >= number))
    return Position(number, max((record for record in taken if record not in again), default=0), again)


def last_turn(events: Sequence[Event]) -> End | Resume | None:
    """Return the last event that says that a run ended or was gone on with."""
    return next((event for event in reversed(events) if isinstance(event, End | Resume)), None)


def _taken(plan: Plan, events: Sequence[Event]) -> tuple[dict[int, int], list[range]]:
    """Return steps of the records that count, by number, and the ranges of steps that were skipped, in order."""
    taken: dict[int, int] = {}
    skipped = []
    for event in events:
        if isinstance(event, Record):
            taken[event.number] = event.step
        elif isinstance(event, Retake):
            taken.pop(event.record, None)
        elif isinstance(event, Skip):
            skipped.append(range(event.first, event.stop))
    skipped += left_out_by(plan.steps, events)
    return taken, sorted(skipped, key=lambda stretch: stretch.start)


def _next_step(
    plan: Plan, entries: Sequence[JournalEntry], taken: Mapping[int, int], skipped: Sequence[range], *, told: bool
) -> int:
    """Return number of the step behind the last one that is proved to be done, ``len(plan.steps)`` if all are."""
    number = entries[-1].number + 1 if entries else 0
    for stretch in skipped:
        number = stretch.stop if number in stretch else number
    last = max(taken.values(), default=-1)
    if last >= number:
        return number if told and entries else last + 1
    records = (step.number for step in plan.steps[last + 1 : number] if isinstance(step, PlannedRecord))
    lost = (record for record in records if not any(record in stretch for stretch in skipped))
    return next(lost, number)


def _first_lost(plan: Plan, number: int, taken: Mapping[int, int], skipped: Sequence[range], noted: set[int]) -> int:
    """Return the first step before ``number`` whose note the session lacks, behind the last that is; or it."""
    last = max((step for step in (*taken.values(), *noted) if step < number), default=-1)
    between = [step for step in plan.steps[last + 1 : number] if not any(step.number in stretch for stretch in skipped)]
    drivers = _drivers(plan, between)
    return next((step.number for step in between if step.leaves(drivers.get(step.role, {}))), number)


def _drivers(plan: Plan, steps: Steps) -> Drivers:
    instruments = plan.station.instruments
    roles = {step.role for step in steps if step.role in instruments}
    return {role: driver_actions(instruments[role].driver) for role in roles}


def _item_start(steps: Steps, index: int) -> int:
    """Return index of the first of the tests of one item, right behind each other, that go on with ``steps[index]``."""
    while index > 0 and _item(steps[index]) is not None and _item(steps[index]) == _item(steps[index - 1]):
        index -= 1
    return index


def _item(step: Step) -> tuple[Any, ...] | None:
    if not isinstance(step, PlannedCommand) or not step.item:
        return None
    return step.role, step.item, step.conditions.get("unit")


def readings_of(steps: Steps, drivers: Drivers) -> frozenset[int]:
    """Return numbers of the steps that only read an instrument; ``drivers``: declared actions by role."""
    calls = (step for step in steps if isinstance(step, PlannedCall))
    return frozenset(call.number for call in calls if call.leaves(drivers.get(call.role, {})))


def point_start(steps: Steps, index: int, readings: Container[int] = ()) -> int:
    """Return index of the first step of the point that holds ``steps[index]``: where its relays and level are set.

    The step itself if it belongs to no point, or to records that follow each other without a gap; but records with a
    motion or an act of a person between them are one recording of it, which begins with the first of them, and so are
    records of the first stage of a stop rule. Readings of
    instruments (their step numbers) right behind a record belong to it: they say how things were at its end.
    """
    record = _record_of(steps, index, readings)
    if record is not None and _follows(steps[record]):
        begun = _recording_start(steps, record)
        acts = any(is_motion(step) or isinstance(step, PlannedPrompt) for step in steps[begun:record])
        record = begun if acts or STAGE in steps[record].conditions else None
    if record is None:
        return index
    first = _start_of(steps, record)
    if first > index or any(isinstance(step, PlannedSoak) for step in steps[first : index + 1]):
        return index
    return first


def _follows(step: Step) -> bool:
    """Return whether a step is a record without a gap to the one before it."""
    return isinstance(step, PlannedRecord) and step.follows


def _recording_start(steps: Steps, record: int) -> int:
    """Return index of the first of the records that follow each other without a gap up to this one."""
    while record > 0 and (not isinstance(steps[record], PlannedRecord) or _follows(steps[record])):
        record -= 1
    return record


def in_point(steps: Steps, index: int, readings: Container[int] = ()) -> bool:
    """Return whether ``steps[index]`` belongs to a point, so that there is one to skip; a decision is not left out."""
    record = _record_of(steps, index, readings)
    return record is not None and isinstance(steps[record], PlannedRecord) and _start_of(steps, record) <= index


def point_stop(steps: Steps, index: int, readings: Container[int] = ()) -> int:
    """Return index behind the last step of the point that holds ``steps[index]``: record, verification, readings."""
    record = _record_of(steps, index, readings)
    stop = index if record is None else max(record, index)
    while stop + 1 < len(steps) and (_staged(steps[stop + 1]) or _closes(steps, stop + 1, record, readings)):
        stop += 1
    return stop + 1


def _staged(step: Step) -> bool:
    """Return whether a step goes on with a point that is measured in stages: a record, or the decision between them."""
    if isinstance(step, PlannedDecision):
        return step.word == UNTIL
    stage = step.conditions.get(STAGE) if isinstance(step, PlannedRecord) else None
    return stage is not None and (stage, step.conditions[STAGE_INDEX]) != (FIRST, 0)


def _closes(steps: Steps, index: int, record: int | None, readings: Container[int]) -> bool:
    if isinstance(steps[index], PlannedVerify):
        return True
    return steps[index].number in readings and record is not None and _record_of(steps, index, readings) == record


def _record_of(steps: Steps, index: int, readings: Container[int]) -> int | None:
    """Return index of the record of a point: the one that a verify step or a reading follows, else the next one."""
    ahead = _next_record(steps, index)
    if steps[index].number in readings and ahead is not None and _start_of(steps, ahead) <= index:
        return ahead  # a reading on the way to it
    at = index
    while at > 0 and (isinstance(steps[at], PlannedVerify) or steps[at].number in readings):
        at -= 1
    behind = isinstance(steps[at], PlannedRecord) or isinstance(steps[index], PlannedVerify)
    return _next_record(steps, at) if behind else ahead


def _next_record(steps: Steps, index: int) -> int | None:
    """Return index of the next record before any soak, and before any prompt that does not stand inside a recording.

    A decision is a point of its own, as a record is: its reading is taken again with the relays as they were.
    """
    for later in range(index, len(steps)):
        if isinstance(steps[later], PlannedDecision):
            return later
        if isinstance(steps[later], PlannedRecord):
            asked = any(isinstance(step, PlannedPrompt) for step in steps[index:later])
            return None if asked and not _follows(steps[later]) else later
        if isinstance(steps[later], PlannedSoak):
            return None
    return None


def _start_of(steps: Steps, record: int) -> int:
    """Return index of the step from which the point of a record is taken again."""
    step = steps[record]
    first = step.retry_step if isinstance(step, PlannedRecord | PlannedDecision) else step.number
    return max(0, first - steps[0].number)
