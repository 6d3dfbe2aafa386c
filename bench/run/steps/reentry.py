"""The way back into a plan after a hold or a stop: supplies, generator, unit, then the temperature, then the stimulus.

The unit is soaked again only if its temperature has left the band of the soak before the position. On a ramp the ramp
is done again from its start, so that the unit comes through the same temperatures, with the same lag and on the same
branch, and the position is entered when as much of the ramp has passed as the plan says.
"""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import replace

from bench.model.clock import NS, to_ns
from bench.model.events import Reentry
from bench.model.ports import drivers_of
from bench.model.units import finite
from bench.plan import PlannedSend, PlannedSettle, PlannedSoak, SetPoint, Step, Steps
from bench.run.context import RunContext, Timeline
from bench.run.operator import changes_of
from bench.run.setpoints import changes_motion, motion_again, steps_again, stimulus_again, warm_up_s
from bench.run.steps.dispatch import execute
from bench.run.steps.soak import drive, soak

UNIT_SPEAKS_S = 10.0  # housekeeping comes ten times a second once the unit streams


def enter(context: RunContext, start: int) -> None:
    """Bring a bench that was made safe to the state in which step ``start`` of the plan may begin.

    Raises: what the steps raise that are done again; RunError B-RUN-031 if a temperature is not reached.
    """
    if start == len(context.plan.steps):  # every step was done: nothing is switched on for the rest
        return
    left_out = context.decided.left_out
    done = (step for step in context.plan.steps[:start] if step.number not in left_out)
    for name, value in changes_of(done).items():
        context.message(f"taken to be as before: {name} {value}")
        context.operate(name, value)
    with context.stop.deferring():
        began_ns = context.clock.now_ns()
        again = steps_again(context.plan, start, drivers_of(context.instruments), left_out)
        _do_again(context, [*again, *_motion(context, start)])
        _warm_up(context, start, began_ns)
        _to_temperature(context, start, stopped=True)
        _do_again(context, _stimulus(context, start))


def come_back(context: RunContext, number: int) -> None:
    """After a hold: tables, which it brought to rest, the temperature and the stimulus as step ``number`` needs them.

    The chamber ran on. A soak that was interrupted needs no other: it goes on to its own, not back to the one before.

    Raises: B-RUN-031; InstrumentError of a table or of the stimulus.
    """
    with context.stop.deferring():
        _do_again(context, _motion(context, number))
    with context.stop.deferring():
        if not isinstance(context.plan.steps[number], PlannedSoak):
            _to_temperature(context, number, stopped=False)
        _do_again(context, _stimulus(context, number))


def jumped(context: RunContext, number: int, passed: Steps) -> None:
    """After a jump in the plan: what the steps ``passed`` move or drive is brought to where step ``number`` needs it.

    Tables are made safe before: where the plan has an interlock open, somebody may be asked to come to the table.
    Raises: InstrumentError of a table or of the stimulus.
    """
    moved = dict.fromkeys(step.role for step in passed if changes_motion(step, drivers_of(context.instruments)))
    with context.stop.deferring():
        for role in moved:
            context.message(f"{role}: brought to rest, then to where step {number} of the plan needs it")
            with context.in_use.take(role):
                context.instruments[role].make_safe()
        tables = _motion(context, number) if moved else []
        _do_again(context, [*tables, *_stimulus(context, number, {step.role for step in passed})])


def _motion(context: RunContext, number: int) -> list[Step]:
    return motion_again(context.plan.steps, number, drivers_of(context.instruments), context.decided.left_out)


def _stimulus(context: RunContext, number: int, roles: Container[str] | None = None) -> list[Step]:
    drivers, left_out = drivers_of(context.instruments), context.decided.left_out
    return stimulus_again(context.plan.steps, number, drivers, left_out, roles)


def _do_again(context: RunContext, steps: Steps) -> None:
    for step in steps:
        if isinstance(step, PlannedSettle):
            context.timeline.wait_until_ns(context.clock.now_ns() + to_ns(step.duration_s))
        else:
            what = step.text if isinstance(step, PlannedSend) else step.name
            context.message(f"again: {step.role}.{what}")
            execute(context, step)


