"""Clocks of the two units, and outputs that send numbered samples on them some time later.

A clock begins anew at each switching-on, at a reading that nobody can know. Seconds are float since the switching-on,
whole ticks only on the wire: nothing is rounded to a sample. Samples are made as far ahead as nobody can change the
bench, and only when one of them is due, so that most looks at the line cost nothing. What is made depends on the
sample's number, never on when it is made.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.frame import load_frame
from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from bench.model.lab import find_shipped
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.port import Port
from sim_instruments.worlds.time_sync.options import SyncOptions

Drawing = Callable[[np.random.Generator, int], Floats]
ByNumber = Callable[[int, int], Floats]  # of numbered samples, the first one and the one behind the last

TICK_S = 1e-7
_FIRST_READING_S = (100.0, 5000.0)
AT_ONCE = 1000  # samples made together at most
_NEVER = 2**62


@dataclass(frozen=True)
class UnitClock:
    """One clock: it reads ``start_s`` at bench time ``on_ns`` and runs ``rate`` seconds in one of the bench."""

    on_ns: int
    start_s: float
    rate: float

    def reading_s(self, t_ns: int) -> float:
        """Return what the clock reads at a bench time."""
        return self.start_s + (t_ns - self.on_ns) / NS * self.rate

    def since_on_s(self, reading_s: Floats) -> Floats:
        """Return bench seconds since the switching-on at which the clock reads so."""
        return (reading_s - self.start_s) / self.rate

    def times_ns(self, reading_s: Floats) -> Integers:
        """Return bench times to the nearest nanosecond, for what is late anyway."""
        return self.on_ns + np.rint(NS * self.since_on_s(reading_s)).astype(np.int64)


@dataclass(frozen=True)
class Clocks:
    """Both clocks of one switching-on. The time offset is that of the EGI minus that of the IMU at the same moment."""

    imu: UnitClock
    egi: UnitClock

    @classmethod
    def started(cls, options: SyncOptions, seed: int, power: int, on_ns: int) -> Clocks:
        """Return clocks of the switching-on ``power``, numbered from 0."""
        start_s = generator(seed, "time sync first readings", power).uniform(*_FIRST_READING_S)
        drift_ppm, imu_ppm = options.rates_ppm(seed)
        rate = 1.0 + 1e-6 * imu_ppm
        egi_s = start_s + options.first_offset_s(seed, power)
        return cls(UnitClock(on_ns, start_s, rate), UnitClock(on_ns, egi_s, rate * (1.0 + 1e-6 * drift_ppm)))

    def offset_s(self, t_ns: int) -> float:
        """Return time offset at a bench time."""
        gained = (t_ns - self.imu.on_ns) / NS * (self.egi.rate - self.imu.rate)
        return self.egi.start_s - self.imu.start_s + gained

    @property
    def drift_ppm(self) -> float:
        """Rate of the EGI's clock against the IMU's."""
        return 1e6 * (self.egi.rate / self.imu.rate - 1.0)


class Numbered:
    """Draws of one purpose by number: those of a number are the same whenever it is asked for.

    Args: draw: gives (count, ...) numbers of a generator.   at_once: so many are drawn together.
    """

    def __init__(self, seed: int, purpose: str, *indexes: int, draw: Drawing, at_once: int = 1024) -> None:
        self._generator = lambda block: generator(seed, purpose, *indexes, block)
        self._draw, self._at_once = draw, at_once
        self._newest: tuple[int, Floats] = (-1, np.empty(0))

    def upto(self, first: int, stop: int) -> Floats:
        """Return those of the numbers ``first`` to ``stop`` - 1, from 0 on."""
        parts, size = [], self._at_once
        for block in range(first // size, (stop - 1) // size + 1):
            if self._newest[0] != block:
                self._newest = (block, self._draw(self._generator(block), size))
            parts.append(self._newest[1][max(first - block * size, 0) : stop - block * size])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


@dataclass
class Spell:
    """Samples in a row: the multiples ``first`` to ``stop`` - 1 of a period of a clock.

    ``counter``: of the first one.   ``late_s``: from the validity of samples to their frames, by counter, seconds.
    ``columns``: fields of samples in a row, by number and by counter.
    """

    clock: UnitClock
    period_s: float
    first: int
    counter: int
    late_s: ByNumber
    columns: Callable[[Integers, Integers], Mapping[str, Any]]
    stop: int = _NEVER

    def count_until(self, t_ns: int) -> int:
        """Return number of the first sample that is valid after a bench time, within this spell."""
        number = math.floor(self.clock.reading_s(t_ns) / self.period_s) + 1
        return min(max(number, self.first), self.stop)

    def ready_ns(self, first: int, stop: int) -> Integers:
        """Return when the frames of samples ``first`` to ``stop`` - 1 are made."""
        valid_ns = self.clock.times_ns(np.arange(first, stop) * self.period_s)
        begin = self.counter - self.first
        return valid_ns + np.rint(NS * self.late_s(begin + first, begin + stop)).astype(np.int64)


class SyncStream:
    """Sends the samples of spells, one spell behind the other, as frames of a definition through a port.

    Attributes: port.   due_ns: when the next frame is ready.   counted: samples of the spells that have an end.
    """

    def __init__(self, frame: str) -> None:
        self.definition = load_frame(find_shipped("frames", frame))
        self.port = Port()
        self._spells: deque[Spell] = deque()
        self._next = 0  # number of the next sample of the first spell
        self._newest_ns = 0  # when the newest frame was ready: none overtakes another
        self.due_ns, self.counted = _NEVER, 0

    def begin(self, spell: Spell) -> None:
        """Send a spell behind the others."""
        self._spells.append(spell)
        if len(self._spells) == 1:
            self._open()

    def end(self, t_ns: int) -> None:
        """The newest spell, if it still goes on, ends with the samples valid by ``t_ns``."""
        if not self._spells or self._spells[-1].stop < _NEVER:
            return
        spell = self._spells[-1]
        spell.stop = spell.count_until(t_ns)
        self.counted = spell.counter + spell.stop - spell.first
        if len(self._spells) == 1 and self._next >= spell.stop:
            self._close()

    def drop(self) -> None:
        """Nothing more is sent: what is not yet made is lost."""
        self._spells.clear()
        self.due_ns, self._newest_ns, self.counted = _NEVER, 0, 0

    def send(self, now_ns: int, sure_ns: int) -> None:
        """Make the frames that are ready at ``now_ns``, and those up to ``sure_ns`` with them; nobody's are counted."""
        while self.due_ns <= now_ns:
            spell = self._spells[0]
            stop = min(spell.count_until(sure_ns), self._next + AT_ONCE, spell.stop)
            ready_ns = np.maximum.accumulate(np.maximum(spell.ready_ns(self._next, stop), self._newest_ns))
            count = int(ready_ns.searchsorted(sure_ns, "right"))
            if self.port.listened:
                self._append(spell, self._next + np.arange(count), ready_ns[:count])
            self._next += count
            self._newest_ns = int(ready_ns[count - 1])
            self._look_ahead()

    def _append(self, spell: Spell, number: Integers, ready_ns: Integers) -> None:
        counter = spell.counter - spell.first + number
        columns = {**spell.columns(number, counter), "counter": (counter % 2**32).astype(np.uint32)}
        self.port.append(ready_ns, self.definition.encode(columns, number.size))

    def _open(self) -> None:
        self._next = self._spells[0].first
        self._look_ahead()

    def _close(self) -> None:
        self._spells.popleft()
        self.due_ns = _NEVER
        if self._spells:
            self._open()

    def _look_ahead(self) -> None:
        """Note when the next frame is due."""
        spell = self._spells[0]
        if self._next >= spell.stop:
            self._close()
        else:
            self.due_ns = max(int(spell.ready_ns(self._next, self._next + 1)[0]), self._newest_ns)
