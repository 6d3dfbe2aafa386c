"""Static check of tables that move: limits, then interlock, then motion; and nobody at a table that may move.

An instrument is a table if its driver declares an action with the effect "motion on". One without an axis makes the
table ready (``close_interlock``), one with an ``axis`` moves it; ``set_limits`` says how fast an axis may be.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.ports import Action, Effect
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step

_LIMITED = ("rate", "acceleration")
_SET_LIMITS = "set_limits"


class MotionState:
    """Follows the tables of a bench, step by step.

    Args: tables: declared actions of each role that can move. ``may_move`` holds the roles whose interlocks are closed,
    with the place where they were.
    """

    def __init__(self, plan: Plan, tables: Mapping[str, Mapping[str, Action]], findings: Findings) -> None:
        self._findings = findings
        self._origins = plan.origins
        self._tables = tables
        self._axes = {role: _axes_of(actions) for role, actions in tables.items()}
        self._limits: dict[tuple[str, Any], Mapping[str, Any]] = {}
        self.may_move: dict[str, str] = {}

    def call(self, step: Step, action: Action, usable: Mapping[str, Any]) -> None:
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

    def _set_limits(self, step: Step, usable: Mapping[str, Any]) -> None:
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

    def _motion(self, step: Step, usable: Mapping[str, Any]) -> None:
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


def tables_of(actions: Mapping[str, Mapping[str, Action]]) -> dict[str, Mapping[str, Action]]:
    """Of the declared actions of each role, those of the roles that can move."""
    return {
        role: known
        for role, known in actions.items()
        if any(action.effect is Effect.MOTION_ON for action in known.values())
    }


def _axes_of(actions: Mapping[str, Action]) -> tuple[Any, ...]:
    """The axes that have limits to be set."""
    parameters = actions[_SET_LIMITS].parameters if _SET_LIMITS in actions else ()
    return next((parameter.choices for parameter in parameters if parameter.name == "axis"), ())
