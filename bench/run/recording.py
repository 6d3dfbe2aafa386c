"""The record step: a window of frames cut by the unwrapped counter, retaken when too much was lost."""

from __future__ import annotations

from bench.model.clock import to_ns
from bench.model.errors import RunError
from bench.model.ports import RecordWindow
from bench.plan import Step
from bench.record import RecordRow
from bench.run.context import RunContext
from bench.run.wiring import check_wiring

OPEN_GATE = 1  # the gate that is open at the start began before it
SILENCE_S = 2.0
MEASUREMENT = "measurement"


def take_record(context: RunContext, step: Step) -> None:
    """Take one record; retake it while its losses exceed the limit and attempts are left.

    Raises: RunError B-RUN-021 if the unit is silent before the record or through all of it.
    """
    context.record_count += 1
    number = context.record_count
    attempts = 1 + int(step.arguments.get("retry", 0))
    max_lost = float(step.arguments.get("max_lost", 0.0))
    for attempt in range(attempts):
        row = _take(context, step, number)
        lost = row.lost / row.window.frames
        if lost <= max_lost or attempt == attempts - 1:
            break
        context.event("retake", record=number, reason=f"{row.lost} of {row.window.frames} frames lost")
        context.retaken += 1
        context.timeline.add_slip(to_ns(float(step.arguments["seconds"])))
    if row.frames == 0:
        raise _silent(context, f"no good frame during record {number}")
    context.rows[number] = row
    context.listener.record(row)
    if step.arguments.get("purpose", MEASUREMENT) == "wiring":
        check_wiring(row, context.plan.campaign, step.where)


def _take(context: RunContext, step: Step, number: int) -> RecordRow:
    reader = context.acquisition.readers[context.measurement_link]
    rate = float(context.plan.campaign["rate_Hz"])
    seconds = float(step.arguments["seconds"])
    with context.acquisition.lock:
        start_ns = context.clock.now_ns()
        context.acquisition.refresh()
        if reader.last_counter < 0 or start_ns - reader.last_frame_ns > to_ns(SILENCE_S + 2.0 / rate):
            raise _silent(context, f"no good frame for {SILENCE_S:g} s before record {number}")
        window = _window(context, step, number, start_ns)
        context.cutter.open(window)
    context.timeline.wait_for(seconds)
    last = window.first_counter + window.frames - 1
    deadline = window.t_end_ns + to_ns(SILENCE_S + 3.0 / rate + 0.001 * seconds)
    context.acquisition.wait_until(lambda: reader.last_counter >= last, deadline)
    with context.acquisition.lock:  # a replay takes the frames received up to the time of the event, no others
        context.sink.event("record", context.clock.now_ns(), window_fields(window))
        return context.cutter.close(number)


def _window(context: RunContext, step: Step, number: int, start_ns: int) -> RecordWindow:
    """The first frame is the first whose gate began after ``start_ns``, as far as the bytes received can tell.

    A frame of which no byte is here yet (11 us at 921,600 Bd, plus the delay of the port) makes the first gate begin
    that much too early; the settle time before a record is a thousand times longer.
    """
    reader = context.acquisition.readers[context.measurement_link]
    seconds = float(step.arguments["seconds"])
    on_the_wire = 1 if reader.mid_frame else 0
    return RecordWindow(
        number=number,
        link=reader.name,
        first_counter=reader.last_counter + on_the_wire + OPEN_GATE + 1,
        frames=round(seconds * float(context.plan.campaign["rate_Hz"])),
        t_start_ns=start_ns,
        t_end_ns=start_ns + to_ns(seconds),
        conditions={**step.conditions, **({} if context.settled else {"settled": False})},
        step=step.number,
    )


def _silent(context: RunContext, message: str) -> RunError:
    return RunError(
        "B-RUN-021",
        message,
        where=context.measurement_link,
        next_step="check supply, cable and stream mode of the unit, then start again",
    )


def window_fields(window: RecordWindow) -> dict[str, object]:
    """A record window as an event of the session."""
    return {
        "number": window.number,
        "link": window.link,
        "first_counter": window.first_counter,
        "frames": window.frames,
        "t_start_ns": window.t_start_ns,
        "t_end_ns": window.t_end_ns,
        "conditions": dict(window.conditions),
        "step": window.step,
    }


def measurement_rows(rows: dict[int, RecordRow]) -> list[RecordRow]:
    """The records that count, in order; wiring records are left out."""
    return [row for _, row in sorted(rows.items()) if row.window.conditions.get("purpose", MEASUREMENT) == MEASUREMENT]
