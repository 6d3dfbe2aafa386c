"""Which steps bring a table back to where it was before a step of the plan, after it was made safe on the way.

Its interlock is closed again if it was closed; each axis goes by an absolute move to where its moves and turns had
brought it, or spins again. The limits are settings, done again with all others (bench.run.steps.setpoints).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from bench.model.ports import Action, Effect
from bench.plan import PlannedCall, PlannedSettle, Step

_MOVE, _TURN, _SPIN = "move", "turn", "spin"
_STOP = "stop"

Drivers = Mapping[str, Mapping[str, Action]]


def can_move(actions: Mapping[str, Action]) -> bool:
    """Return whether an instrument with these actions is a table."""
    return any(action.effect is Effect.MOTION_ON for action in actions.values())


def is_motion(step: Step) -> bool:
    """Return whether a step of the plan sets an axis of a table moving."""
    return isinstance(step, PlannedCall) and step.name in (_MOVE, _TURN, _SPIN) and step.axis is not None


def motion_again(steps: Sequence[Step], number: int, drivers: Drivers) -> list[Step]:
    """Calls and settle times that bring all tables to where they were before step ``number``, in order.

    None inside ``finally``, where nothing has to move any more. An axis that was only turned, never moved, has no known
    angle to come back to; it stays where it is.
    """
    if number < len(steps) and steps[number].phase == "finally":
        return []
    again: list[Step] = []
    for role in sorted(role for role, actions in drivers.items() if can_move(actions)):
        calls = [step for step in steps[:number] if isinstance(step, PlannedCall) and step.role == role]
        closed = _closed(calls, drivers[role])
        if closed is not None:
            again += [closed, *_settle_behind(steps, closed.number, number)]
            again += _axes(steps, calls, number, drivers[role])
    return again


def changes_motion(step: Step, drivers: Drivers) -> bool:
    """Return whether a step moves a table, or opens or closes its interlock."""
    effect = _effect(step, drivers.get(step.role, {})) if isinstance(step, PlannedCall) else Effect.NONE
    return effect in (Effect.MOTION_ON, Effect.MOTION_OFF)


def _effect(step: Step, actions: Mapping[str, Action]) -> Effect:
    return actions[step.name].effect if step.name in actions else Effect.NONE


def _closed(calls: Sequence[PlannedCall], actions: Mapping[str, Action]) -> PlannedCall | None:
    """The call that closed the interlock, if it is closed."""
    closed = None
    for step in calls:
        effect = _effect(step, actions)
        if effect is Effect.MOTION_OFF:
            closed = None
        elif effect is Effect.MOTION_ON and step.axis is None:
            closed = step
    return closed


def _axes(
    steps: Sequence[Step], calls: Sequence[PlannedCall], number: int, actions: Mapping[str, Action]
) -> list[Step]:
    """The last motion of each axis as a move or a spin, and the longest settle time that follows one of them."""
    last: dict[int | None, PlannedCall] = {}
    for step in calls:
        if _effect(step, actions) is Effect.MOTION_OFF:  # what was turning came to rest, and stayed so
            last = {axis: one for axis, one in last.items() if one.name == _MOVE}
            continue
        axis, before = step.axis, last.get(step.axis)
        if step.name in (_MOVE, _SPIN):
            last[axis] = step
        elif step.name == _TURN and before is not None and before.name == _MOVE:
            angle = before.arguments["angle"] + step.arguments["angle"]
            last[axis] = replace(before, number=step.number, arguments={**before.arguments, "angle": angle % 360.0})
        elif step.name in (_TURN, _STOP) and not (before is not None and step.name == _STOP and before.name == _MOVE):
            last.pop(axis, None)
    motions = sorted(last.values(), key=lambda step: step.number)
    waits = [wait for step in motions for wait in _settle_behind(steps, step.number, number)]
    return [*motions, *sorted(waits, key=lambda step: -step.duration_s)[:1]]


def _settle_behind(steps: Sequence[Step], at: int, number: int) -> list[PlannedSettle]:
    """Return the first settle step behind step ``at``, before step ``number``."""
    return [step for step in steps[at + 1 : number] if isinstance(step, PlannedSettle)][:1]
