"""Work on many sessions, one task each: in this process, or wherever the caller has them computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, TypeVar

from bench.analysis import Task
from bench.model.errors import InstallationError

T = TypeVar("T", bound=Task)
R = TypeVar("R")
Item = TypeVar("Item")
Outcome = tuple[T, R | None, str]  # a task, what it gave, and what kept it from being done, else ""
# Gives the outcome of each task as it is done, in any order.
Compute = Callable[[Sequence[Any], Callable[[Any], Any]], Iterable[tuple[Any, Any, str]]]


def computed_here(tasks: Sequence[T], run_task: Callable[[T], R]) -> Iterator[Outcome[T, R]]:
    """Yield the outcome of each task, in their order, computed by this process."""
    for task in tasks:
        yield attempted(run_task, task)


def attempted(run_task: Callable[[T], R], task: T) -> Outcome[T, R]:
    """Return a task with its result; storage or software that is away keeps it from being done and ends nothing."""
    try:
        return task, run_task(task), ""
    except InstallationError as error:
        return task, None, str(error)
    except OSError as error:
        return task, None, f"{type(error).__name__}: {error.strerror or ' '.join(str(error).split())}"


def in_parts(items: Iterable[Item], most: int) -> Iterator[list[Item]]:
    """Yield items in lists of no more than ``most``."""
    left = iter(items)
    while part := list(islice(left, most)):
        yield part
