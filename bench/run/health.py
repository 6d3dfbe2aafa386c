"""Signs of life of the parts of a run, and the newest values that a hard limit is set on.

The guard is told that all is well only while every part has given a sign of life not long ago.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

from bench.model.clock import NS, Clock

SEQUENCER, WRITER, LINKS = "sequencer", "writer", "links"


class Health:
    """Thread-safe; the thread that makes it is the sequencer's."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stamps_ns: dict[str, int] = {}
        self._values: dict[str, float] = {}
        self._sequencer = threading.get_ident()

    def alive(self, part: str) -> None:
        """A part gives a sign of life; one of the sequencer counts only from its own thread."""
        if part != SEQUENCER or threading.get_ident() == self._sequencer:
            self._stamps_ns[part] = self._clock.now_ns()

    def silence_s(self) -> Mapping[str, float]:
        """Seconds since the last sign of life, by part; a part that never gave one is not listed."""
        now_ns = self._clock.now_ns()
        return {part: (now_ns - stamp_ns) / NS for part, stamp_ns in list(self._stamps_ns.items())}

    def note(self, name: str, value: float) -> None:
        """The newest value of a quantity, named with its unit: ``chamber_air_degC``, ``unit_degC`` ..."""
        self._values[name] = value

    def values(self) -> dict[str, float]:
        """The newest values."""
        return dict(self._values)
