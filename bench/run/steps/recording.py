"""The record step: a window of frames cut by the unwrapped counter, or of readings; again when too much was lost."""

from __future__ import annotations

from collections.abc import Mapping

from bench.model.clock import to_ns
from bench.model.events import Record, Retake
from bench.model.ports import RecordWindow
from bench.plan import MEASUREMENT, WIRING, PlannedRecord
from bench.record import RecordRow
from bench.run.bench.wiring import check_wiring
from bench.run.context import RunContext
from bench.run.steps.readings import take_readings
from bench.run.steps.windows import begin_window, is_chained, patience_s, silent


def take_record(context: RunContext, step: PlannedRecord) -> None:
    """Take one record; retake it while its losses exceed the limit and attempts are left.

    Raises: RunError B-RUN-021 if the unit is silent before the record or through all of it.
    """
    context.record_count += 1
    number = context.record_count
    attempts = 1 + step.retry
    for attempt in range(attempts):
        row = _take(context, step, number) if context.measurement_link else _read(context, step, number)
        lost, due, what = _losses(row)
        if lost / due <= step.max_lost or attempt == attempts - 1:
            break
        context.event(Retake(record=number, reason=f"{lost} of {due} {what} lost"))
        context.retaken += 1
        context.timeline.add_slip(to_ns(step.seconds))
    if row.window.link and row.frames == 0 and not (is_chained(context, step) and _goes_on(context, row)):
        raise silent(context, f"no good frame during record {number}")
    context.rows[number] = row
    context.observers.record(row)
    if step.purpose == WIRING:
        check_wiring(row, context.plan.campaign, step.where)


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
    reader = context.acquisition.readers[context.measurement_link]
    return reader.last_counter >= row.window.first_counter + row.window.frames


def _take(context: RunContext, step: PlannedRecord, number: int) -> RecordRow:
    reader = context.acquisition.readers[context.measurement_link]
    window = begin_window(context, step, number)
    context.timeline.wait_until_ns(window.t_end_ns)
    last = window.first_counter + window.frames - 1
    deadline = window.t_end_ns + to_ns(patience_s(context, step))
    context.acquisition.wait_until(lambda: reader.last_counter >= last, deadline)
    with context.acquisition.lock:  # a replay takes the frames received up to the time of the event, no others
        context.acquisition.catch_up()
        context.event(_event_of(window, pulse_timing=step.pulse_timing, samples=step.samples))
        return context.frames_cutter.close(number)


def _event_of(
    window: RecordWindow,
    *,
    pulse_timing: bool = False,
    samples: bool = False,
    readings: int | None = None,
    unread: int | None = None,
) -> Record:
    return Record(
        number=window.number,
        link=window.link,
        first_counter=window.first_counter,
        frames=window.frames,
        t_start_ns=window.t_start_ns,
        t_end_ns=window.t_end_ns,
        conditions=dict(window.conditions),
        step=window.step,
        pulse_timing=pulse_timing,
        samples=samples,
        readings=readings,
        unread=unread,
    )


def measurement_rows(rows: Mapping[int, RecordRow]) -> list[RecordRow]:
    """Return the records that count, in order; wiring records are left out."""
    return [row for _, row in sorted(rows.items()) if row.window.conditions.get("purpose", MEASUREMENT) == MEASUREMENT]
