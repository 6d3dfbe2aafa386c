"""Newest values of what interlocks are set on, gathered without disturbing the steps.

Most come from the streams of the unit, which are there anyway. An instrument is asked once a minute (the logger each
five; under the virtual clock less often), never while a step talks to it, and with its bus held, so that no step can
begin to in between.
"""

from __future__ import annotations

import math
import shutil
from collections import deque
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.frame import LinkBatch
from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError
from bench.model.events import Error, Surroundings
from bench.model.ports import Instrument
from bench.plan import CHAMBER, SECOND_BYTES, InterlockRule, PlannedUnit
from bench.record import RecordRow
from bench.run.bus.acquisition import STALE_S
from bench.run.bus.reader import TEMPERATURE, LinkReader, age_s, of_unit
from bench.run.bus.safety import hurried
from bench.run.context import RunContext
from bench.run.stop import CHAMBER_AIR

KEPT_FRAMES = 200_000  # of the newest frames: more than any record that pulses are timed in has
COUNTS = ("npp", "ppp")
SCANNED = ("lab_air", "second_air")  # by the data logger
CALL_S = 1.0
QUIET_S = 5.0
FRESH_S = 30.0  # what the guard of the hard limits has just read is not asked for again
LOGGER_EACH = 5  # times the chamber: laboratory air is slow, and a scan keeps the bus for seconds
SLOPE_S = 600.0
SLOPE_LEAST_S = 60.0
SHARE_S = 30.0
OVERHEAD = 1.2  # of a session over the bytes of its links, events and chunk headers included
FRESH_VIRTUAL_S = 150.0  # a rehearsal decodes once a minute, or when a megabyte waits
HOUSEKEEPING = {
    TEMPERATURE: ("unit_temperature", "unit_slope"),
    "supply_current": ("supply_current",),
    "supply_voltage": ("supply_voltage",),
}


class RateStep:
    """Feed it with every batch of the measurement link, then ask for a record that has just ended.

    Args: rate_Hz: frames per second of the link.
    """

    def __init__(self, rate_Hz: float) -> None:
        self._rate_Hz = rate_Hz
        self._kept: deque[tuple[NDArray[np.int64], NDArray[np.int64]]] = deque()
        self._frames = 0

    def feed(self, batch: LinkBatch) -> None:
        """Keep the net counts of frames with a counter and counts of both polarities."""
        for frames in batch.messages.values():
            if not len(frames) or frames.counter is None or not set(COUNTS) <= set(frames.message.by_name):
                continue
            net = frames.raw("npp").astype(np.int64) - frames.raw("ppp")
            self._kept.append((frames.counter, net))
            self._frames += len(frames)
        while self._frames > KEPT_FRAMES and len(self._kept) > 1:
            self._frames -= len(self._kept.popleft()[0])

    def of(self, row: RecordRow) -> float:
        """Return mean net rate of the record's channel in its second half minus that in its first, absolute, hertz.

        NaN if the record names no channel or a half of it has no frames.
        """
        channel, first = row.window.conditions.get("channel"), row.window.first_counter
        middle, stop = first + row.window.frames // 2, first + row.window.frames
        if not isinstance(channel, int) or not self._kept:
            return math.nan
        counters = np.concatenate([counters for counters, _ in self._kept])
        counts = np.concatenate([net for _, net in self._kept])[:, channel - 1]
        halves = [counts[(counters >= a) & (counters < b)] for a, b in ((first, middle), (middle, stop))]
        if not all(len(half) for half in halves):
            return math.nan
        return abs(float(halves[1].mean() - halves[0].mean())) * self._rate_Hz


@dataclass
class _Slope:
    readings: deque[tuple[int, float]] = field(default_factory=deque)

    def add(self, t_ns: int, value: float) -> None:
        self.readings.append((t_ns, value))
        while t_ns - self.readings[0][0] > SLOPE_S * NS:
            self.readings.popleft()

    def per_min(self) -> float:
        (first_ns, first), (last_ns, last) = self.readings[0], self.readings[-1]
        if last_ns - first_ns < SLOPE_LEAST_S * NS:
            return math.nan
        return (last - first) / ((last_ns - first_ns) / NS / 60.0)


