"""The one way in which tests wait for something that another thread or process does."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
LONGEST_S = 60.0
LOOK_S = 0.05


def until(
    found: Callable[[], T], what: Callable[[], object] | str = "", limit_s: float = LONGEST_S, each_s: float = LOOK_S
) -> T:
    """Return the first true value of ``found``; the limit only ends a test that hangs, and ``what`` says for what."""
    end_s = time.monotonic() + limit_s
    while not (value := found()):
        assert time.monotonic() < end_s, f"did not come: {what if isinstance(what, str) else what()}"
        time.sleep(each_s)
    return value
