"""Measuring steps: a record of frames cut by the unwrapped counter, or of readings; one reading of a call step.

A record of which too much was lost is taken again; one of the wiring check must have moved the right counter of the
right channel the right way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.clock import to_ns
from bench.model.errors import InstrumentError
from bench.model.events import Reading, Record, Retake
from bench.model.ports import Instrument, RecordWindow, actions_of
from bench.model.quantities import Quality
from bench.plan import WIRING, PlannedCall, PlannedRecord, PlannedVerify, Step, is_measurement, is_reading, round_count
from bench.record import RecordRow, row_of_readings
from bench.run.context import RunContext
from bench.run.steps.proof import check_wiring
from bench.run.steps.windows import begin_window, is_chained, patience_s, silent

OVERLOAD = "B-INST-007"
NO_READING = (OVERLOAD, "B-INST-001", "B-INST-004")  # overload, silence, a reply that is not understood


def take_record(context: RunContext, step: PlannedRecord) -> None:
    """Take one record; retake it while its losses exceed the limit and attempts are left.

    Raises: RunError B-RUN-021 if the unit is silent before the record or through all of it.
    """
    context.record_count += 1
    number = context.record_count
    attempts = 1 if is_chained(context, step) else 1 + step.retry
    for attempt in range(attempts):
        row = _take(context, step, number) if step.role else _read(context, step, number)
        lost, due, what = _losses(row)
        if lost / due <= step.max_lost or attempt == attempts - 1:
            break
        context.event(Retake(record=number, reason=f"{lost} of {due} {what} lost"))
        context.retaken += 1
        context.timeline.add_slip(to_ns(step.seconds))
    if row.window.link and row.frames == 0 and not (is_chained(context, step) and _goes_on(context, row)):
        raise silent(context.acquisition.readers[step.role], f"no good frame during record {number}")
    context.rows[number] = row
    context.observers.record(row)
    if step.purpose == WIRING:
        check_wiring(row, context.plan, step.where)


def _losses(row: RecordRow) -> tuple[int, int, str]:
    """Return how many frames or readings of a record are lost, of how many, and what they are called."""
    if not row.window.link:
        return row.unread, row.readings + row.unread, "readings"
    return row.lost, row.window.frames, "frames"


def _read(context: RunContext, step: PlannedRecord, number: int) -> RecordRow:
    row = take_readings(context, step, number)
    context.event(_event_of(row.window, readings=row.readings, unread=row.unread))
    return row


def _goes_on(context: RunContext, row: RecordRow) -> bool:
    """Return frames came behind the record: the unit is not silent, and a window that is lost costs no other one."""
    reader = context.acquisition.readers[row.window.link]
    return reader.last_counter >= row.window.first_counter + row.window.frames


def _take(context: RunContext, step: PlannedRecord, number: int) -> RecordRow:
    reader = context.acquisition.readers[step.role]
    window = begin_window(context, step, number)
    context.timeline.wait_until_ns(window.t_end_ns)
    last = window.first_counter + window.frames - 1
    deadline = window.t_end_ns + to_ns(patience_s(context, step))
    context.acquisition.wait_until(lambda: reader.last_counter >= last, deadline)
    with context.acquisition.at_rest():  # a replay takes the frames received up to the time of the event, no others
        signals = tuple(signal for _, signal in step.signals)
        context.event(_event_of(window, pulse_timing=step.pulse_timing, samples=step.samples, signals=signals))
        return context.cutters[step.role].close(number)


def _event_of(window: RecordWindow, **more: Any) -> Record:
    """Return the event of a record, which has the fields of its window and ``more``."""
    return Record(**{**vars(window), "conditions": dict(window.conditions)}, **more)


def measurement_rows(rows: Mapping[int, RecordRow]) -> list[RecordRow]:
    """Return the records that count, in order; wiring records are left out."""
    return [row for _, row in sorted(rows.items()) if is_measurement(row.window.conditions)]


def act(
    context: RunContext, step: PlannedCall | PlannedVerify, arguments: Mapping[str, object] | None = None
) -> object:
    """Call the action of a step; what it returns becomes an event, with the arguments that are to stand in it."""
    method = getattr(context.instruments[step.role], step.name)
    with context.in_use.take(step.role):
        result = method(**step.told())
    if result is not None:
        context.event(reading_of(step, result, arguments=arguments))
    return result


def reading_of(step: Step, value: object, **more: Any) -> Reading:
    """Return what a step has read as an event; ``more``: its other fields."""
    name, conditions = step.name or step.kind, dict(step.conditions)
    return Reading(step=step.number, role=step.role, name=name, value=value, conditions=conditions, **more)


def call_or_flag(context: RunContext, step: PlannedCall, arguments: Mapping[str, object] | None = None) -> Quality:
    """Call an action; one that only measures and gets no reading is a flagged reading: no reason to end a run."""
    try:
        act(context, step, arguments)
    except InstrumentError as error:
        if error.code not in NO_READING or not _only_measures(context.instruments[step.role], step.name):
            raise
        flag = Quality.OVERLOAD if error.code == OVERLOAD else Quality.NOT_FINITE
        about = {"quality": int(flag), "code": error.code, "text": error.message}
        context.event(reading_of(step, None, arguments=arguments, **about))
        context.message(f"{error.where}: {error.message}; the reading is flagged, the run goes on")
        return flag
    return Quality.GOOD


def take_readings(context: RunContext, step: PlannedRecord, number: int) -> RecordRow:
    """Take the rounds of a record of readings; a round that is late begins at once, and none is left out."""
    start_ns, every_ns = context.clock.now_ns(), to_ns(step.every_s)
    flags: list[Quality] = []
    for index in range(round_count(step)):
        context.timeline.wait_until_ns(start_ns + index * every_ns)
        for call in step.calls:
            context.stop.check()
            flags.append(call_or_flag(context, call, dict(call.arguments)))
    context.timeline.wait_until_ns(start_ns + to_ns(step.duration_s))
    conditions = step.conditions if context.settled else {**step.conditions, "settled": False}
    window = RecordWindow(number, "", 0, 0, start_ns, context.clock.now_ns(), conditions, step.number)
    return row_of_readings(window, flags)


def _only_measures(instrument: Instrument, name: str) -> bool:
    declared = actions_of(type(instrument)).get(name)
    return declared is not None and is_reading(declared)
