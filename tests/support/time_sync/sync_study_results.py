"""A study as the paper and the equations would have it, made by formula: no simulation, no filter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.systems.time_sync.study.study import (
    ERRORS,
    Chip,
    Cut,
    FlightResult,
    IdealResult,
    ImageResult,
    Results,
    StudyOptions,
    Task,
    VELOCITY_m_s,
    YAW_deg,
    tasks_of,
)

RUNS = 50
_EDGES_s = (20.0, 40.0)


def made_results(options: StudyOptions) -> Results:
    """Results that keep every tolerance."""
    return Results(tuple((task, made(task)) for task in tasks_of(options)))


def made(task: Task) -> Any:
    """What a task gives."""
    if task.kind == "ideal":
        return IdealResult(2e-5, 3e-7, 0.249, 2.65, -13.26, -10.12, (_cut("azimuth", 0.0, "none", 0.0),))
    return _image(task) if task.kind == "image" else _flight(task)


def _flight(task: Task) -> FlightResult:
    t_s = np.arange(0.1, task.duration_s, 0.1)
    groups, shape = task.groups, (len(t_s), len(task.groups), 3)
    mean = {name: np.zeros(shape) for name in ERRORS}
    rms = {name: np.full(shape, 0.5) for name in ERRORS}
    inside = (t_s >= _EDGES_s[0]) & (t_s <= _EDGES_s[1])
    offset_s = np.array([group.offset_s for group in groups])
    if task.manoeuvre == "linear":
        mean["position_m"][:, :, 0] = -100.0 * offset_s
        rms["position_m"][:, :, 0] = np.hypot(0.3, 100.0 * offset_s)
    for at, group in enumerate(groups):
        if task.manoeuvre == "acceleration":
            rms["velocity_m_s"][:, at, 0] = VELOCITY_m_s.get(group.offset_ms, 0.05)
            mean["velocity_m_s"][inside, at, 0] = -5.0 * group.offset_s
        rms["attitude_deg"][:, at, 2] = YAW_deg.get(group.offset_ms, 0.01)
    found = task.manoeuvre != "linear"
    left_s = np.where((t_s[:, None] > 21.0) & found, 3e-4, np.abs(offset_s))
    one = np.ones((len(t_s), len(groups)))
    return FlightResult(
        groups, task.runs, t_s, mean, rms, -0.3 * left_s, left_s, 3e-4 * one, 0.8 * one,
        0.9 * one[0], 0.05 * one[0], np.where(t_s[:, None] > 21.0, 1e-3, 0.9) * one, 2e-3 * one,
    )  # fmt: skip


def _image(task: Task) -> ImageResult:
    groups = tuple(group for group in task.groups if group.noise == "tight")
    run_m = np.linspace(-0.8, 0.8, task.runs)
    moved = np.array([0.0 if group.augmented else group.offset_s / 0.030 for group in groups])[:, None]
    shift_m = run_m - 8.1 * moved
    flat = np.ones_like(shift_m)
    return ImageResult(
        flight=_flight(task),
        groups=groups,
        predicted_m=shift_m + 1e-3,
        several_m=shift_m[:, :3],
        azimuth_shift_m=shift_m,
        range_shift_m=0.0 * flat,
        azimuth_resolution_m=0.25 * (1.0 + 0.04 * moved) * flat,
        range_resolution_m=2.65 * flat,
        pslr_dB=-11.5 + 1.7 * moved * flat,
        islr_dB=-9.3 + 1.7 * moved * flat,
        peak=0.98 * flat,
        cuts=tuple(_cut("azimuth", one.offset_ms, one.solution, float(shift_m[k, 0])) for k, one in enumerate(groups)),
        chips=tuple(_chip(one.offset_ms, one.solution, float(shift_m[k, 0])) for k, one in enumerate(groups)),
    )


def _cut(direction: str, offset_ms: float, solution: str, shift_m: float) -> Cut:
    at_m = np.arange(-3.0, 3.0, 0.02)
    return Cut(direction, offset_ms, solution, shift_m + at_m, np.sinc(at_m / 0.28).astype(np.complex128))


def _chip(offset_ms: float, solution: str, shift_m: float) -> Chip:
    along_m, range_m = np.arange(-12.0, 12.0, 0.2), np.arange(-20.0, 20.0, 1.0)
    size = np.abs(np.outer(np.sinc((along_m - shift_m) / 0.28), np.sinc(range_m / 3.0)))
    return Chip(offset_ms, solution, along_m, range_m, size)


def changed(found: Results, kind: str, manoeuvre: str, **new: Any) -> Results:
    """The same with some fields of some results changed by functions of the field and the groups."""

    def other(task: Task, result: Any) -> Any:
        if (task.kind, task.manoeuvre) != (kind, manoeuvre):
            return result
        fields = {name: change(getattr(result, name), result) for name, change in new.items() if hasattr(result, name)}
        return replace(result, **fields)

    return Results(tuple((task, other(task, result)) for task, result in found.pairs))
