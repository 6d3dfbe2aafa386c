"""From the flat list of plan steps to what a person calls a timetable: lanes of bars and the planned temperature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.report.model import Bar, PlannedStep, Timetable

LAB_AIR_degC = 23.0  # where a chamber starts when the plan does not say (reference conditions 23 degC)
_JOIN_s = 1.0
_TEMPERATURE = ("temperature_degC", "temperature")
_RAMP = ("ramp_degC_min", "ramp")


def timetable(steps: Sequence[PlannedStep], prepare_s: float, start_degC: float = LAB_AIR_degC) -> Timetable:
    """Merge the steps of a plan into bars and draw its planned temperature.

    Args:
        steps: the plan, in order; ``prepare_s``: length of the phase before hour 0, shown at negative times.
        start_degC: temperature of the chamber before the first soak.
    Returns:
        Timetable: neighbouring steps of one lane and kind are joined when less than 1 s lies between them.
    """
    open_bars: dict[str, Bar] = {}
    bars: list[Bar] = []
    end_s = max((step.at_s + step.duration_s for step in steps if step.phase == "campaign"), default=0.0)
    origin_s = {"prepare": -prepare_s, "finally": end_s}
    for step, conditions in _with_their_record(steps):
        if step.duration_s <= 0:
            continue
        start_s = step.at_s + origin_s.get(step.phase, 0.0)
        bar = Bar(_lane(step, conditions), _kind(step, conditions), start_s, step.duration_s)
        last = open_bars.get(bar.lane)
        if last is not None and last.kind == bar.kind and start_s - (last.start_s + last.duration_s) < _JOIN_s:
            bar = Bar(bar.lane, bar.kind, last.start_s, start_s + step.duration_s - last.start_s)
            bars[bars.index(last)] = bar
        else:
            bars.append(bar)
        open_bars[bar.lane] = bar
    planned_t_s, planned_degC = planned_temperature(steps, start_degC)
    return Timetable(tuple(bars), planned_t_s, planned_degC)


def planned_temperature(
    steps: Sequence[PlannedStep], start_degC: float = LAB_AIR_degC
) -> tuple[np.ndarray[Any, np.dtype[np.float64]], np.ndarray[Any, np.dtype[np.float64]]]:
    """Corners of the planned air temperature: each soak ramps from the last temperature, then holds.

    Returns: (t_s, degC), each (k,), seconds from the start of the campaign; empty if the plan has no soak.
    """
    t_s: list[float] = []
    degC: list[float] = []
    now_degC = start_degC
    end_s = 0.0
    for step in steps:
        if step.phase != "campaign":
            continue
        end_s = max(end_s, step.at_s + step.duration_s)
        target_degC = _number(step.arguments, _TEMPERATURE)
        if step.kind != "soak" or target_degC is None:
            continue
        ramp_degC_min = _number(step.arguments, _RAMP)
        ramp_s = 60.0 * abs(target_degC - now_degC) / ramp_degC_min if ramp_degC_min else 0.0
        t_s += [step.at_s, step.at_s + min(ramp_s, step.duration_s)]
        degC += [now_degC, target_degC]
        now_degC = target_degC
    if t_s:
        t_s.append(end_s)
        degC.append(now_degC)
    return np.array(t_s), np.array(degC)


def _with_their_record(steps: Sequence[PlannedStep]) -> list[tuple[PlannedStep, Mapping[str, Any]]]:
    """Steps with the conditions they serve: to settle is a part of the record that comes after it."""
    found: list[tuple[PlannedStep, Mapping[str, Any]]] = []
    ahead: Mapping[str, Any] | None = None
    for step in reversed(steps):
        if step.kind == "record":
            ahead = step.conditions
        elif step.kind != "settle" and step.duration_s > 0:
            ahead = None
        found.append((step, ahead if step.kind == "settle" and ahead is not None else step.conditions))
    return found[::-1]


def _lane(step: PlannedStep, conditions: Mapping[str, Any]) -> str:
    if step.phase != "campaign":
        return step.phase
    channel = conditions.get("channel")
    if channel is not None and step.kind != "soak":
        return f"channel {channel}"
    return step.kind


def _kind(step: PlannedStep, conditions: Mapping[str, Any]) -> str:
    if step.phase != "campaign":
        return step.phase
    if step.kind == "soak":
        return "soak"
    return "repeat" if conditions.get("repeat") else "measure"


def _number(arguments: Mapping[str, Any], names: tuple[str, ...]) -> float | None:
    for name in names:
        if isinstance(value := arguments.get(name), int | float):
            return float(value)
    return None
