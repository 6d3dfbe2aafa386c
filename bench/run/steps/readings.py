"""What an instrument reads: one value of a call step, or the rounds of readings that a record is made of."""

from __future__ import annotations

from collections.abc import Mapping

from bench.model.clock import to_ns
from bench.model.errors import InstrumentError
from bench.model.events import Reading
from bench.model.ports import Instrument, RecordWindow, actions_of
from bench.model.quality import Quality
from bench.plan import PlannedCall, PlannedRecord, PlannedVerify, is_reading, round_count
from bench.record import RecordRow, row_of_readings
from bench.run.context import RunContext

OVERLOAD = "B-INST-007"
NO_READING = (OVERLOAD, "B-INST-001", "B-INST-004")  # overload, silence, a reply that is not understood


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
