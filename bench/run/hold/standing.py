"""Standing still: the stimulus is off, everything else stays as it is, until nobody wants it any more.

Off means: every instrument that drives a stimulus or leads it to the unit is made safe in the station's order (the
calibrator goes to standby before a relay opens), and so is a table, because somebody may come to it. Supply, clock and
chamber go on, so that the unit stays warm and its stream is watched; the frames that come meanwhile are recorded like
any others. Before anything is energised or moves again somebody arms the bench (bench.run.hold.arming).

An instrument that has fallen silent is waited for, instead of ending the run in the night. The bus session has climbed
its whole ladder by then. Only one outside the stimulus is waited for: when the calibrator or the switch cannot be told
to be safe the run ends.
"""

from __future__ import annotations

from bench.model.clock import NS
from bench.model.errors import InstrumentError, RunError
from bench.model.events import Hold, HoldAlarm, Release, StimulusAlarm, by_instrument
from bench.run.context import RunContext
from bench.run.hold.arming import arm
from bench.run.steps.setpoints import goes_off
from bench.run.stop import Wish

SILENT = ("B-INST-001", "B-INST-003", "B-INST-004")  # no answer, the bus failed, a reply that is not understood
ASK_S = 5.0
LIMIT_S = 1800.0
MOST_HOLDS = 3  # at one step: an instrument that answers its identity and never the step will not get better
POLL_S = 0.25
AGAIN_S = 2.0  # between two attempts to switch a stimulus off
UNSAFE_LIMIT_S = 1800.0
ALARM_S = 600.0  # a person should look after this long


def wish_to_wait(context: RunContext, error: InstrumentError, role: str, held_before: int) -> Wish:
    """Hold the run because of an instrument; ``ask_again`` releases it when the instrument identifies itself again.

    Raises: the error itself if it is no silence, if the run may not be interrupted, or after ``MOST_HOLDS``.
    """
    if error.code not in SILENT or not context.stop.interruptible or held_before >= MOST_HOLDS:
        raise error
    wish = Wish("hold", by_instrument(role), f"{error.code}: {error.message}")
    context.stop.holds.hold(wish.by, wish.reason, LIMIT_S)
    context.away.add(role)
    return wish


def ask_again(context: RunContext) -> None:
    """Ask the instruments that are waited for who they are, on the thread of the steps.

    A thread of its own would climb its ladder with the bus held, and keep the steps from making a stimulus safe; the
    guard would take them for hanging. Raises: InstrumentError if another one answers; what ``stop.check_stop`` raises.
    """
    for role in sorted(context.away):
        context.stop.check_stop()
        try:
            with context.in_use.take(role):
                context.instruments[role].identify()
        except InstrumentError as still:
            if still.code not in SILENT:
                raise
        else:
            context.away.discard(role)
            context.stop.holds.release(by_instrument(role))


def stand_still(context: RunContext, wish: Wish, step: int, first: int) -> int:
    """Switch the stimulus off and wait until the last reason to hold is gone; returns how long, ns.

    An instrument of the stimulus that cannot be told to be safe is told again and again; nothing goes on before. Then
    the interlocks are read once more, and somebody arms the bench for what is energised from step ``first`` on.
    Raises: RunError B-RUN-070 when it lasts longer than the limit of a reason; OperatorStop; the fault of another
    thread.
    """
    began_ns = context.clock.now_ns()
    context.event(Hold(step=step, by=wish.by, reason=wish.reason))
    off = [role for role in context.plan.station.safe_order if goes_off(type(context.instruments.get(role)))]
    driven = _still_driven(context, off, step)
    armed = False
    while not armed:
        _until_nothing_holds(context, driven, step, began_ns)
        driven = []
        context.look_again()
        armed = not context.stop.holds.reasons and arm(context, step, first)
    held_ns = context.clock.now_ns() - began_ns
    context.event(Release(step=step, seconds=held_ns / NS))
    return held_ns


def _until_nothing_holds(context: RunContext, driven: list[str], step: int, began_ns: int) -> None:
    """Wait until there is no reason to hold and nothing is driven any more.

    Args: driven: instruments of the stimulus that are not confirmed safe yet.   began_ns: when the run stopped.
    """
    tried_s, alarmed, asked_ns = 0.0, False, began_ns
    while (reasons := context.stop.holds.reasons) or driven:
        context.stop.check_stop()
        held_s = (context.clock.now_ns() - began_ns) / NS
        if driven and held_s >= tried_s + AGAIN_S:
            driven, tried_s = _still_driven(context, driven, step), held_s
        if driven and held_s > UNSAFE_LIMIT_S:
            raise _too_long(driven[0], "not confirmed safe", UNSAFE_LIMIT_S)
        if (overdue := context.stop.holds.overdue(held_s)) is not None:
            raise _too_long(*overdue)
        if held_s >= ALARM_S and not alarmed:
            alarmed = True
            context.event(HoldAlarm(step=step, seconds=held_s, reasons=reasons))
        if context.clock.now_ns() - asked_ns >= ASK_S * NS:
            ask_again(context)
            asked_ns = context.clock.now_ns()
        context.clock.sleep(POLL_S)


def _still_driven(context: RunContext, roles: list[str], step: int) -> list[str]:
    """Make these instruments safe in their order; those that could not be, each told as an alarm."""
    left = []
    for role in roles:
        try:
            with context.in_use.take(role):
                context.instruments[role].make_safe()
        except InstrumentError as error:
            left.append(role)
            context.event(StimulusAlarm(step=step, role=role, code=error.code, text=error.message))
    return left


def _too_long(by: str, reason: str, limit_s: float) -> RunError:
    return RunError(
        "B-RUN-070",
        f"held for more than {limit_s:g} s: {reason}",
        where=by,
        next_step="remove the cause, then 'bench resume SESSION'",
    )
