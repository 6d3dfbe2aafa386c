"""Measuring steps: a record of frames cut by the unwrapped counter, or of readings; one reading of a call step.

A record of which too much was lost is taken again; one of the wiring check must have moved the right counter of the
right channel the right way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.model.clock import to_ns
from bench.model.errors import InstrumentError, RunError
from bench.model.events import Reading, Record, Retake
from bench.model.ports import Instrument, RecordWindow, actions_of
from bench.model.quality import Quality
from bench.plan import MEASUREMENT, WIRING, PlannedCall, PlannedRecord, PlannedVerify, is_reading, round_count
from bench.record import RecordRow, row_of_readings
from bench.run.context import RunContext
from bench.run.steps.windows import begin_window, is_chained, patience_s, silent

OVERLOAD = "B-INST-007"
NO_READING = (OVERLOAD, "B-INST-001", "B-INST-004")  # overload, silence, a reply that is not understood
TOLERANCE = 0.1


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
        signals = tuple(signal for _, signal in step.signals)
        context.event(_event_of(window, pulse_timing=step.pulse_timing, samples=step.samples, signals=signals))
        return context.frames_cutter.close(number)


def _event_of(window: RecordWindow, **more: Any) -> Record:
    """Return the event of a record, which has the fields of its window and ``more``."""
    return Record(**{**vars(window), "conditions": dict(window.conditions)}, **more)


def measurement_rows(rows: Mapping[int, RecordRow]) -> list[RecordRow]:
    """Return the records that count, in order; wiring records are left out."""
    return [row for _, row in sorted(rows.items()) if row.window.conditions.get("purpose", MEASUREMENT) == MEASUREMENT]


def act(
    context: RunContext, step: PlannedCall | PlannedVerify, arguments: Mapping[str, object] | None = None
) -> object:
    """Call the action of a step; what it returns becomes an event, with the arguments that are to stand in it."""
    method = getattr(context.instruments[step.role], step.name)
    with context.in_use.take(step.role):
        result = method(**step.told())
    if result is not None:
        role, name, conditions = step.role, step.name, dict(step.conditions)
        context.event(
            Reading(step=step.number, role=role, name=name, value=result, conditions=conditions, arguments=arguments)
        )
    return result


def call_or_flag(context: RunContext, step: PlannedCall, arguments: Mapping[str, object] | None = None) -> Quality:
    """Call an action; one that only measures and gets no reading is a flagged reading: no reason to end a run."""
    try:
        act(context, step, arguments)
    except InstrumentError as error:
        if error.code not in NO_READING or not _only_measures(context.instruments[step.role], step.name):
            raise
        flag = Quality.OVERLOAD if error.code == OVERLOAD else Quality.NOT_FINITE
        context.event(
            Reading(
                step=step.number,
                role=step.role,
                name=step.name,
                value=None,
                conditions=dict(step.conditions),
                quality=int(flag),
                code=error.code,
                text=error.message,
                arguments=arguments,
            )
        )
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


def check_wiring(row: RecordRow, campaign: Mapping[str, Any], where: str) -> None:
    """Judge one wiring record.

    No other channel may count more than a tenth of what the current would give it; the channel under current must
    count within 10 % of current x time / charge per pulse on NPP (positive current) or PPP (negative current) and
    almost nothing on the other.

    Raises: RunError B-RUN-051 (current reached another channel), B-RUN-050 (wrong counter, polarity or amount).
    """
    _check_others(row, campaign, where)
    _check_own(row, campaign, where)


def _check_own(row: RecordRow, campaign: Mapping[str, Any], where: str) -> None:
    conditions = row.window.conditions
    channel, polarity = int(conditions["channel"]), int(conditions["polarity"])
    charges = _charges_C(campaign)
    seconds = row.frames / float(campaign["rate_Hz"])
    expected = float(conditions["current_A"]) * seconds / charges[channel]
    moved, still = ("npp", "ppp") if polarity > 0 else ("ppp", "npp")
    right, wrong = int(row.sums[moved][channel - 1]), int(row.sums[still][channel - 1])
    level = f"{'+' if polarity > 0 else '-'}{conditions['current_A']:g} A"
    if abs(right - expected) > TOLERANCE * expected or wrong > TOLERANCE * expected:
        raise RunError(
            "B-RUN-050",
            f"channel {channel}, {level}: counted {right} {moved} and {wrong} {still}, "
            f"expected {expected:.0f} {moved} within {TOLERANCE:.0%}",
            where=where,
            next_step="check polarity and channel of the cable between switch and unit, then start again",
        )


def _check_others(row: RecordRow, campaign: Mapping[str, Any], where: str) -> None:
    conditions = row.window.conditions
    channel = int(conditions["channel"])
    charges = _charges_C(campaign)
    charge_C = float(conditions["current_A"]) * row.frames / float(campaign["rate_Hz"])
    counts = row.sums["npp"] + row.sums["ppp"]
    limits = [TOLERANCE * charge_C / charges.get(number, charges[channel]) for number in range(1, len(counts) + 1)]
    excess = counts - np.array(limits)
    excess[channel - 1] = 0.0
    if (excess > 0).any():
        guilty = int(np.argmax(excess)) + 1
        raise RunError(
            "B-RUN-051",
            f"the current of channel {channel} moves channel {guilty}: counted {counts[guilty - 1]} there and "
            f"{counts[channel - 1]} on channel {channel}",
            where=where,
            next_step="check the cable and the crosspoints, then start again",
        )


def _charges_C(campaign: Mapping[str, Any]) -> dict[int, float]:
    """Return charge per pulse by channel, coulomb."""
    return {int(entry["number"]): float(entry["k0_C"]) for entry in campaign["channels"]}
