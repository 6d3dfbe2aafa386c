"""A task of the study, done: the one function that runs on this machine, in another process or on another machine."""

from __future__ import annotations

from bench.systems.time_sync.study.flight import flight_result, fly
from bench.systems.time_sync.study.ideal import ideal_result
from bench.systems.time_sync.study.image import image_result
from bench.systems.time_sync.study.results import FlightResult, IdealResult, ImageResult
from bench.systems.time_sync.study.study import Task


def run_task(task: Task) -> FlightResult | ImageResult | IdealResult:
    """Return everything of a task: it depends on nothing but the task, and leaves nothing behind."""
    if task.kind == "ideal":
        return ideal_result(task)
    flown = fly(task)
    return image_result(task, flown) if task.kind == "image" else flight_result(task, flown)
