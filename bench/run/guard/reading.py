"""The guard's own reading of the chamber's air, for when the controller has had none for a while."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from bench.model.clock import Clock, to_ns
from bench.model.drivers import driver_class
from bench.model.errors import BenchError
from bench.model.ports import Instrument, actions_of
from bench.run.guard.brief import Address

AIR = "chamber_air_degC"
STALE_S = 10.0  # no step talks to the chamber for so long
AGAIN_S = 5.0
_CALL_S = 0.5


class OwnReading:
    """Reads in a thread of its own, so that an instrument that hangs keeps the guard from nothing.

    The chamber is opened when the first reading is due, and stays open.
    """

    def __init__(self, addresses: Sequence[Address], opened: Callable[[Address], Instrument], clock: Clock) -> None:
        self._address = next((one for one in addresses if "measure_air" in actions_of(driver_class(one.driver))), None)
        self._opened = opened
        self._clock = clock
        self._chamber: Instrument | None = None
        self._thread: threading.Thread | None = None
        self._next_ns = 0
        self.newest: float | None = None

    def look(self, age_s: float | None) -> float | None:
        """The newest reading of its own, degC, while the controller's is older than ``STALE_S``; else None."""
        if age_s is None or age_s < STALE_S or self._address is None:
            self.newest = None
            return None
        now_ns = self._clock.now_ns()
        busy = self._thread is not None and self._thread.is_alive()
        if not busy and now_ns >= self._next_ns:
            self._next_ns = now_ns + to_ns(AGAIN_S)
            self._thread = threading.Thread(target=self._read, args=(self._address,), daemon=True)
            self._thread.start()
        return self.newest

    def _read(self, address: Address) -> None:
        try:
            if self._chamber is None:
                self._chamber = self._opened(address)
            with self._chamber.quick(_CALL_S):  # type: ignore[attr-defined]
                self.newest = float(self._chamber.measure_air())  # type: ignore[attr-defined]
        except (BenchError, OSError):
            self.newest = None
