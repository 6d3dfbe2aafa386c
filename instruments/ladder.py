"""A ladder of remedies for a question that failed, rung by rung, before it is given up.

    time-out -> serial poll and device clear (instruments.wire) -> drain errors and ask again, three tries in all
    -> close and reopen, twice, each after a pause -> clear the interface -> ask a last time

After each reopening the instrument must say who it is and be the same as before. Only questions climb: a command that
sets something is looked up by read-back (instruments.commands). Each rung is in the transcript.

No rung is begun when nobody has answered for ``CLIMB_S``: something may drive, and only a run that knows it can take
that away. Whoever has made it safe, or is on the way to it, climbs with patience (``Wire.persistent``).
What an error queue says on the way, such as that the question is unknown, stands in the error that is raised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from pyvisa.resources import MessageBasedResource

from bench.model.errors import InstrumentError
from instruments.bus import DOUBTFUL, NOT_UNDERSTOOD, BusSession
from instruments.wire import OPEN_S, BusError

READ_ATTEMPTS = 3
PAUSES_S = (0.5, 1.0)  # before the first and the second reopening
# A rung takes up to 1.5 s, and so does making safe in a hurry what leads a stimulus: within 5 s the path is open.
CLIMB_S = 1.5

T = TypeVar("T")


@dataclass
class Ladder:
    """The rungs of one instrument.

    Args: drain: reads the error queue empty and returns what stood in it.   readmit: checks after a reopening that it
    is the same instrument as before, set as before.   reopen, interface_clear: None where the bus has no such rung.
    """

    bus: BusSession
    drain: Callable[[], list[str]]
    readmit: Callable[[], None]
    reopen: Callable[[], MessageBasedResource] | None
    interface_clear: Callable[[], None] | None
    _climbing = False
    _given_up = False  # the session as it is

    def climb(self, error: InstrumentError, ask: Callable[[], T]) -> T:
        """Ask again after each rung that was of use. A question asked on a rung does not climb itself.

        Raises: the last error of the question; whatever ``readmit`` finds wrong (B-INST-002, B-INST-011, B-INST-016).
        """
        if self._climbing:
            raise error
        self._climbing, self._given_up = True, False
        self._faults: dict[str, None] = {}  # in their order, each once
        try:
            return self._climb(error, ask)
        except InstrumentError as last:
            if self._faults and last.code in DOUBTFUL:
                last.message += f"; it reports {'; '.join(self._faults)}"
                last.next_step = "look up what it reports: its model or firmware may not know the question"
            raise
        finally:
            self._climbing = False

    def _climb(self, error: InstrumentError, ask: Callable[[], T]) -> T:
        rungs: list[Callable[[InstrumentError], bool]] = [self._drained] * (READ_ATTEMPTS - 1)
        # who comes again and again needs one opening each time: the pauses lie between
        pauses_s = (0.0,) if self.bus.patient else PAUSES_S
        rungs += [partial(self._reopened, pause_s) for pause_s in pauses_s]
        for rung in (*rungs, self._interface_cleared):
            if self.bus.silence_s() >= CLIMB_S and not self.bus.patient:
                break
            if not rung(error):
                continue
            try:
                return ask()
            except InstrumentError as again:
                if again.code not in DOUBTFUL:
                    raise
                error = again
        raise error

    def _drained(self, error: InstrumentError) -> bool:
        """Return whether the session as it is can be asked; an instrument whose queue is dead is not asked."""
        if self._given_up or self.bus.lost or not self.bus.in_step:
            return False
        try:
            self._faults |= dict.fromkeys(self.drain())
        except InstrumentError:
            self._given_up = True
        return not self._given_up

    def _reopened(self, pause_s: float, error: InstrumentError) -> bool:
        if self.reopen is None or error.code == NOT_UNDERSTOOD:
            return False
        self.bus.release()
        self.bus.pause(pause_s)
        try:
            self.bus.open_again(self.reopen)
        except (BusError, InstrumentError) as problem:
            self.bus.note("rx", f"<it does not open: {problem}>")
            return False
        try:
            self.readmit()
        except InstrumentError as problem:
            if problem.code not in DOUBTFUL:
                raise
            return False
        return True

    def _interface_cleared(self, error: InstrumentError) -> bool:
        if self.interface_clear is None or error.code == NOT_UNDERSTOOD:
            return False
        self.bus.note("tx", "<interface clear>")
        try:
            self.bus.call(OPEN_S, self.interface_clear)
        except BusError as problem:
            self.bus.note("rx", f"<interface clear failed: {problem}>")
            return False
        self.bus.in_step = False  # an interface clear does not empty the instrument
        return self.reopen is None or self._reopened(0.0, error)
