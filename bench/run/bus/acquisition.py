"""Serial acquisition: all links of the bench, read without a pause, recorded at once, decoded in blocks.

Virtual clock: one task reads each second, in one thread; a link of which the station asks it is read more often. Where
nobody else does anything for some turns, they are taken at once, with the parts and the stamps of each turn. Wall
clock: a thread waits for each port and records what it reads; decoding, the recorder's ticks and the return of lost
ports have threads of their own, and one more reads while a disk holds the others up
(docs/decisions/0010-serial-acquisition.md).
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from operator import lt
from typing import Protocol

from bench.model.clock import NS, Clock, Periodic, VirtualClock, to_ns
from bench.model.installed import unforeseen
from bench.plan import PlannedUnit
from bench.run.bus.port import InstrumentLink, PortThread, descriptor_of
from bench.run.bus.reader import TEMPERATURE, LinkReader, of_unit, thermometer
from bench.run.stop import StopSwitch, guarded

VIRTUAL_POLL_S = 1.0
VIRTUAL_DECODE_BYTES = 1_000_000
VIRTUAL_LAG_NS = 60 * NS  # what was received is decoded at least this often
SERVICE_S = 0.1  # as often as the feed has points, which are decoded as often while somebody looks at them
UNSEEN_S = 0.5  # how often is decoded while nobody looks: each time costs some ms, however few the frames
LOOK_NS = 2 * NS  # who looks asks several times a second
TICK_S = 1.0
STALL_S = 0.1
NO_DESCRIPTOR_POLL_S = 0.05
QUEUE_BYTES = 64 * 1024  # per link, recorded and not yet decoded, under the wall clock
STREAM_QUEUE_BYTES = 1024 * 1024  # of one read in large pieces from an instrument, 2.4 MB a second at most
ALIVE_NS = NS // 5
SWITCH_S = 0.0005  # a thread that decodes lets one that reads go on within this time

STALE_S = 10.0  # housekeeping comes ten times a second; older temperatures say nothing about now


Arrivals = list[tuple[int, ...]]
"""By turn: how many bytes have arrived at each link."""


class LinkWatch(Protocol):
    """Who looks after the links (bench.run.links.keeper)."""

    @property
    def calm(self) -> bool:
        """Whether no link is in trouble."""

    def judge(self) -> None:
        """Everything received is decoded: ask the run to stand still for a link that is lost or silent."""

    def service(self) -> None:
        """A few times a second: bring back what is lost."""


class Acquisition:
    """All links of the bench; closes the recorder's chunks on seconds of the bench clock.

    ``readers`` are decoded in their given order: housekeeping before the measurement link, so that a record which
    becomes complete finds its context complete too. Hold ``lock`` to keep other threads from decoding between two
    looks at a link. An error of a thread ends the run at the next check of ``stop``. ``on_serviced`` is called when
    every open port has been looked after.
    """

    def __init__(
        self, readers: Mapping[str, LinkReader], clock: Clock, on_tick: Callable[[int], None], stop: StopSwitch
    ) -> None:
        self.readers = dict(readers)
        self.lock = threading.RLock()
        self.watch: LinkWatch | None = None
        self.on_serviced: Callable[[], None] = lambda: None
        self.on_passed = on_tick  # a second that others follow at once
        self._clock = clock
        self._on_tick = on_tick
        self._stop = stop
        self._next_second_ns = clock.now_ns() + NS
        self._looked_ns = clock.now_ns() - LOOK_NS
        self._serviced_ns = self._decoded_ns = clock.now_ns()
        self._switch_s = sys.getswitchinterval()
        self._threads: dict[str, PortThread] = {}
        self._recording_ns: dict[str, int] = {}  # by link: since when its thread records
        self._turned_ns: dict[str, int] = {}
        for reader in self.readers.values():
            reader.on_broken = self._check_links
        self._periodics = self._begin_virtual(clock) if isinstance(clock, VirtualClock) else self._begin_wall()

    # --- virtual clock ---------------------------------------------------------------------------------------------

    def _begin_virtual(self, clock: VirtualClock) -> list[Periodic]:
        often: dict[float, list[LinkReader]] = {}
        for reader in self.readers.values():
            if reader.poll_s < VIRTUAL_POLL_S:
                often.setdefault(reader.poll_s, []).append(reader)
        tasks: dict[float, Callable[[], None]] = {
            period_s: partial(self._poll_some, clock, readers) for period_s, readers in often.items()
        }
        tasks[VIRTUAL_POLL_S] = partial(self._poll_all, clock)
        return [clock.every(period_s, guarded(task, self._stop)) for period_s, task in tasks.items()]

    def _poll_some(self, clock: VirtualClock, readers: Sequence[LinkReader]) -> None:
        """Links whose receive stamps matter are read more often; the others wait for the second."""
        with self.lock:
            turns_ns = [clock.now_ns(), *clock.turns_ahead_ns()]
            arrivals = _arrivals(readers, turns_ns[:-1])
            self._take_at_once(clock, turns_ns, readers, arrivals, lambda now_ns: None)
            for reader in readers:
                try:
                    waiting = reader.link.in_waiting
                except OSError:  # the read says why
                    waiting = 1
                if waiting:
                    self._poll(reader)

    def _poll_all(self, clock: VirtualClock) -> None:
        with self.lock:
            readers = list(self.readers.values())
            turns_ns = [clock.now_ns(), *clock.turns_ahead_ns()]
            arrivals = self._uneventful(readers, turns_ns[:-1])
            second = partial(self._second, tick=self.on_passed)
            self._take_at_once(clock, turns_ns, readers, arrivals, second)
            pending, now_ns = 0, clock.now_ns()
            for reader in readers:
                self._poll(reader)
                pending += reader.decoder.pending_bytes
            if pending >= VIRTUAL_DECODE_BYTES or now_ns - self._decoded_ns >= VIRTUAL_LAG_NS:
                self.decode()
        self.on_serviced()
        if self.watch is not None:
            self.watch.service()
        self._second(now_ns)

    def _uneventful(self, readers: Sequence[LinkReader], turns_ns: Sequence[int]) -> Arrivals:
        """Return what arrives by those of the coming turns at which nothing is decoded or judged.

        That is: all is well, bytes arrive at every link in each of them, and they may wait to be decoded.
        """
        if not turns_ns or (self.watch is not None and not self.watch.calm):
            return []
        room = VIRTUAL_DECODE_BYTES - sum(reader.decoder.pending_bytes for reader in readers)
        late_ns = self._decoded_ns + VIRTUAL_LAG_NS
        arrivals = _arrivals(readers, turns_ns)
        before = (0,) * len(readers)
        for turn, (turn_ns, arrived) in enumerate(zip(turns_ns, arrivals, strict=False)):
            if sum(arrived) >= room or turn_ns >= late_ns or not all(map(lt, before, arrived)):
                return arrivals[:turn]
            before = arrived
        return arrivals

    def _take_at_once(
        self,
        clock: VirtualClock,
        turns_ns: Sequence[int],
        readers: Sequence[LinkReader],
        arrivals: Arrivals,
        after: Callable[[int], None],
    ) -> None:
        """Pass through the turns of ``arrivals``, then record what each of them would have read.

        The turn behind them is the one of now.
        """
        if not arrivals:
            return
        passed_ns, ends = turns_ns[: len(arrivals)], list(zip(*arrivals, strict=True))
        for reader, of_reader in zip(readers, ends, strict=True):
            if of_reader[-1]:  # said before the clock is there: whoever watches must not take the link for silent
                reader.last_byte_ns = passed_ns[of_reader.index(of_reader[-1])]
        clock.pass_to_ns(turns_ns[len(arrivals)])
        parts: list[list[bytes]] = []
        recorded = [0] * len(readers)
        try:
            parts += (reader.receive_parts(of_reader) for reader, of_reader in zip(readers, ends, strict=True))
            for turn, turn_ns in enumerate(passed_ns):
                for place, reader in enumerate(readers):
                    reader.record_part(turn_ns, parts[place][turn])
                    recorded[place] = turn + 1
                after(turn_ns)
        finally:
            for reader, received, done in zip(readers, parts, recorded, strict=False):  # a port may fail
                reader.keep_parts(passed_ns, received, done)

    def _second(self, now_ns: int, tick: Callable[[int], None] | None = None) -> None:
        if now_ns >= self._next_second_ns:
            (tick or self._on_tick)(now_ns)
            self._next_second_ns = (now_ns // NS + 1) * NS

    # --- wall clock ------------------------------------------------------------------------------------------------

    def _begin_wall(self) -> list[Periodic]:
        sys.setswitchinterval(SWITCH_S)
        for reader in self.readers.values():
            self.listen(reader)
        tasks = [(SERVICE_S, self._service), (TICK_S, self._tick), (STALL_S, self._read_beside)]
        if any(descriptor_of(reader.link) is None for reader in self.readers.values()):
            tasks.append((NO_DESCRIPTOR_POLL_S, self._poll_without_descriptor))
        return [self._clock.every(period_s, guarded(task, self._stop)) for period_s, task in tasks]

    def listen(self, reader: LinkReader) -> None:
        """Wait for a port that was opened; under the virtual clock nothing waits."""
        self.unlisten(reader)
        descriptor = descriptor_of(reader.link)
        if not self._clock.virtual and descriptor is not None:
            ready, turn = partial(self._on_ready, reader), partial(self._on_turn, reader)
            self._threads[reader.name] = PortThread(reader.name, descriptor, ready, turn, self._clock.now_ns)

    def unlisten(self, reader: LinkReader) -> None:
        """Wait no longer for a port that is gone."""
        thread = self._threads.pop(reader.name, None)
        if thread is not None:
            thread.stop()

    def _on_ready(self, reader: LinkReader) -> bool:
        """Read and record; False when the port is gone."""
        try:
            if reader.receive():
                self._recording_ns[reader.name] = reader.last_byte_ns
                self._record(reader)
        except Exception as error:
            self._stop.fail(unforeseen(error))
            return False
        finally:
            self._recording_ns.pop(reader.name, None)
        return not reader.lost

    def _read_beside(self) -> None:
        """A disk that stalls holds up the thread that records, never the reading: it goes on here, nothing waits."""
        now_ns = self._clock.now_ns()
        for name, since_ns in list(self._recording_ns.items()):
            if now_ns - since_ns > to_ns(STALL_S):
                self.readers[name].receive()
                self._on_turn(self.readers[name])

    def _on_turn(self, reader: LinkReader) -> None:
        """Sign of life of one port's thread; it counts when all of them live. Nothing here waits for anybody."""
        now_ns = self._clock.now_ns()
        self._turned_ns[reader.name] = now_ns
        if now_ns - self._serviced_ns < ALIVE_NS:
            return
        turned = [self._turned_ns.get(other.name, 0) for other in self.readers.values() if not other.lost]
        if all(now_ns - turn_ns < NS for turn_ns in turned):
            self._serviced_ns = now_ns
            self.on_serviced()

    def _poll_without_descriptor(self) -> None:
        for reader in self.readers.values():
            if reader.name not in self._threads:
                self._on_turn(reader)
                self._on_ready(reader)

    def _record(self, reader: LinkReader) -> None:
        """Record what was read; where too much waits to be decoded, decode first. Nothing is left out."""
        queue = STREAM_QUEUE_BYTES if isinstance(reader.link, InstrumentLink) else QUEUE_BYTES
        while reader.record(sys.maxsize if self._clock.virtual else queue):
            reader.behind += 1
            self.decode()

    def _service(self) -> None:
        if all(reader.lost for reader in self.readers.values()):
            self.on_serviced()  # no thread is left that could
        if self._is_awaited(self._clock.now_ns()):
            self.decode()
        if self.watch is not None:
            self.watch.service()

    def _is_awaited(self, now_ns: int) -> bool:
        """Return whether it is time to decode: somebody looks, a link is in trouble, or it is long ago."""
        if now_ns - self._looked_ns < LOOK_NS or now_ns - self._decoded_ns >= to_ns(UNSEEN_S):
            return True
        with self.lock:
            return self.watch is not None and not self.watch.calm

    def looked_at(self) -> None:
        """Somebody looks at what the links give; nothing is waited for."""
        self._looked_ns = self._clock.now_ns()

    def _tick(self) -> None:
        self._on_tick(self._clock.now_ns())

    # --- both ------------------------------------------------------------------------------------------------------

    def _poll(self, reader: LinkReader) -> None:
        """Read and record everything that has arrived at a link."""
        reader.receive()
        self._record(reader)

    def decode(self) -> None:
        """Decode what is queued on every link."""
        with self.lock:
            for reader in self.readers.values():
                reader.decode()
            self._decoded_ns = self._clock.now_ns()

    def catch_up(self) -> None:
        """Bring every link up to date, on any thread. Raises: LinkError B-RUN-024, RecordError B-REC-003."""
        with self.lock:
            for reader in self.readers.values():
                self._poll(reader)
            self.decode()

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """Bring every link up to date, and let nothing arrive before this is left.

        What is written meanwhile is stamped behind all bytes that were decoded and before all others: a replay, which
        goes by the stamps, then takes the same bytes for it. Raises: as ``catch_up``.
        """
        with self.lock, ExitStack() as gates:
            for reader in self.readers.values():
                gates.enter_context(reader.at_rest())
            self.catch_up()
            yield

    def refresh(self) -> None:
        """Bring every link up to date; for the sequencer alone, and one of its checks: it may be told to stand still.

        Raises: Interruption if the run is to stand still; what ``stop.check`` raises; LinkError B-RUN-024.
        """
        with self.lock:
            self.catch_up()
            if self.watch is not None:
                self.watch.judge()
        self._stop.check()

    def _check_links(self) -> None:
        """A command could not be sent: if the run is to stand still for a link, that comes first."""
        with self.lock:
            for reader in self.readers.values():
                reader.receive()
            if self.watch is not None:
                self.watch.judge()
        self._stop.check()

    def wait_until(self, done: Callable[[], bool], until_ns: int, period_s: float = 0.01) -> bool:
        """Read and decode until ``done()`` or until the time is over; returns ``done()``. Raises: see ``refresh``."""
        while True:
            self.refresh()
            if done():
                return True
            now = self._clock.now_ns()
            if now >= until_ns:
                return False
            self._clock.sleep_until_ns(min(until_ns, now + to_ns(period_s)))

    def unit_temperature_degC(self, unit: PlannedUnit | None = None) -> float:
        """Return mean of the unit's temperature sensors in its newest housekeeping frame, degC.

        NaN before the first frame and when the newest is older than ``STALE_S``. ``unit``: which one of several.
        """
        reader, message = thermometer(of_unit(self.readers, unit))
        return math.nan if reader is None else self._newest_degC(reader, message)

    def _newest_degC(self, reader: LinkReader, message: str) -> float:
        with self.lock:
            self._poll(reader)
            reader.decode()
            frames = reader.newest.get(message)
        if frames is None or frames.t_ns is None:
            return math.nan
        age_ns = self._clock.now_ns() - int(frames.t_ns[-1])
        return math.nan if age_ns > to_ns(STALE_S) else frames.newest(TEMPERATURE)

    def stop(self) -> None:
        """Stop reading; what is left is recorded and decoded."""
        for periodic in self._periodics:
            periodic.cancel()
        for reader in self.readers.values():
            self.unlisten(reader)
        sys.setswitchinterval(self._switch_s)
        self.catch_up()


def _arrivals(readers: Sequence[LinkReader], turns_ns: Sequence[int]) -> Arrivals:
    """Return the bytes that arrive at each link by coming turns: as many turns as all links know."""
    if not turns_ns or any(reader.lost for reader in readers):
        return []
    return list(zip(*(reader.arrivals(turns_ns) for reader in readers), strict=False))
