"""Work on many sessions, one task each: in this process, or wherever the caller has them computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, TypeVar

from bench.archive.places import reason_of
from bench.model.errors import InstallationError

Item = TypeVar("Item")
Outcome = tuple[Any, Any, str]  # a task, what it gave or None, and what kept it from being done, else ""
RunTask = Callable[[Any], Any]
Compute = Callable[[Sequence[Any], RunTask], Iterable[Outcome]]  # as each task is done, in any order


def computed_here(tasks: Sequence[Any], run_task: RunTask) -> Iterator[Outcome]:
    """Yield the outcome of each task, in their order, computed by this process."""
    for task in tasks:
        yield attempted(run_task, task)


def attempted(run_task: RunTask, task: Any) -> Outcome:
    """Return a task with its result; storage or software that is away keeps it from being done and ends nothing."""
    try:
        return task, run_task(task), ""
    except InstallationError as error:
        return task, None, str(error)
    except OSError as error:
        return task, None, reason_of(error)


def in_parts(items: Iterable[Item], most: int) -> Iterator[list[Item]]:
    """Yield items in lists of no more than ``most``."""
    left = iter(items)
    while part := list(islice(left, most)):
        yield part
