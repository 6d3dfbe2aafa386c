"""Signs of life of the parts of a run, and the newest values that a hard limit is set on.

The guard is told that all is well only while every part has given a sign of life not long ago.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

from bench.model.clock import NS, Clock

SEQUENCER, WRITER, LINKS = "sequencer", "writer", "links"
CHAMBER_AIR, UNIT = "chamber_air_degC", "unit_degC"


class Health:
    """Thread-safe; the thread that makes it is the sequencer's."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stamps_ns: dict[str, int] = {}
        self._values: dict[str, tuple[float, int]] = {}
        self._sequencer = threading.get_ident()
        self._asking = False
        self.is_over = self.heat_off = False
        self._unconfirmed: dict[str, str] = {}
        self._at = "", clock.now_ns()

    def alive(self, part: str, at: str = "") -> None:
        """A part gives a sign of life; one of the sequencer counts only from its own thread. ``at``: what it is at."""
        if part != SEQUENCER:
            self._stamps_ns[part] = self._clock.now_ns()
        elif threading.get_ident() == self._sequencer:
            now_ns = self._stamps_ns[part] = self._clock.now_ns()
            if at != self._at[0]:
                self._at = at, now_ns

    def at(self) -> tuple[str, float]:
        """Return what the sequencer is at, by its last sign of life, and for how long it has been, second."""
        what, since_ns = self._at
        return what, (self._clock.now_ns() - since_ns) / NS

    @contextmanager
    def asking(self) -> Iterator[None]:
        """While a person is asked the sequencer waits for that person, however long it takes: it lives."""
        self._asking = True
        try:
            yield
        finally:
            self.alive(SEQUENCER)
            self._asking = False

    def begin(self, roles: Iterable[str]) -> None:
        """From now on these may be on: whoever leaves without ``over`` leaves all of them behind."""
        self._unconfirmed = dict.fromkeys(roles, "unreachable")

    def over(self, unconfirmed: Mapping[str, str], *, heat_off: bool = False) -> None:
        """The bench was made safe, but for these: the rest of the run is paper work, and nothing of it has to hurry.

        ``heat_off``: a source of heat among them is to be stopped, not held.
        """
        self._unconfirmed, self.heat_off = dict(unconfirmed), heat_off
        self.is_over = True

    @property
    def unconfirmed(self) -> dict[str, str]:
        """What is not confirmed safe, by role: the last words of a controller to its guard."""
        return dict(self._unconfirmed)

    def silence_s(self) -> Mapping[str, float]:
        """Return seconds since the last sign of life, by part; a part that gave none is left out, at the end all."""
        if self.is_over:
            return {}
        now_ns = self._clock.now_ns()
        silence = {part: (now_ns - stamp_ns) / NS for part, stamp_ns in list(self._stamps_ns.items())}
        return {**silence, SEQUENCER: 0.0} if self._asking else silence

    def note(self, name: str, value: float) -> None:
        """The newest value of a quantity, named with its unit: ``chamber_air_degC``, ``unit_degC`` ..."""
        self._values[name] = (value, self._clock.now_ns())

    def values(self) -> dict[str, float]:
        """Return the newest values."""
        return {name: value for name, (value, _) in list(self._values.items())}

    def newest(self, name: str) -> tuple[float, int] | None:
        """Return the newest value and when it was noted, on the bench clock, ns; None if it never was."""
        return self._values.get(name)

    def age_s(self, name: str) -> float | None:
        """Return seconds since a value was noted; None if it never was."""
        known = self.newest(name)
        return None if known is None else (self._clock.now_ns() - known[1]) / NS
