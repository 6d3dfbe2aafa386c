"""Standing still: the stimulus is taken away, everything else stays as it is, until nobody wants it any more.

Every instrument that drives a stimulus or leads it to the unit is made safe in the station's order (the calibrator goes
to standby before a relay opens), and so is a table, because somebody may come to it. Supply, clock and chamber go on,
so that the unit stays warm and its stream is watched; the frames that come meanwhile are recorded like any others.
Before anything is energised or moves again somebody arms the bench (bench.run.hold).

One that cannot be reached is tried again and again. Where nothing of the path of the stimulus is confirmed open, those
supplies that can be reached are switched off too, in the same order, and the run ends.

An instrument that has fallen silent is waited for, instead of ending the run in the night. Only silence is: a fault of
the calibrator or of the switch ends the run.

Arming: after a hold nothing is energised and nothing moves before somebody at the bench says so.

A hold makes the stimulus and the tables safe, and people come to a bench that stands still. So whoever sees it lets it
go on: by a resume at the bench, or by the answer to a question. It is asked before the way back (tables, temperature),
so that no wait comes between a temperature and its point. What a hold leaves as it was (supplies, chamber) needs
nobody. A station where nobody can be at the bench declares so, with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

from bench.model.clock import NS
from bench.model.errors import InstrumentError, RunError
from bench.model.events import Armed, Hold, HoldAlarm, Release, StimulusAlarm, by_instrument
from bench.model.ports import ENERGISING, Drivers, Effect, drivers_of, effects_of
from bench.plan import Step
from bench.run.bus.safety import QUICK_S, WayToSafe, hurried
from bench.run.context import RunContext
from bench.run.operator import Question
from bench.run.setpoints import drives, goes_off, motion_again, stimulus_again
from bench.run.stop import AWAY_LIMIT_S, Wish

LIMIT_S = 24 * 3600.0  # as a pause: somebody comes within a day, or the run ends safely


def arm(context: RunContext, step: int, first: int) -> bool:
    """Wait until somebody at the bench arms it for what follows from step ``first`` on; True if nobody need do so.

    Returns: False if there is a reason to hold again; who armed did not see it.
    Raises:  OperatorStop; RunError B-RUN-070 after a day, B-CLI-005 if nobody could ever answer.
    """
    roles = energised_again(context, first)
    if not roles:
        return True
    if reason := context.plan.station.never_armed:
        context.event(Armed(step=step, reason=reason))
        return True
    by = context.stop.holds.armed_by or _asked(context, roles)
    if context.stop.holds.reasons:
        return False
    context.event(Armed(step=step, by=by))
    return True


def _asked(context: RunContext, roles: Iterable[str]) -> str:
    """Return who has armed the bench, which is asked of a person."""
    text = f"Waits to be armed at the bench; energised or moved again: {', '.join(roles)}"
    question = Question(text, arms=True, limit_s=LIMIT_S)
    with context.stop.deferring(), context.stop.at_once():  # another reason to hold is looked at behind it
        by = context.operator.ask(question).by
    context.interlocks.look_again()  # it may have taken hours
    return by


def energised_again(context: RunContext, first: int) -> list[str]:
    """Return roles that the steps from ``first`` on, or the way back to it, switch on or move, in that order.

    What a hold leaves on counts only if it has not been switched on before.
    """
    drivers = drivers_of(context.instruments)
    left_out, steps = context.decided.left_out, context.plan.steps
    before = [step for step in steps[:first] if step.number not in left_out]
    left_on = {step.role for step in before if _energises(step, drivers)}
    left_on -= {role for role, instrument in context.instruments.items() if goes_off(type(instrument))}
    behind = [step for step in steps[first:] if step.number not in left_out]
    back = [*motion_again(steps, first, drivers, left_out), *stimulus_again(steps, first, drivers, left_out)]
    coming = [*back, *behind]
    roles = (step.role for step in coming if step.role not in left_on and _energises(step, drivers))
    return list(dict.fromkeys(roles))


def _energises(step: Step, drivers: Drivers) -> bool:
    """Return whether a step switches something on, closes a route or lets something move, or may do so."""
    return not ENERGISING.isdisjoint(step.effects(drivers.get(step.role, {})))


SILENT = ("B-INST-001", "B-INST-003", "B-INST-004")  # no answer, the bus failed, a reply that is not understood
ASK_S = 5.0
MOST_HOLDS = 3  # at one step: an instrument that answers its identity and never the step will not get better
POLL_S = 0.25
AGAIN_S = 1.0  # between two attempts to switch a stimulus off: one that comes back drives for no longer than 5 s
TOLD_S = 10.0  # between two alarms about a stimulus that is not confirmed off
ALARM_S = 600.0  # a person should look after this long


def wish_to_wait(context: RunContext, error: InstrumentError, role: str, held_before: int) -> Wish:
    """Hold the run because of an instrument; ``ask_again`` releases it when the instrument identifies itself again.

    Raises: the error itself if it is no silence, if the run may not be interrupted, or after ``MOST_HOLDS``.
    """
    if error.code not in SILENT or not context.stop.interruptible or held_before >= MOST_HOLDS:
        raise error
    return context.wait_for(role, f"{error.code}: {error.message}")


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
    order = context.plan.station.safe_order
    off = {role: context.instruments[role] for role in order if goes_off(type(context.instruments.get(role)))}
    way = WayToSafe(off, order, context.clock, context.in_use.take)
    way.attempt(quick=off)
    _tell_driven(context, way, step)
    _open_the_rest(context, way)
    armed = False
    while not armed:
        _until_nothing_holds(context, way, step, began_ns)
        context.interlocks.look_again()
        armed = not context.stop.holds.reasons and arm(context, step, first)
    held_ns = context.clock.now_ns() - began_ns
    context.event(Release(step=step, seconds=held_ns / NS))
    return held_ns


def _open_the_rest(context: RunContext, way: WayToSafe) -> None:
    """Switch the supplies off where neither source nor relays are confirmed: they are what is left of the path.

    Raises: RunError B-RUN-054 if one could be, because a unit without supply is no longer the unit of the plan.
    """
    order = context.plan.station.safe_order
    path = {role for role, instrument in context.instruments.items() if drives(type(instrument))} & set(order)
    if not path or not path <= way.failures.keys():
        return
    opened = [
        role
        for role in order
        if role not in path
        and Effect.POWER in effects_of(type(context.instruments[role]))
        and _switched_off(context, role)
    ]
    if opened:
        raise RunError(
            "B-RUN-054",
            f"neither source nor relays can be confirmed off; switched off instead: {', '.join(opened)}",
            where=", ".join(sorted(path)),
            next_step="find out why they do not answer, then 'bench resume SESSION'",
        )


def _switched_off(context: RunContext, role: str) -> bool:
    """Switch a supply off, whatever its declared safe state; return whether it was told to be.

    One that does not answer is told nothing: a command that comes late would switch it off under a run that went on.
    """
    instrument = context.instruments[role]
    with context.in_use.take(role), hurried(instrument, QUICK_S):
        try:
            getattr(instrument, "look", lambda: None)()
        except Exception:  # whatever it is
            return False
        with suppress(Exception):  # the end of the run makes it safe again, and says what is not confirmed
            getattr(instrument, "output_off", instrument.make_safe)()
    return True


def _until_nothing_holds(context: RunContext, way: WayToSafe, step: int, began_ns: int) -> None:
    """Wait until there is no reason to hold and nothing is driven any more.

    Args: way: of the instruments of the stimulus.   began_ns: when the run stopped.
    """
    tried_s, told_s, alarmed, asked_ns = 0.0, 0.0, False, began_ns
    while (reasons := context.stop.holds.reasons) or way.left:
        context.stop.check_stop()
        held_s = (context.clock.now_ns() - began_ns) / NS
        if way.left and held_s >= tried_s + AGAIN_S:
            way.attempt()
            _open_the_rest(context, way)
            tried_s = (context.clock.now_ns() - began_ns) / NS
            if tried_s >= told_s + TOLD_S:
                told_s = tried_s
                _tell_driven(context, way, step)
        if way.left and held_s > AWAY_LIMIT_S:
            raise _too_long(next(iter(way.left)), "not confirmed safe", AWAY_LIMIT_S)
        if (overdue := context.stop.holds.overdue(held_s)) is not None:
            raise _too_long(*overdue)
        if held_s >= ALARM_S and not alarmed:
            alarmed = True
            context.event(HoldAlarm(step=step, seconds=held_s, reasons=reasons))
        if not way.left and context.clock.now_ns() - asked_ns >= ASK_S * NS:  # the stimulus first
            ask_again(context)
            asked_ns = context.clock.now_ns()
        context.clock.sleep(POLL_S)


def _tell_driven(context: RunContext, way: WayToSafe, step: int) -> None:
    """Tell each instrument that could not be made safe, as an alarm."""
    for role, error in way.failures.items():
        if not isinstance(error, InstrumentError):
            raise error
        context.event(StimulusAlarm(step=step, role=role, code=error.code, text=error.message))


def _too_long(by: str, reason: str, limit_s: float) -> RunError:
    return RunError(
        "B-RUN-070",
        f"held for more than {limit_s:g} s: {reason}",
        where=by,
        next_step="remove the cause, then 'bench resume SESSION'",
    )
