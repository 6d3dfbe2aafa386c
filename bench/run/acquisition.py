"""Serial acquisition: raw bytes to the session first, then to the decoder, then to the record cutter.

The same tasks run under both clocks: a poll each period reads what has arrived, stamps it with the monotonic clock
and hands it on; decoding happens in large blocks, when somebody asks or when enough is queued.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from bench.frame import FrameDefinition, LinkBatch, LinkDecoder, MessageBatch
from bench.model.clock import NS, Clock, to_ns
from bench.model.errors import LinkError
from bench.model.ports import ByteLink, SessionSink
from bench.run.stop import StopSwitch, guarded

VIRTUAL_POLL_S = 1.0
WALL_POLL_S = 0.05
DECODE_BYTES = 1_000_000
READ_BYTES = 1_000_000  # ports are opened without a time-out: a read returns what is there

ANSWER = "answer"
TEMPERATURE = "unit_temperature"
STALE_S = 10.0  # housekeeping comes ten times a second; older temperatures say nothing about now

BatchListener = Callable[[LinkBatch], None]


@dataclass
class LinkReader:
    """One serial link: reads, stamps, records, queues and decodes.

    ``answers`` collects (command, status, payload) of the unit's answers;
    ``last_counter`` is the unwrapped counter of the newest good frame (-1 before the first), ``last_frame_ns`` its
    receive stamp, ``last_frame_end`` the stream offset behind it.
    """

    name: str
    link: ByteLink
    definition: FrameDefinition
    clock: Clock
    sink: SessionSink
    listeners: list[BatchListener] = field(default_factory=list)
    last_counter: int = -1
    last_frame_ns: int = -1
    last_frame_end: int = 0
    newest: dict[str, MessageBatch] = field(default_factory=dict)
    answers: list[tuple[int, int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.decoder = LinkDecoder(self.definition)
        self._lock = threading.RLock()

    def poll(self) -> None:
        """Read everything that has arrived. Raises: LinkError B-RUN-024."""
        with self._lock:
            try:
                chunk = self.link.read(READ_BYTES)
            except OSError as error:
                raise self._broken("B-RUN-024", f"the port cannot be read: {error}") from error
            if not chunk:
                return
            stamp = self.clock.now_ns()
            self.sink.raw(self.name, "rx", stamp, chunk)
            self.decoder.push(stamp, chunk)

    def decode(self) -> None:
        """Decode what is queued and hand it to the listeners."""
        with self._lock:
            if self.decoder.pending_bytes == 0:
                return
            batch = self.decoder.flush()
            for message, frames in batch.messages.items():
                if len(frames) == 0:
                    continue
                self.newest[message] = frames
                if message == ANSWER:
                    self.answers += _answers(frames)
                if frames.counter is not None and frames.t_ns is not None:
                    self.last_counter = int(frames.counter[-1])
                    self.last_frame_ns = int(frames.t_ns[-1])
                    self.last_frame_end = int(frames.offset[-1]) + int(frames.message.length or 0)
            for listener in self.listeners:
                listener(batch)

    @property
    def mid_frame(self) -> bool:
        """True while part of a frame has arrived behind the newest good one."""
        return self.decoder.counts.bytes > self.last_frame_end

    def write(self, chunk: bytes) -> None:
        """Send bytes to the unit; they are recorded. Raises: LinkError B-RUN-020."""
        with self._lock:
            self.sink.raw(self.name, "tx", self.clock.now_ns(), chunk)
            try:
                sent = self.link.write(chunk)
            except OSError as error:
                raise self._broken("B-RUN-020", f"{len(chunk)} bytes could not be sent: {error}") from error
            if sent is not None and sent != len(chunk):
                raise self._broken("B-RUN-020", f"only {sent} of {len(chunk)} bytes could be sent")

    def _broken(self, code: str, message: str) -> LinkError:
        return LinkError(code, message, where=self.name, next_step="check the cable and the port, then start again")


def _answers(frames: MessageBatch) -> list[tuple[int, int, bytes]]:
    columns = (frames.raw("command"), frames.raw("status"), frames.raw("payload"))
    return [(int(command), int(status), bytes(payload)) for command, status, payload in zip(*columns, strict=True)]


class Acquisition:
    """All links of the bench, polled together; closes the recorder's chunks on seconds of the bench clock.

    ``readers`` are decoded in their given order: housekeeping before the measurement link, so that a record which
    becomes complete finds its context complete too. Hold ``lock`` to keep the polling thread from decoding between
    two looks at a link. An error of a poll ends the run at the next check of ``stop``.
    """

    def __init__(
        self, readers: Mapping[str, LinkReader], clock: Clock, on_tick: Callable[[int], None], stop: StopSwitch
    ) -> None:
        self.readers = dict(readers)
        self.lock = threading.RLock()
        self._clock = clock
        self._on_tick = on_tick
        self._next_second_ns = clock.now_ns() + NS
        self._periodic = clock.every(VIRTUAL_POLL_S if clock.virtual else WALL_POLL_S, guarded(self._poll_all, stop))

    def _poll_all(self) -> None:
        pending = 0
        with self.lock:
            for reader in self.readers.values():
                reader.poll()
                pending += reader.decoder.pending_bytes
            if pending >= (DECODE_BYTES if self._clock.virtual else 1):
                self.decode()
        now = self._clock.now_ns()
        if now >= self._next_second_ns:
            self._on_tick(now)
            self._next_second_ns = (now // NS + 1) * NS

    def decode(self) -> None:
        """Decode what is queued on every link."""
        with self.lock:
            for reader in self.readers.values():
                reader.decode()

    def refresh(self) -> None:
        """Bring every link up to date."""
        with self.lock:
            for reader in self.readers.values():
                reader.poll()
            self.decode()

    def wait_until(self, done: Callable[[], bool], until_ns: int, period_s: float = 0.01) -> bool:
        """Poll and decode until ``done()`` or until the time is over; returns ``done()``."""
        while True:
            self.refresh()
            if done():
                return True
            now = self._clock.now_ns()
            if now >= until_ns:
                return False
            self._clock.sleep_until_ns(min(until_ns, now + round(period_s * NS)))

    def unit_temperature_degC(self) -> float:
        """Mean of the unit's temperature sensors in its newest housekeeping frame, degC.

        NaN before the first frame and when the newest is older than ``STALE_S``.
        """
        for reader in self.readers.values():
            for message in reader.definition.layout.messages:
                if TEMPERATURE in message.by_name:
                    return self._newest_degC(reader, message.name)
        return math.nan

    def _newest_degC(self, reader: LinkReader, message: str) -> float:
        with self.lock:
            reader.poll()
            reader.decode()
            frames = reader.newest.get(message)
        if frames is None or frames.t_ns is None:
            return math.nan
        age_ns = self._clock.now_ns() - int(frames.t_ns[-1])
        return math.nan if age_ns > to_ns(STALE_S) else float(frames.scaled(TEMPERATURE)[-1].mean())

    def stop(self) -> None:
        """Stop polling, read what is left and decode it."""
        self._periodic.cancel()
        self.refresh()
