"""Arming: after a hold nothing is energised and nothing moves before somebody at the bench says so.

A hold makes the stimulus and the tables safe, and people come to a bench that stands still. So whoever sees it lets it
go on: by a resume at the bench, or by the answer to a question. It is asked before the way back (tables, temperature),
so that no wait comes between a temperature and its point. What a hold leaves as it was (supplies, chamber) needs
nobody. A station where nobody can be at the bench declares so, with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable

from bench.model.events import Armed
from bench.model.ports import ENERGISING, Drivers, drivers_of
from bench.plan import Step
from bench.run.context import RunContext
from bench.run.control.operator import Question
from bench.run.steps.setpoints import goes_off, motion_again

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
    context.look_again()  # it may have taken hours
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
    coming = [*motion_again(steps, first, drivers, left_out), *behind]
    roles = (step.role for step in coming if step.role not in left_on and _energises(step, drivers))
    return list(dict.fromkeys(roles))


def _energises(step: Step, drivers: Drivers) -> bool:
    """Return whether a step switches something on, closes a route or lets something move, or may do so."""
    return not ENERGISING.isdisjoint(step.effects(drivers.get(step.role, {})))