@dataclass
class _Share:
    """Shares of lost and bad frames of one link over the last ``SHARE_S`` in which frames were counted.

    All are lost, as far as anybody knows, where the counter jumped by more than it can tell.
    """

    seen: deque[tuple[int, int, int, int, int]] = field(default_factory=deque)
    lost: float = math.nan
    bad: float = math.nan

    def add(self, t_ns: int, frames: int, lost: int, bad: int, jumps: int) -> None:
        if self.seen and (frames, lost, bad, jumps) == self.seen[-1][1:]:
            return
        if self.seen and frames < self.seen[-1][1]:
            self.seen.clear()  # counted anew: the link was opened again
        self.seen.append((t_ns, frames, lost, bad, jumps))
        while len(self.seen) > 2 and t_ns - self.seen[1][0] >= SHARE_S * NS:
            self.seen.popleft()
        (_, frames_0, lost_0, bad_0, jumps_0) = self.seen[0]
        due = frames - frames_0 + lost - lost_0
        if due > 0:
            self.lost = 1.0 if jumps > jumps_0 else (lost - lost_0) / due
            self.bad = (bad - bad_0) / (due + bad - bad_0)


class WatchedSignals:
    """Readings for the interlocks of one run. ``look`` takes the streams, ``ask`` the instruments."""

    def __init__(self, context: RunContext, rules: Collection[InterlockRule]) -> None:
        self._context = context
        self._wanted = {rule.signal for rule in rules}
        self._channels = {(rule.signal, rule.of, rule.channel) for rule in rules if rule.signal in SCANNED}
        linked = {rule.of for rule in rules if rule.signal.startswith("link_")}
        self._links = linked & context.acquisition.readers.keys()  # of a unit that was left out there is none
        self._values: dict[tuple[str, str, int | None], tuple[int, float]] = {}
        self._fetched: dict[str, int] = {}  # by rule: number of the reading it was given last
        self._readings = 0
        self._slopes: dict[tuple[str, str], _Slope] = {}  # by signal and what it is of
        self._shares = {link: _Share() for link in self._links}
        self._asked = 0

    def value(self, rule: InterlockRule) -> float | None:
        """Return the newest reading for a rule, None if there is none that it was not given yet."""
        number, value = self._values.get((rule.signal, rule.of, rule.channel), (0, math.nan))
        if number == self._fetched.get(rule.name, 0):
            return None
        self._fetched[rule.name] = number
        return value

    def put(self, signal: str, value: float, of: str = "", channel: int | None = None) -> None:
        """A reading is there."""
        self._readings += 1
        self._values[signal, of, channel] = (self._readings, value)

    def look(self) -> None:
        """Take what the streams say, and the room on the disk."""
        for link in self._links:
            self._look_at(link, self._context.acquisition.readers[link])
        self._housekeeping()
        if "disk_time" in self._wanted and not self._context.clock.virtual:
            free = shutil.disk_usage(self._context.folder).free
            self.put("disk_time", free / (OVERHEAD * (self._context.plan.link_bytes_s or SECOND_BYTES)))

    def ask(self, *, all_of_them: bool = False) -> None:
        """Read the instruments that are idle; a logger, which is slow, each fifth time or with ``all_of_them``."""
        chamber = self._context.instruments.get(CHAMBER)
        if chamber is not None and self._wanted & {"chamber_air", "chamber_slope"}:
            self._air(chamber)
        if all_of_them or self._asked % LOGGER_EACH == 0:
            for role in sorted({role for _, role, _ in self._channels}):
                self._scan(role, self._context.instruments[role])
        self._asked += 1

    def _air(self, chamber: Instrument) -> None:
        health = self._context.health
        age_s = health.age_s(CHAMBER_AIR)
        if age_s is None or age_s > FRESH_S:
            read_idle(self._context, CHAMBER, lambda: health.note(CHAMBER_AIR, float(chamber.measure_air())))  # type: ignore[attr-defined]
            age_s = health.age_s(CHAMBER_AIR)
        if age_s is not None and age_s <= FRESH_S:
            self._temperature("chamber_air", "chamber_slope", health.values()[CHAMBER_AIR])

    def _scan(self, role: str, logger: Instrument) -> None:
        def scan() -> None:
            temperatures = scanned(logger)
            for signal, of, channel in self._channels:
                if of == role and channel in temperatures:
                    self.put(signal, temperatures[channel], role, channel)
            self._context.event(Surroundings(role=role, degC={str(key): degC for key, degC in temperatures.items()}))

        read_idle(self._context, role, scan)

    def _temperature(self, name: str, slope: str, value_degC: float, of: str = "") -> None:
        if not math.isfinite(value_degC):
            return
        self.put(name, value_degC, of)
        kept = self._slopes.setdefault((slope, of), _Slope())
        kept.add(self._context.clock.now_ns(), value_degC)
        self.put(slope, kept.per_min(), of)

    def _housekeeping(self) -> None:
        """Take what the unit says of itself, as far as it is decoded: decoding it for this would cost most of all."""
        for unit in self._context.units or (None,):
            of = "" if unit is None else next(iter(unit.links.values()))
            for name, signals in HOUSEKEEPING.items():
                if self._wanted.intersection(signals) and not math.isnan(value := self._newest(name, unit)):
                    if name == TEMPERATURE:
                        self._temperature("unit_temperature", "unit_slope", value, of)
                    else:
                        self.put(name, value, of)

    def _newest(self, name: str, unit: PlannedUnit | None) -> float:
        """Return newest value of a housekeeping field, the mean of an array; NaN if it is old or nobody sends it."""
        acquisition, now_ns = self._context.acquisition, self._context.clock.now_ns()
        fresh_ns = to_ns(FRESH_VIRTUAL_S if self._context.clock.virtual else STALE_S)
        with acquisition.lock:
            for reader in of_unit(acquisition.readers, unit).values():
                for frames in reader.newest.values():
                    if name in frames.message.by_name and frames.t_ns is not None:
                        fresh = now_ns - int(frames.t_ns[-1]) <= fresh_ns
                        return frames.newest(name) if fresh else math.nan
        return math.nan

    def _look_at(self, link: str, reader: LinkReader) -> None:
        now_ns, counts = self._context.clock.now_ns(), reader.decoder.counts
        share = self._shares[link]
        share.add(now_ns, counts.frames, counts.lost, counts.bad, counts.jumps)
        self.put("link_loss", share.lost, link)
        self.put("link_bad", share.bad, link)
        if reader.last_frame_ns >= 0:
            self.put("link_age", age_s(reader, now_ns), link)


