"""One serial link: raw bytes to the session first, then to the decoder, then to the listeners.

Reading and stamping is one short act under its own lock, which nobody holds while recording or decoding waits for a
disk or for each other: whoever has time can read.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.frame import FrameDefinition, LinkBatch, LinkDecoder, MessageBatch
from bench.model.clock import NS, Clock, to_ns
from bench.model.errors import LinkError
from bench.model.ports import ByteLink, SessionSink
from bench.plan import PlannedUnit
from bench.record import RecordError
from bench.run.bus.port import InstrumentLink

READ_BYTES = 4_000_000  # without a time-out a read returns what is there: 1 s of 600,000 edges and more
HELD_BYTES = 8_000_000  # per link, read and not yet recorded: 11 minutes at 115,200 Bd
ANSWER, REFUSAL = "answer", "refusal"  # messages of a frame definition
SEQUENCE = "sequence"  # the field of a command that its answer repeats
_MARKS = 10  # of the rate, one each second
_NUMBERS = 256  # a sequence number is one byte

BatchListener = Callable[[LinkBatch], None]


class UnitAnswer(NamedTuple):
    """An answer of the unit. ``payload``: behind the status; ``sequence``: -1 if its frames carry none."""

    command: int
    status: int
    payload: bytes
    sequence: int = -1
    refused: bool = False


class SequenceNumbers:
    """The sequence numbers of the commands on one link; to be used under the acquisition's lock or by one thread.

    ``last``: the newest one; ``opened``: the unit has answered one of this run, so that the next one is new to it.
    """

    def __init__(self) -> None:
        self.last = 0
        self.opened = False
        self._asked: set[int] = set()
        self._step = -1  # whose command with the number ``last`` is not answered yet
        self._overtaken = -1  # the step whose command had no answer yet when another one was sent

    def new(self) -> int:
        """Return the next number."""
        self._overtaken = self._step if self._step >= 0 else self._overtaken
        self.last, self._step = (self.last + 1) % _NUMBERS, -1
        self._asked.discard(self.last)
        return self.last

    def of_step(self, step: int) -> int:
        """The number of a step's command: a new one, or that of before if the step was broken off and is done again."""
        if step != self._step:
            self.new()
            self._step = step
        return self.last

    def overtaken(self, step: int) -> bool:
        """Whether the command of this step was broken off and another one sent since: the unit may not know it."""
        return step == self._overtaken

    def settled(self) -> None:
        """The command of the step has its answer, or none is waited for any more."""
        self._step = self._overtaken = -1

    def ask(self, number: int) -> None:
        """The command with this number asks the unit who it is."""
        self._asked.add(number)

    def asks(self, number: int) -> bool:
        """Return whether the command with this number asked the unit who it is."""
        return number in self._asked


