"""Measuring steps: a record of frames cut by the unwrapped counter, or of readings; one reading of a call step.

A record of which too much was lost is taken again; one of the wiring check must have moved the right counter of the
right channel the right way.

The beginning of a record: with the first whole gate from now on, or the frame right behind the record before it.

Records that follow each other are opened ahead: the frames of the next one arrive while the last ones of this one are
still being decoded, and while calls between the two keep the bus busy. No frame is in two of them, none in between.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bench.frame import signal_of
from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError, RunError
from bench.model.events import Gap, Reading, Record, Retake
from bench.model.ports import Instrument, RecordWindow, actions_of
from bench.model.quantities import Quality
from bench.plan import (
    WIRING,
    PlannedCall,
    PlannedPrompt,
    PlannedRecord,
    PlannedVerify,
    Step,
    is_measurement,
    is_reading,
    round_count,
)
from bench.record import RecordRow, row_of_readings
from bench.run.bus.port import cure
from bench.run.bus.reader import LinkReader
from bench.run.context import RunContext
from bench.run.links.unit import check_wiring

BEHIND_FRAMES = 2  # the newest frame is older than this many periods: the link is behind
OPEN_GATE = 1  # the gate that is open at the start began before it
SILENCE_S = 2.0
AHEAD_S = 100.0  # how late a step between two records may be (a bus that asks again) before a frame is missed


def begin_window(context: RunContext, step: PlannedRecord, number: int) -> RecordWindow:
    """Return the window of a record step, open, and with it those that follow it without a gap.

    Those that are taken together with it, of other units, are opened at the same moment. A step that follows another
    one begins anew if its first frames have gone by already.
    Raises: RunError B-RUN-021 if the unit is silent where a window begins anew.
    """
    with context.acquisition.lock:
        gates_ns = context.clock.now_ns()
        context.acquisition.refresh()
        start_ns = context.clock.now_ns()  # all that was decoded came before it: a replay, too, keeps only what follows
        window = context.ahead.pop(step.number, None)
        if window is None:
            window = _begin_anew(context, step, number, gates_ns, start_ns)
            for place, later in enumerate(_together(context, step), 1):
                begun = _begin_anew(context, later, number + place, gates_ns, start_ns)
                context.ahead[later.number] = begun
                _open_followers(context, later, begun)
        _open_followers(context, step, window)
    return window


def _begin_anew(context: RunContext, step: PlannedRecord, number: int, gates_ns: int, start_ns: int) -> RecordWindow:
    first = _first_counter(context, step, number, gates_ns)
    end_ns = start_ns + to_ns(step.seconds)
    if is_chained(context, step):
        end_ns = _due_ns(context, step.role, first + _frames(context, step))
    window = _window(context, step, number, first, start_ns, end_ns)
    _open(context, step, window)
    if step.follows:
        context.event(Gap(step=step.number, record=number, first_counter=window.first_counter))
    return window


def _together(context: RunContext, step: PlannedRecord) -> list[PlannedRecord]:
    """Return the records right behind a step that are taken together with it, without those that are left out."""
    steps, number = context.plan.steps, step.number + 1
    together = []
    while number < len(steps) and isinstance(later := steps[number], PlannedRecord) and later.together:
        together += [] if number in context.decided.left_out else [later]
        number += 1
    return together


def patience_s(context: RunContext, step: PlannedRecord) -> float:
    """Return how much later than due the last frame of a record may come, second."""
    return SILENCE_S + 3.0 / context.rate_Hz + 0.001 * step.seconds


def is_chained(context: RunContext, step: PlannedRecord) -> bool:
    """Return whether a record follows another one without a gap, or is followed by one."""
    return step.follows or next(_followers(context, step), None) is not None


def silent(reader: LinkReader, message: str) -> RunError:
    """The unit sends nothing."""
    return RunError(
        "B-RUN-021",
        message,
        where=reader.name,
        next_step=f"{cure(reader.link)}, then start again",
    )


def _first_counter(context: RunContext, step: PlannedRecord, number: int, gates_ns: int) -> int:
    """Return the counter of the first frame whose gate began after ``gates_ns``, as far as the bytes received tell.

    A frame of which no byte is here yet (11 us at 921,600 Bd, plus the delay of the port) makes the first gate begin
    that much too early; the settle time before a record is a thousand times longer. When frames are overdue, on a
    machine or an adapter that stalls, those that must be on their way are reckoned with: they belong to the settling.
    """
    reader = context.acquisition.readers[step.role]
    rate = context.rate_Hz
    if reader.last_counter < 0 or gates_ns - reader.last_frame_ns > to_ns(SILENCE_S + 2.0 / rate):
        raise silent(reader, f"no good frame for {SILENCE_S:g} s before record {number}")
    overdue = int((gates_ns - reader.last_frame_ns) * rate // NS)
    coming = overdue + 1 if overdue >= BEHIND_FRAMES else int(reader.mid_frame)
    return reader.last_counter + coming + OPEN_GATE + 1


def _open_followers(context: RunContext, step: PlannedRecord, window: RecordWindow) -> None:
    """Open the next window, and more until the longest wait for this one and AHEAD_S are covered.

    Never one that has begun: what was received since is counted already.
    """
    reader, now_ns = context.acquisition.readers[step.role], context.clock.now_ns()
    enough_ns = window.t_end_ns + to_ns(patience_s(context, step) + AHEAD_S)
    number = window.number
    for place, later in _followers(context, step):
        stop = window.first_counter + window.frames
        known = context.ahead.get(later.number)
        if known is None and (reader.last_counter >= stop or window.t_end_ns < now_ns):
            return
        if known is None:
            end_ns = _due_ns(context, step.role, stop + _frames(context, later))
            known = _window(context, later, number + place, stop, window.t_end_ns, end_ns)
            context.ahead[later.number] = known
            _open(context, later, known, chained=True)
        window = known
        if window.t_end_ns >= enough_ns:
            return


def _followers(context: RunContext, step: PlannedRecord) -> Iterator[tuple[int, PlannedRecord]]:
    """Yield the record steps of a link that follow ``step`` without a gap, each with how many records later it is."""
    steps, place = context.plan.steps, 0
    for number in range(step.number + 1, len(steps)):
        later = steps[number]
        if isinstance(later, PlannedRecord) and later.phase == step.phase and (later.follows or later.together):
            place += number not in context.decided.left_out
            if later.role == step.role and number not in context.decided.left_out:
                yield place, later
        elif not isinstance(later, PlannedCall | PlannedVerify | PlannedPrompt):  # nothing else may stand between
            return


def _open(context: RunContext, step: PlannedRecord, window: RecordWindow, chained: bool = False) -> None:
    definitions = {link: reader.definition for link, reader in context.acquisition.readers.items()}
    context.cutters[step.role].open(
        window, timed=step.pulse_timing, sampled=step.samples, chained=chained,
        signals=[signal_of(signal, definitions) for _, signal in step.signals],
    )  # fmt: skip


def _frames(context: RunContext, step: PlannedRecord) -> int:
    return round(step.seconds * context.rate_Hz)


def _due_ns(context: RunContext, link: str, stop: int) -> int:
    """Return when the frame before counter ``stop`` is due, by the newest frame: the unit's clock is not ours."""
    reader = context.acquisition.readers[link]
    rate = context.rate_Hz
    return reader.last_frame_ns + round((stop - 1 - reader.last_counter) / rate * NS)


def _window(
    context: RunContext, step: PlannedRecord, number: int, first: int, start_ns: int, end_ns: int
) -> RecordWindow:
    return RecordWindow(
        number=number,
        link=step.role,
        first_counter=first,
        frames=_frames(context, step),
        t_start_ns=start_ns,
        t_end_ns=end_ns,
        conditions=step.conditions if context.settled else {**step.conditions, "settled": False},
        step=step.number,
    )


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
    if is_measurement(row.window.conditions):
        context.measured.add(number)
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