def _warm_up(context: RunContext, start: int, began_ns: int) -> None:
    """Wait once more for the longest settle time of the preparation: whatever is on since ``began_ns`` had been off."""
    steps = context.plan.steps
    rest_ns = began_ns + to_ns(warm_up_s(context.plan, start, context.decided.left_out)) - context.clock.now_ns()
    if rest_ns > 0 and steps[start].phase != "finally":
        context.message(f"warming up again for {rest_ns / NS:.0f} s, as in the preparation")
        context.timeline.wait_until_ns(context.clock.now_ns() + rest_ns)


def thermal_steps(steps: Steps, number: int, left_out: Container[int] = ()) -> list[tuple[Step, SetPoint]]:
    """Return soaks and set-points of the chamber before a step, oldest first; none inside ``finally``."""
    done = (step for step in steps[:number] if step.number not in left_out)
    set_points = [(step, step.set_point) for step in done if step.set_point is not None]
    return set_points if number < len(steps) and steps[number].phase != "finally" else []


def _to_temperature(context: RunContext, number: int, *, stopped: bool) -> None:
    thermal = thermal_steps(context.plan.steps, number, context.decided.left_out)
    if not thermal:
        return
    began_ns, (newest, asked) = context.clock.now_ns(), thermal[-1]
    found_degC = _units_degC(context, newest)
    if isinstance(newest, PlannedSoak):
        soaked = not all(abs(degC - newest.temperature_degC) <= newest.within_degC for degC in found_degC)
        _back_to_soak(context, newest, soaked=soaked, stopped=stopped)
    else:
        soaked = True
        _along_the_ramp(context, thermal, context.plan.steps[number])
    context.event(
        Reentry(
            step=number,
            target_degC=asked.temperature_degC,
            soaked=soaked,
            unit_degC=finite(max(found_degC)),
            seconds=(context.clock.now_ns() - began_ns) / NS,
        )
    )


def _back_to_soak(context: RunContext, step: PlannedSoak, *, soaked: bool, stopped: bool) -> None:
    if soaked:
        band = f"{step.temperature_degC:g} degC +- {step.within_degC:g} degC"
        context.message(f"the unit has left {band}: soaking again")
        _soak_again(context, step)
    elif stopped:
        drive(context, step.role, step.set_point)


def _along_the_ramp(context: RunContext, thermal: Sequence[tuple[Step, SetPoint]], step: Step) -> None:
    """Soak where the ramp begins, start it, and wait until the planned time since its start has passed."""
    newest, asked = thermal[-1]
    pattern = next((before for before, _ in reversed(thermal) if isinstance(before, PlannedSoak)), None)
    if pattern is not None:  # so there is one before the newest, which is none
        start_degC = thermal[-2][1].temperature_degC
        context.message(f"the ramp from {start_degC:g} degC to {asked.temperature_degC:g} degC is done again")
        _soak_again(context, replace(pattern, temperature_degC=start_degC, late="hold"))
    drive(context, newest.role, asked)
    passed_s = step.at_s - newest.at_s if step.phase == newest.phase else 0.0
    context.timeline.wait_until_ns(context.clock.now_ns() + to_ns(passed_s))


def _soak_again(context: RunContext, step: PlannedSoak) -> None:
    """The whole slot of a soak, even with ``done``, from now on; the timeline of the phase stands still meanwhile."""
    outer = context.timeline
    context.timeline = Timeline(context.clock, context.stop, context.clock.now_ns() - to_ns(step.at_s))
    try:
        soak(context, replace(step, residual_degC=None, least_s=None))
    finally:
        context.timeline = outer


def _units_degC(context: RunContext, step: Step) -> list[float]:
    """Return the temperatures a soak is judged by, degC, of every unit; NaN of one that is silent ``UNIT_SPEAKS_S``."""
    if isinstance(step, PlannedSoak) and step.sensor == "air":
        with context.in_use.take(step.role):
            return [float(context.instruments[step.role].measure_air())]  # type: ignore[attr-defined]
    deadline_ns = context.clock.now_ns() + to_ns(UNIT_SPEAKS_S)
    context.acquisition.wait_until(lambda: not any(map(math.isnan, context.unit_temperatures_degC)), deadline_ns, 0.2)
    return context.unit_temperatures_degC
