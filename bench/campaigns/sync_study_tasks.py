"""A task of the study, done: the one function that runs on this machine, in another process or on another machine."""

from __future__ import annotations

from bench.campaigns.sync_study import Task
from bench.campaigns.sync_study_flight import flight_result, fly
from bench.campaigns.sync_study_ideal import ideal_result
from bench.campaigns.sync_study_image import image_result
from bench.campaigns.sync_study_results import FlightResult, IdealResult, ImageResult


def run_task(task: Task) -> FlightResult | ImageResult | IdealResult:
    """Everything of a task: it depends on nothing but the task, and leaves nothing behind."""
    if task.kind == "ideal":
        return ideal_result(task)
    flown = fly(task)
    return image_result(task, flown) if task.kind == "image" else flight_result(task, flown)
