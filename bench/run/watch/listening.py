"""A listener that cannot end a run: a terminal that is gone is no reason to stop measuring."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bench.plan import Step
from bench.record import RecordRow
from bench.run.context import Listener


class SafeListener:
    """Passes everything on until the listener behind it fails; from then on it is not told any more.

    ``heard`` are called with every message, whatever becomes of the listener; they must neither wait nor raise.
    """

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._gone = False
        self.heard: list[Callable[[str], None]] = []

    def step(self, step: Step, at_s: float) -> None:
        """A step begins."""
        self._tell(self._listener.step, step, at_s)

    def record(self, row: RecordRow) -> None:
        """A record is complete."""
        self._tell(self._listener.record, row)

    def message(self, text: str) -> None:
        """Something a person should read."""
        self._tell(self._listener.message, text)
        for hear in self.heard:
            hear(text)

    def _tell(self, tell: Callable[..., None], *what: Any) -> None:
        if self._gone:
            return
        try:
            tell(*what)
        except (OSError, SystemExit):  # a closed pipe, a terminal that hung up; some writers want to exit then
            self._gone = True
