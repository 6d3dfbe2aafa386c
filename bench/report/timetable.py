"""From the flat list of plan steps to what a person calls a timetable: lanes of bars and the planned temperature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.plan import PlannedRecord, PlannedSettle, PlannedSoak, Step, planned_temperature, timed_steps
from bench.report.model import Bar, Timetable

_JOIN_s = 1.0


def timetable(steps: Sequence[Step], prepare_s: float) -> Timetable:
    """Merge the steps of a plan into bars and draw its planned temperature.

    Args:
        steps: the plan, in order; ``prepare_s``: length of the phase before hour 0, shown at negative times.
    Returns:
        Timetable: neighbouring steps of one lane and kind are joined when less than 1 s lies between them.
    """
    open_bars: dict[str, Bar] = {}
    bars: list[Bar] = []
    served = _conditions_served(steps)
    for (step, start_s), conditions in zip(timed_steps(steps, prepare_s), served, strict=True):
        if step.duration_s <= 0:
            continue
        bar = Bar(_lane(step, conditions), _kind(step, conditions), start_s, step.duration_s)
        last = open_bars.get(bar.lane)
        if last is not None and last.kind == bar.kind and start_s - (last.start_s + last.duration_s) < _JOIN_s:
            bar = Bar(bar.lane, bar.kind, last.start_s, start_s + step.duration_s - last.start_s)
            bars[bars.index(last)] = bar
        else:
            bars.append(bar)
        open_bars[bar.lane] = bar
    return Timetable(tuple(bars), *planned_temperature(steps, prepare_s))


def _conditions_served(steps: Sequence[Step]) -> list[Mapping[str, Any]]:
    """Return the conditions that each step serves: to settle is a part of the record that comes after it."""
    served: list[Mapping[str, Any]] = []
    ahead: Mapping[str, Any] | None = None
    for step in reversed(steps):
        if isinstance(step, PlannedRecord):
            ahead = step.conditions
        elif not isinstance(step, PlannedSettle) and step.duration_s > 0:
            ahead = None
        served.append(ahead if isinstance(step, PlannedSettle) and ahead is not None else step.conditions)
    return served[::-1]


def _lane(step: Step, conditions: Mapping[str, Any]) -> str:
    if step.phase != "campaign":
        return step.phase
    channel = conditions.get("channel")
    if channel is not None and not isinstance(step, PlannedSoak):
        return f"channel {channel}"
    return step.kind


def _kind(step: Step, conditions: Mapping[str, Any]) -> str:
    if step.phase != "campaign":
        return step.phase
    if isinstance(step, PlannedSoak):
        return "soak"
    return "repeat" if conditions.get("repeat") else "measure"
