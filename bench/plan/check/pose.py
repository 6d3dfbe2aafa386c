"""Static check of poses: what a record says of the table and of the unit on it must be what was done before it.

An analysis takes gravity and the Earth's rate from these conditions; a wrong one becomes a wrong number without any
other sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from bench.model.ports import Effect
from bench.plan.bus_time import declared_action
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedCall, PlannedCommand, PlannedPrompt, PlannedRecord

AXES = {1: "outer_deg", 2: "middle_deg", 3: "inner_deg"}
_MOVE, _TURN = "move", "turn"


def check_poses(plan: Plan, station: Station, findings: Findings) -> None:
    """Note records whose conditions differ from where the table was sent, and from what prompts set (B-PLAN-076)."""
    angles: dict[str, float | None] = {}
    was_set: dict[str, Any] = {}
    for step in plan.steps:
        if isinstance(step, PlannedPrompt):
            was_set |= step.sets
        elif isinstance(step, PlannedCall) and _moves(step, station):
            _follow(step, angles)
        elif isinstance(step, PlannedRecord | PlannedCommand):
            wrong = [*_poses(step, angles), *_sets(step.conditions, was_set)]
            if wrong:
                what = "record" if isinstance(step, PlannedRecord) else "command"
                message = f"the {what} says what the bench does not do: " + "; ".join(wrong)
                findings.add("B-PLAN-076", step.where, message, "correct the conditions, or the steps before it")


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


def _sets(conditions: Mapping[str, Any], was_set: Mapping[str, Any]) -> Iterator[str]:
    for name, value in was_set.items():
        if name in conditions and conditions[name] != value:
            yield f"{name} {conditions[name]}, but the operator was told {value}"
