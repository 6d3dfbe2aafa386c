"""Static check of tables that move: limits, then interlock, then motion; nobody at a table that may move; its poses.

An instrument is a table if its driver declares an action with the effect "motion on". One without an axis makes the
table ready (``close_interlock``), one with an ``axis`` moves it; ``set_limits`` says how fast an axis may be. What a
record says of the table and of the unit on it must be what was done before it: an analysis takes gravity and the
Earth's rate from these conditions, and a wrong one becomes a wrong number without any other sign.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import Any

from bench.model.ports import Action, Drivers, Effect, can_move
from bench.model.quantities import Values
from bench.plan.drivers import declared_action
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedCall, PlannedCommand, PlannedPrompt, PlannedRecord
from bench.plan.ways import Followed, walk

_LIMITED = ("rate", "acceleration")
_SET_LIMITS = "set_limits"
AXES = {1: "outer_deg", 2: "middle_deg", 3: "inner_deg"}
_MOVE, _TURN = "move", "turn"


class MotionState:
    """Follows the tables of a bench, step by step.

    Args: drivers: declared actions of each role. ``may_move`` holds the roles whose interlocks are closed,
    with the place where they were.
    """

    def __init__(self, plan: Plan, drivers: Drivers, findings: Findings) -> None:
        self._findings = findings
        self._origins = plan.origins
        self._tables = {role: actions for role, actions in drivers.items() if can_move(actions)}
        self._axes = {role: _axes_of(actions) for role, actions in self._tables.items()}
        self._limits: dict[tuple[str, Any], Values] = {}
        self.may_move: dict[str, str] = {}

    def copy(self) -> MotionState:
        """Return a state that goes on by itself."""
        other = copy(self)
        other._limits, other.may_move = dict(self._limits), dict(self.may_move)
        return other

    def key(self) -> Hashable:
        """Return what tells the state from others."""
        return repr(sorted(self._limits.items(), key=repr)), tuple(sorted(self.may_move.items()))

    def call(self, step: Step, action: Action, usable: Values) -> None:
        """Apply one call to a table; note what it breaks."""
        if step.role not in self._tables:
            return
        if action.name == _SET_LIMITS:
            self._set_limits(step, usable)
        elif action.effect is Effect.MOTION_OFF:
            self.may_move.pop(step.role, None)
        elif action.effect is Effect.MOTION_ON and "axis" in usable:
            self._motion(step, usable)
        elif action.effect is Effect.MOTION_ON:
            self._close(step)

    def raw(self, step: Step) -> None:
        """Raw text to a table may close its interlocks."""
        if step.role in self._tables:
            self.may_move.setdefault(step.role, step.where)

    def prompt(self, step: Step) -> None:
        """Whoever answers a prompt may stand at the table."""
        for role, where in sorted(self.may_move.items()):
            message = f"somebody is asked to act while the {role} may move (from {where} on)"
            self._findings.add("B-PLAN-087", step.where, message, "open its interlock before the prompt")

    def _set_limits(self, step: Step, usable: Values) -> None:
        if step.role in self.may_move:
            message = f"{step.role}.{step.name} is called with the interlock closed"
            self._findings.add("B-PLAN-088", step.where, message, "set the limits before the interlock is closed")
        self._limits[step.role, usable.get("axis")] = usable

    def _close(self, step: Step) -> None:
        missing = [axis for axis in self._axes[step.role] if (step.role, axis) not in self._limits]
        if missing:
            message = f"{step.role}.{step.name} before {_SET_LIMITS} of axis {', '.join(map(str, missing))}"
            self._findings.add("B-PLAN-088", step.where, message, "set the limits of every axis before it")
        self.may_move[step.role] = step.where

    def _motion(self, step: Step, usable: Values) -> None:
        limits = self._limits.get((step.role, usable["axis"]))
        missing = _SET_LIMITS if limits is None else "" if step.role in self.may_move else "the interlock is closed"
        if missing:
            message = f"{step.role}.{step.name} moves axis {usable['axis']} before {missing}"
            self._findings.add("B-PLAN-088", step.where, message, "set the limits, close the interlock, then move")
        for name in _LIMITED if limits is not None else ():
            most, value = (limits or {}).get(name), usable.get(name)
            if most is not None and value is not None and abs(value) > most:
                message = f"{step.role}.{step.name}: {name} {value:g} is above {most:g}, the limit set for this axis"
                origin = self._origins[step.number].get(name, "")
                self._findings.add("B-PLAN-089", step.where, message, "move slower, or set a higher limit", origin)


def _axes_of(actions: Mapping[str, Action]) -> tuple[Any, ...]:
    """Return the axes that have limits to be set."""
    parameters = actions[_SET_LIMITS].parameters if _SET_LIMITS in actions else ()
    return next((parameter.choices for parameter in parameters if parameter.name == "axis"), ())


def check_poses(plan: Plan, station: Station, findings: Findings) -> None:
    """Note records whose conditions differ from where the table was sent, and from what prompts set (B-PLAN-076)."""

    def take(pose: _Pose, step: Step) -> None:
        if isinstance(step, PlannedPrompt):
            pose.was_set |= step.sets
        elif isinstance(step, PlannedCall) and _moves(step, station):
            _follow(step, pose.angles)
        elif isinstance(step, PlannedRecord | PlannedCommand):
            wrong = [*_poses(step, pose.angles), *_sets(step.conditions, pose.was_set)]
            if wrong:
                what = "record" if isinstance(step, PlannedRecord) else "command"
                message = f"the {what} says what the bench does not do: " + "; ".join(wrong)
                findings.add("B-PLAN-076", step.where, message, "correct the conditions, or the steps before it")

    walk(plan.steps, _Pose(), take, findings)


@dataclass
class _Pose(Followed):
    """Where the axes were sent, None if nobody knows, and what prompts have set, by name."""

    angles: dict[str, float | None] = field(default_factory=dict)
    was_set: dict[str, Any] = field(default_factory=dict)

    def copy(self) -> _Pose:
        return _Pose(dict(self.angles), dict(self.was_set))

    def key(self) -> Hashable:
        return repr((sorted(self.angles.items()), sorted(self.was_set.items())))


def _moves(step: Step, station: Station) -> bool:
    declared = declared_action(station, step.role, step.name)
    return declared is not None and declared.effect is Effect.MOTION_ON


def _follow(step: PlannedCall, angles: dict[str, float | None]) -> None:
    """A move goes to an angle, a turn goes on from the demand before it; behind anything else nobody knows."""
    name, angle = AXES.get(step.axis or 0), step.quantity("angle")
    if name is None:
        return
    before = angles.get(name)
    if angle is None or step.name not in (_MOVE, _TURN):
        angles[name] = None
    elif step.name == _MOVE:
        angles[name] = angle
    else:
        angles[name] = None if before is None else before + angle


def _poses(step: Step, angles: Mapping[str, float | None]) -> Iterator[str]:
    if not isinstance(step, PlannedRecord) or step.conditions.get("continues"):  # that one begins within the motion
        return
    for name, angle in angles.items():
        said = step.conditions.get(name)
        if angle is None or not isinstance(said, float | int):
            continue
        if not math.isclose(math.remainder(said - angle, 360.0), 0.0, abs_tol=1e-9):
            yield f"{name.removesuffix('_deg')} axis at {said:g} deg, but the table was sent to {angle:g} deg"


def _sets(conditions: Values, was_set: Values) -> Iterator[str]:
    for name, value in was_set.items():
        if name in conditions and conditions[name] != value:
            yield f"{name} {conditions[name]}, but the operator was told {value}"
