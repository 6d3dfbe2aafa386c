"""A call that may not return, on a thread of its own: opening a connection, a name server, a library written in C.

Whoever waits for it gives signs of life, waits no longer than the limit, and goes on without it. A call that never
returns keeps its thread, and nothing else.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar, cast

SLICE_S = 0.5  # longest wait without a sign of life; a run may be silent for 1.5 s

T = TypeVar("T")


class NotReturnedError(Exception):
    """A call has not come back within its limit; it may still do something."""


class Aside(Generic[T]):
    """One call, begun at once. ``what`` names it for the error."""

    def __init__(self, what: str, call: Callable[[], T]) -> None:
        self._what, self._call = what, call
        self._result: T | None = None
        self._error: BaseException | None = None
        self._waited_s = 0.0
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._result = self._call()
        except BaseException as error:  # raised where it is waited for
            self._error = error

    @property
    def under_way(self) -> bool:
        """True until the call has returned or raised."""
        return self._thread.is_alive()

    def wait(self, limit_s: float, live: Callable[[], None]) -> T:
        """Return what the call gives; ``live`` is called each half second. May be called again.

        Raises: what the call raises; NotReturnedError after ``limit_s`` (second).
        """
        rest_s = limit_s
        while self.under_way and rest_s > 0.0:
            slice_s = min(SLICE_S, rest_s)
            self._thread.join(slice_s)
            rest_s -= slice_s
            self._waited_s += slice_s
            if self.under_way:
                live()
        if self.under_way:
            raise NotReturnedError(f"{self._what} has not returned for {self._waited_s:.1f} s")
        if self._error is not None:
            raise self._error
        return cast("T", self._result)