def read_idle(context: RunContext, role: str, read: Callable[[], None]) -> None:
    """Read an instrument that no step is talking to; one that does not answer gave no reading."""
    with _bus_of(context.instruments[role]):  # a step that begins now waits for its first command
        if role in context.in_use:
            return
        try:
            with hurried(context.instruments[role], CALL_S):  # one that is mute must not keep the bus
                read()
        except InstrumentError as error:
            context.event(Error.of(error))


def scanned(logger: Instrument) -> dict[int, float]:
    """Return temperatures of a data logger by channel, degC. Raises: InstrumentError."""
    return dict(zip(logger.options["channels"], map(float, logger.scan()), strict=True))  # type: ignore[attr-defined]


def leaves_the_bus(context: RunContext) -> bool:
    """Return True while the step under way waits for ``QUIET_S`` yet: a scan keeps the bus for seconds."""
    step = context.step
    if step is None or context.stop.holds.reasons:
        return True
    return context.timeline.target_ns(step.at_s + step.duration_s) - context.clock.now_ns() >= QUIET_S * NS


def _bus_of(instrument: Instrument) -> AbstractContextManager[object]:
    """Return the lock of the bus an instrument is on, so that one reading of several commands is not cut into."""
    lock: AbstractContextManager[object] | None = getattr(getattr(instrument, "bus", None), "lock", None)
    return nullcontext() if lock is None else lock