@dataclass
class LinkReader:
    """One serial link: reads, stamps, records, queues and decodes.

    ``answers`` collects the unit's answers; ``numbered``: its commands and answers carry one of ``numbers``;
    ``last_counter`` is the unwrapped counter of the newest good frame (-1 before the first), ``last_frame_ns`` its
    receive stamp, ``last_frame_end`` the stream offset behind it, ``last_raw`` its counter as it was sent.
    ``lost`` says why the port is gone, "" while it is there; ``kept`` promises that somebody brings it back, so that
    a lost port is no error yet. ``behind`` counts how often decoding had fallen behind. ``poll_s``: how often it
    is read under the virtual clock, second.
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
    last_raw: int = -1
    last_byte_ns: int = -1
    newest: dict[str, MessageBatch] = field(default_factory=dict)
    answers: list[UnitAnswer] = field(default_factory=list)
    numbers: SequenceNumbers = field(default_factory=SequenceNumbers)
    lost: str = ""
    kept: bool = False
    behind: int = 0
    poll_s: float = 1.0
    on_broken: Callable[[], None] = lambda: None

    def __post_init__(self) -> None:
        self.decoder = LinkDecoder(self.definition)
        self.numbered = any(
            message.name == ANSWER and SEQUENCE in message.by_name for message in self.definition.layout.messages
        )
        self._lock = threading.RLock()  # recording: the order in the session is that of the stream
        self._decoding = threading.RLock()  # nobody who records waits for it
        self._gate = threading.RLock()  # reading and stamping: the order of the stamps is that of the bytes
        self._arrived: deque[tuple[int, bytes]] = deque()
        self._held = 0
        self._decoded_ns = -1
        self._marks: deque[tuple[int, int]] = deque(maxlen=_MARKS)

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """Let no other thread read or record."""
        with self._lock, self._gate:  # in the order of ``record``
            yield

    # --- reading ---------------------------------------------------------------------------------------------------

    def receive(self) -> bool:
        """Read and stamp what has arrived; False when there is nothing or the port is gone.

        Raises: LinkError B-RUN-024 if the port is gone and nobody brings it back; RecordError B-REC-003 if more than
        ``HELD_BYTES`` wait to be recorded.
        """
        with self._gate:
            if self.lost:
                return False
            try:
                chunk = self.link.read(READ_BYTES)
            except OSError as error:
                reason = f"the port cannot be read: {' '.join(str(error).split())}"
                if not self.kept:
                    raise self._broken("B-RUN-024", reason) from error
                self.lost = reason
                return False
            if not chunk:
                return False
            stamp = self.clock.now_ns()
            self.last_byte_ns = stamp
            self._arrived.append((stamp, chunk))
            self._held += len(chunk)
            if self._held > HELD_BYTES:
                raise self._refused()
            return True

    def arrivals(self, turns_ns: Sequence[int]) -> Sequence[int]:
        """Return the bytes that will have arrived at coming times, as far as a simulated link knows them."""
        ask = getattr(self.link, "arrivals", None)
        if ask is None or self._arrived:
            return ()
        try:
            coming: Sequence[int] = ask(turns_ns)
        except OSError:  # the next read says why
            return ()
        return coming

    def receive_parts(self, ends: Sequence[int]) -> list[bytes]:
        """Read what has arrived, cut behind the given numbers of bytes; ``keep_parts`` must follow."""
        with self._gate:
            chunk = self.link.read(ends[-1]) if ends[-1] else b""
        return [chunk[start:end] for start, end in pairwise((0, *ends))]

    def record_part(self, stamp: int, part: bytes) -> None:
        """Record a part with the time it would have been read at."""
        if part:
            self.sink.raw(self.name, "rx", stamp, part)

    def keep_parts(self, stamps: Sequence[int], parts: Sequence[bytes], recorded: int) -> None:
        """Queue the first parts, which are recorded; the others wait for it."""
        for place, (stamp, part) in enumerate(zip(stamps, parts, strict=True)):
            if not part:
                continue
            self.last_byte_ns = stamp
            if place < recorded:
                self.decoder.push(stamp, part)
            else:
                self._arrived.append((stamp, part))
                self._held += len(part)

    def record(self, room: int) -> bool:
        """Record and queue what was read until ``room`` bytes wait to be decoded; True if more was read."""
        with self._lock:
            while self._arrived and self.decoder.pending_bytes < room:
                stamp, chunk = self._arrived[0]
                self.sink.raw(self.name, "rx", stamp, chunk)
                self.decoder.push(stamp, chunk)
                self._arrived.popleft()
                with self._gate:
                    self._held -= len(chunk)
            return bool(self._arrived)

    def found(self) -> None:
        """The port is there again."""
        with self._gate:
            self.lost = ""

    # --- decoding --------------------------------------------------------------------------------------------------

    def decode(self) -> None:
        """Decode what is queued and hand it to the listeners."""
        with self._decoding:
            now_ns, complete = self.clock.now_ns(), not self._arrived
            if self.decoder.pending_bytes == 0:
                return
            batch = self.decoder.flush()
            for message, frames in batch.messages.items():
                if len(frames.offset):
                    self._note(message, frames)
            for listener in self.listeners:
                listener(batch)
            if complete:
                self._decoded_ns = now_ns

    def _note(self, message: str, frames: MessageBatch) -> None:
        self.newest[message] = frames
        if message in (ANSWER, REFUSAL):
            self.answers += answers_of(message, frames)
        if frames.counter is None or frames.t_ns is None or frames.message.counter is None:
            return
        self.last_counter = int(frames.counter[-1])
        self.last_raw = int(frames.raw(frames.message.counter.name)[-1])
        self.last_frame_ns = int(frames.t_ns[-1])
        self.last_frame_end = int(frames.offset[-1]) + int(frames.message.length or 0)
        if not self._marks:
            together = int((frames.t_ns == frames.t_ns[0]).sum())  # one stamp, whenever they really came
            self._marks.append((int(frames.t_ns[0]), self.decoder.counts.frames - len(frames) + together))
        if self.last_frame_ns - self._marks[-1][0] >= NS:
            self._marks.append((self.last_frame_ns, self.decoder.counts.frames))

    def known_ns(self, now_ns: int) -> int:
        """Time up to which everything received is decoded: now, or the last decoding if bytes have come since."""
        waiting = self.decoder.pending_bytes or self._arrived or self.last_byte_ns > self._decoded_ns
        return self._decoded_ns if waiting else now_ns

    @property
    def mid_frame(self) -> bool:
        """True while part of a frame has arrived behind the newest good one."""
        return self.decoder.counts.bytes > self.last_frame_end

    @property
    def period_s(self) -> float:
        """Time between two frames, second; 0 if the frame definition names no rate."""
        return 1.0 / self.definition.rate_Hz if self.definition.rate_Hz else 0.0

    @property
    def rate_Hz(self) -> float:
        """Good frames of the last seconds per second; NaN before one second of them."""
        first = self._marks[0] if self._marks else (self.last_frame_ns, 0)
        seconds = (self.last_frame_ns - first[0]) / NS
        return (self.decoder.counts.frames - first[1]) / seconds if seconds >= 1.0 else float("nan")

    # --- writing ---------------------------------------------------------------------------------------------------

    def write(self, chunk: bytes) -> None:
        """Send bytes for the sequencer; they are recorded.

        Raises: LinkError B-RUN-020; Interruption if the run is to stand still because of the link.
        """
        try:
            self.send(chunk)
        except LinkError:
            self.on_broken()
            raise

    def command(self, code: int, payload: Sequence[int], number: int = -1) -> bytes:
        """Return the frame of a command; ``number`` where commands are numbered."""
        values: dict[str, Any] = {"command": code, "payload": payload}
        if self.numbered:
            values[SEQUENCE] = number
        return self.definition.encode_one(values, "command")

    def send(self, chunk: bytes) -> None:
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

    def _refused(self) -> RecordError:
        return RecordError(
            "B-REC-003",
            f"more than {HELD_BYTES // 1_000_000} MB were read and wait for a disk that takes nothing",
            where=self.name,
            next_step="free space or change the disk, then start again",
        )


def answers_of(message: str, frames: MessageBatch) -> list[UnitAnswer]:
    """Return the answers or refusals of a batch, in order."""
    count, fields = len(frames), frames.message.by_name
    payloads = frames.raw("payload") if "payload" in fields else [b""] * count
    numbers = frames.raw(SEQUENCE) if SEQUENCE in fields else [-1] * count
    columns = (frames.raw("command"), frames.raw("status"), payloads, numbers)
    return [
        UnitAnswer(int(command), int(status), bytes(payload), int(number), message == REFUSAL)
        for command, status, payload, number in zip(*columns, strict=True)
    ]


SILENCE_S = 2.0  # without a good frame: the unit is silent
STALE_PERIODS = 2  # frame periods without a good frame: what is known of it is old
BUFFERED_S = 0.5  # as old may a frame be that an instrument had buffered, without being old

State = Literal["waiting", "streaming", "stale", "silent", "lost"]


def silence_s(reader: LinkReader) -> float:
    """Time without a good frame that makes a link silent, second."""
    return max(SILENCE_S, STALE_PERIODS * reader.period_s)


def age_s(reader: LinkReader, now_ns: int) -> float:
    """Time without a good frame up to the newest byte that is decoded, second; NaN before the first frame."""
    return math.nan if reader.last_frame_ns < 0 else max(0, reader.known_ns(now_ns) - reader.last_frame_ns) / NS


def is_silent(reader: LinkReader, now_ns: int, awake_ns: int = 0) -> bool:
    """Frames came, and what is decoded has had none for too long, nor since this machine is awake."""
    newest_ns = max(reader.last_frame_ns, awake_ns)
    return reader.last_frame_ns >= 0 and reader.known_ns(now_ns) - newest_ns > to_ns(silence_s(reader))


def is_stale(reader: LinkReader, now_ns: int) -> bool:
    """What is decoded has had no good frame for two frame periods, or for longer than a buffer is left alone."""
    limit_s = STALE_PERIODS * reader.period_s if reader.period_s else SILENCE_S
    if isinstance(reader.link, InstrumentLink):
        limit_s = max(BUFFERED_S, limit_s)
    return reader.last_frame_ns >= 0 and reader.known_ns(now_ns) - reader.last_frame_ns > to_ns(limit_s)


def state_of(reader: LinkReader, now_ns: int, *, stale: bool) -> State:
    """Return the state of a link that is ``stale`` unless something worse is true of it."""
    if reader.lost:
        return "lost"
    if reader.last_frame_ns < 0:
        return "waiting"
    if is_silent(reader, now_ns):
        return "silent"
    return "stale" if stale else "streaming"


TEMPERATURE = "unit_temperature"


def thermometer(readers: Mapping[str, LinkReader]) -> tuple[LinkReader | None, str]:
    """Return the link and the message that carry the temperature of the unit; None if there is none."""
    for reader in readers.values():
        for message in reader.definition.layout.messages:
            if TEMPERATURE in message.by_name:
                return reader, message.name
    return None, ""


def of_unit(readers: Mapping[str, LinkReader], unit: PlannedUnit | None) -> Mapping[str, LinkReader]:
    """Return the links of a unit, all of them for None."""
    return readers if unit is None else {name: readers[name] for name in readers if name in unit.names}


@contextmanager
def hearing(
    lock: AbstractContextManager[object],
    readers: Mapping[str, LinkReader],
    heard: Callable[[NDArray[np.int64], NDArray[np.float64]], None],
    of: PlannedUnit | None = None,
) -> Iterator[None]:
    """Hand over every temperature that the unit reports meanwhile, on the thread that decodes: receive stamps, ns, and
    means of its sensors, degC, (n,) each. ``lock``: keeps other threads from decoding. ``of``: which unit of several.
    """
    reader, message = thermometer(of_unit(readers, of))

    def listen(batch: LinkBatch) -> None:
        frames = batch.messages.get(message)
        if frames is not None and len(frames) and frames.t_ns is not None:
            column = frames.scaled(TEMPERATURE)
            good = ~frames.suspect
            heard(frames.t_ns[good], (column if column.ndim == 1 else column.mean(axis=1))[good])

    if reader is not None:
        with lock:
            reader.listeners.append(listen)
    try:
        yield
    finally:
        if reader is not None:
            with lock:
                reader.listeners.remove(listen)
