"""A unit that fails is left out of a campaign that several share: only once it is confirmed off do the others go on."""

from __future__ import annotations

from bench.model.errors import BenchError, RunError
from bench.model.events import UnitLeftOut
from bench.plan import UNIT, PlannedUnit, Step
from bench.run.bench.safety import make_safe
from bench.run.context import RunContext
from bench.run.steps.setpoints import drives

# A link that is silent or lost for longer than a hold, no or a wrong answer, another unit, its own wiring, and what is
# beyond a limit of its own for too long. All else concerns the bench or more than one unit, and ends the run.
OWN_FAULTS = (
    "B-RUN-021", "B-RUN-022", "B-RUN-023", "B-RUN-024", "B-RUN-025", "B-RUN-050", "B-RUN-051", "B-RUN-070",
)  # fmt: skip


def to_blame(context: RunContext, error: BenchError, step: Step) -> PlannedUnit | None:
    """Return the unit that an error concerns alone, None if the campaign cannot go on without it.

    The unit of the link that the error names, of the interlock, or of the step.
    """
    plan = context.plan
    if error.code not in OWN_FAULTS or not context.stop.interruptible or context.stop.over:
        return None
    limits = {f"interlock {rule.name}": rule.of for rule in plan.interlocks}
    unit = plan.unit_of(limits.get(error.where, error.where))
    if unit is None and error.where == step.where:
        unit = plan.unit_of(step.conditions.get(UNIT))
    others = [other for other in plan.units if other is not unit and other.serial not in context.decided.units_out]
    return unit if others and unit is not None and unit.serial not in context.decided.units_out else None


def leave_unit_out(context: RunContext, unit: PlannedUnit, error: BenchError, step: Step) -> None:
    """Take the stimulus away, open the routes and switch the unit's own instruments off, each confirmed by readback.

    Raises: RunError B-RUN-053 if one of them is not confirmed; then nothing may go on.
    """
    stimulus = {role for role, instrument in context.instruments.items() if drives(type(instrument))}
    off = [role for role in context.plan.station.safe_order if role in stimulus or role in unit.roles.values()]
    failures = make_safe(
        {role: context.instruments[role] for role in off}, off, context.clock, live=context.stop.is_alive
    )
    if failures:
        raise RunError(
            "B-RUN-053",
            f"unit {unit.serial} in slot {unit.slot} is not confirmed off ({'; '.join(map(str, failures))}); it failed "
            f"before: {error.message}",
            where=error.where,
            next_step="switch it off at its supply before anybody touches the bench",
        )
    for reason in (*unit.links.values(), *(rule.name for rule in context.plan.interlocks if rule.of in unit.names)):
        context.stop.holds.release(f"link {reason}")
        context.stop.holds.release(f"interlock {reason}")
    context.event(
        UnitLeftOut(
            uut=unit.serial, slot=unit.slot, step=step.number, code=error.code, reason=error.message, confirmed=off
        )
    )
