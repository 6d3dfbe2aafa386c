"""What is left out behind a check that failed: every step done under its conditions, such as the rest of one unit.

What takes energy away is still done and confirmed; a step that could bring it is not.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.model.events import Skip
from bench.model.ports import Effect, drivers_of
from bench.plan import Step
from bench.run.context import RunContext
from bench.run.steps.dispatch import execute

BY = "check"
_OFF = frozenset({Effect.STIMULUS_OFF, Effect.ROUTES_OPEN})


def behind(steps: Sequence[Step], check: Step) -> int:
    """Return number of the first step behind a check that is not done under its conditions, in the phase of the check.

    ``steps``: those of the whole plan, so that a number is an index.
    """
    number, about = check.number + 1, check.conditions.items()
    while number < len(steps) and steps[number].phase == check.phase and about <= steps[number].conditions.items():
        number += 1
    return number


def leave_out(context: RunContext, check: Step) -> None:
    """Switch off what the steps behind a failed check switch off, then note that they are left out.

    Raises: InstrumentError of an instrument that does not confirm it.
    """
    steps, drivers = context.plan.steps, drivers_of(context.instruments)
    stop = behind(steps, check)
    for step in steps[check.number + 1 : stop]:
        if step.effects(drivers.get(step.role, {})) & _OFF or step.name == "output_off":
            execute(context, step)
    reason = f"a check without which nothing may follow has failed at step {check.number}"
    context.event(Skip(by=BY, reason=reason, first=check.number + 1, stop=stop))
