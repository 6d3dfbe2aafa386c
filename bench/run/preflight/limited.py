"""A call that may hang, in a thread of its own: a disk or a bus that stands still costs a thread and no more."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


class OverdueError(Exception):
    """The call has not come to an end in its time; it may still."""


def within(limit_s: float, call: Callable[[], T]) -> T:
    """What the call returns or raises. Raises: OverdueError after ``limit_s`` (second)."""
    returned: list[T] = []
    raised: list[Exception] = []

    def work() -> None:
        try:
            returned.append(call())
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(limit_s)
    if raised:
        raise raised[0]
    if not returned:
        raise OverdueError(f"over {limit_s:g} s")
    return returned[0]
