"""Counts of a damaged link, bounds of what waits, and the state a link is in."""

from __future__ import annotations

import math
import threading
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_rig import Rig, Sink, frame

from bench.frame import FrameDefinition
from bench.model.clock import NS, Clock, VirtualClock, WallClock
from bench.record import RecordError
from bench.run.links import reader as link_reader
from bench.run.links.acquisition import QUEUE_BYTES, SERVICE_S, Acquisition
from bench.run.links.reader import LinkReader
from bench.run.stop import StopSwitch
from sim_instruments.faults.switchboard import LinkFaults

SEED = 3
BLOCK = 4096  # frames handed over at once
LENGTH = 57  # bytes of a frame of port A


class Line:
    """A link whose bytes are handed in."""

    def __init__(self) -> None:
        self.waiting = b""

    def read(self, size: int = 1) -> bytes:
        taken, self.waiting = self.waiting[:size], self.waiting[size:]
        return taken

    def write(self, sent: bytes) -> int:
        return len(sent)

    @property
    def in_waiting(self) -> int:
        return len(self.waiting)

    def close(self) -> None:
        return None


class Nowhere(Sink):
    """Forgets what it is given."""

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        return None


def reader_of(definition: FrameDefinition, clock: Clock) -> LinkReader:
    return LinkReader("port_a", Line(), definition, clock, Nowhere())


def frames(definition: FrameDefinition, first: int, count: int) -> np.ndarray:
    rng = np.random.default_rng([SEED, first])
    columns = {
        "counter": np.arange(first, first + count) % 65536, "npp": rng.integers(0, 2561, (count, 10)),
        "ppp": rng.integers(0, 2561, (count, 10)), "af_clock": 2560, "master_count": 100_000, "fg_count": 100_000,
        "status": 0,
    }  # fmt: skip
    return definition.encode(columns, count)


def blocks(total: int) -> Iterator[tuple[int, int]]:
    return ((first, min(BLOCK, total - first)) for first in range(0, total, BLOCK))


def take(reader: LinkReader, clock: VirtualClock, sent: bytes, count: int) -> None:
    """Bytes that arrive while ``count`` frames are made."""
    clock.sleep(count / 100)
    reader.link.waiting += sent  # type: ignore[attr-defined]
    reader.receive()
    reader.record(1 << 40)
    reader.decode()


@pytest.mark.parametrize("rate", [1e-5, 1e-4, 1e-3])
def test_no_damaged_frame_of_a_million_is_accepted_and_no_whole_one_missed(rate: float) -> None:
    """Every frame without a flipped bit is found, every other one is not, and each found one is as it was sent."""
    total = 1_000_000
    definition, clock = frame("ngu_a"), VirtualClock()
    reader, faults = reader_of(definition, clock), LinkFaults(SEED, "port_a", bit_error_rate=rate)
    found: list[np.ndarray] = []
    reader.listeners.append(lambda batch: found.append(batch.messages["frame"].rows.copy()))
    whole_frames = 0
    for first, count in blocks(total):
        plain = frames(definition, first, count)
        damaged = faults.frames(first, plain)
        whole = (damaged == plain).all(axis=1)
        whole_frames += int(whole.sum())
        take(reader, clock, damaged.tobytes(), count)
        assert np.array_equal(np.concatenate(found), plain[whole][:, :-2]), f"seed {SEED}, rate {rate}, frame {first}"
        found.clear()
    counts = reader.decoder.counts
    assert counts.frames == whole_frames < total
    assert counts.lost + counts.frames <= total <= counts.lost + counts.frames + LENGTH
    print(f"seed {SEED}: {rate:g} per bit: {total - whole_frames} of {total} frames damaged, none accepted")


def test_lost_and_repeated_among_a_million_frames_are_counted_exactly() -> None:
    total = 1_000_000
    definition, clock = frame("ngu_a"), VirtualClock()
    reader = reader_of(definition, clock)
    faults = LinkFaults(SEED, "port_a", drop_rate=2e-3, duplicate_rate=1e-3)
    copies = np.concatenate([faults.copies(first, count) for first, count in blocks(total)])
    for first, count in blocks(total):
        sent = np.repeat(frames(definition, first, count), copies[first : first + count], axis=0)
        take(reader, clock, sent.tobytes(), count)
    arrived = np.flatnonzero(copies)
    lost = int((copies[arrived[0] : arrived[-1] + 1] == 0).sum())
    counts = reader.decoder.counts
    assert (counts.lost, counts.duplicate) == (lost, int((copies == 2).sum()))
    assert (counts.frames, counts.bad, counts.suspect) == (int(copies.sum()), 0, 0)
    assert lost > 10


def test_exchanged_frames_are_one_lost_and_one_repeated() -> None:
    """The one that comes late is not summed: its place has passed. Both numbers say so."""
    definition, clock = frame("ngu_a"), VirtualClock()
    reader = reader_of(definition, clock)
    order = np.arange(1000)
    order[[500, 501]] = [501, 500]
    take(reader, clock, frames(definition, 0, 1000)[order].tobytes(), 1000)
    counts = reader.decoder.counts
    assert (counts.frames, counts.lost, counts.duplicate) == (1000, 1, 1)
    assert reader.last_counter == 999


@pytest.mark.parametrize("pattern", [b"\x00", b"\xff", b"\xeb", b"\xeb\x90", b"\xeb\x90\xeb"])
def test_a_stuck_stream_takes_no_memory(pattern: bytes) -> None:
    clock = VirtualClock()
    reader = reader_of(frame("ngu_a"), clock)
    block = pattern * 8192

    def much(times: int) -> int:
        for _ in range(times):
            take(reader, clock, block, 100)
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = much(20)
        grown = much(60) - before
    finally:
        tracemalloc.stop()
    print(f"{pattern!r}: {grown} bytes more after {60 * len(block)} bytes")
    assert grown < 64 * 1024
    assert reader.last_counter == -1
    assert reader.decoder.pending_bytes == 0


def test_what_waits_to_be_decoded_is_bounded_and_nothing_is_dropped() -> None:
    definition, clock = frame("ngu_a"), VirtualClock()
    reader, deepest = reader_of(definition, clock), 0
    for first in range(0, 4000, 10):
        reader.link.waiting = frames(definition, first, 10).tobytes()  # type: ignore[attr-defined]
        clock.sleep(0.1)
        reader.receive()
    behind = 0
    while True:
        more = reader.record(QUEUE_BYTES)
        deepest = max(deepest, reader.decoder.pending_bytes)
        reader.decode()
        if not more:
            break
        behind += 1
    assert behind == 4000 * LENGTH // QUEUE_BYTES
    assert QUEUE_BYTES <= deepest < QUEUE_BYTES + 10 * LENGTH
    assert reader.decoder.counts.frames == 4000


def test_more_than_fits_into_memory_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_reader, "HELD_BYTES", 1000)
    reader = reader_of(frame("ngu_a"), VirtualClock())
    reader.link.waiting = bytes(1001)  # type: ignore[attr-defined]
    with pytest.raises(RecordError) as caught:
        reader.receive()
    assert (caught.value.code, caught.value.where) == ("B-REC-003", "port_a")


def test_bytes_the_recorder_refused_are_given_again() -> None:
    definition, clock = frame("ngu_a"), VirtualClock()
    reader = reader_of(definition, clock)
    given: list[bytes] = []

    def raw(link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        if not given:
            given.append(b"")
            raise RecordError("B-REC-003", "full")
        given.append(chunk)

    reader.sink = SimpleNamespace(raw=raw)  # type: ignore[assignment]
    reader.link.waiting = b"abc"  # type: ignore[attr-defined]
    reader.receive()
    with pytest.raises(RecordError):
        reader.record(100)
    reader.record(100)
    assert b"".join(given) == b"abc"


def test_a_link_goes_stale_after_two_periods_and_silent_after_two_seconds(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    acquisition = rig.context().acquisition
    assert acquisition.status()["port_a"].state == "waiting"
    assert math.isnan(acquisition.status()["port_a"].age_s)
    rig.clock.sleep(3.0)
    before = acquisition.status()["port_a"]
    assert (before.state, before.frames, before.lost, before.bad) == ("streaming", 299, 0, 0)
    assert acquisition.readers["port_a"].rate_Hz == pytest.approx(100.0, rel=0.02)
    rig.port_a.dropped = lambda counter: True
    rig.clock.sleep(0.0195)  # the newest frame was stamped at 3 s
    assert acquisition.status()["port_a"].state == "streaming"
    rig.clock.sleep(0.001)
    assert acquisition.status()["port_a"].state == "stale"
    assert acquisition.status()["port_b"].state == "streaming"
    rig.clock.sleep(1.97)
    assert acquisition.status()["port_a"].state == "stale"
    rig.clock.sleep(0.02)
    after = acquisition.status()["port_a"]
    assert (after.state, after.frames) == ("silent", 299)
    assert after.age_s == pytest.approx(2.0105)


@pytest.mark.parametrize("locked", [False, True])
def test_a_status_has_the_counters_of_a_link_and_is_given_even_while_the_lock_is_held(
    tmp_path: Path, locked: bool
) -> None:
    rig = Rig(tmp_path)
    acquisition: Any = rig.context().acquisition
    rig.port_a.dropped = lambda counter: 100 <= counter < 105
    rig.clock.sleep(4.0)
    if locked:
        acquisition.lock = SimpleNamespace(acquire=lambda timeout: False)
    found, reader = acquisition.status()["port_a"], acquisition.readers["port_a"]
    assert (found.frames, found.lost, found.bad) == ((0, 0, 0) if locked else (394, 5, 0))  # as of the last look
    assert (reader.decoder.counts.duplicate, reader.behind) == (0, 0)


def test_waiting_for_frames_is_a_sign_of_life_and_heeds_a_stop(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    context = rig.context()
    lives: list[int] = []
    rig.stop.live.append(lambda at: lives.append(rig.clock.now_ns()))
    assert not context.acquisition.wait_until(lambda: False, NS)
    assert len(lives) == 101
    rig.stop.request("test")
    with pytest.raises(Exception, match="stopped by the operator"):
        context.acquisition.wait_until(lambda: False, 2 * NS)


def test_every_link_gives_its_sign_of_life(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    served: list[int] = []
    rig.context().acquisition.on_serviced = lambda: served.append(rig.clock.now_ns())
    rig.clock.sleep(3.0)
    assert served == [NS, 2 * NS, 3 * NS]


def test_the_decoder_is_never_more_than_a_minute_behind() -> None:
    clock, stop = VirtualClock(), StopSwitch()
    reader = reader_of(frame("ngu_a"), clock)
    acquisition = Acquisition({"port_a": reader}, clock, lambda t_ns: None, stop)
    for first in range(70):
        reader.link.waiting += frames(reader.definition, 100 * first, 100).tobytes()  # type: ignore[attr-defined]
        clock.sleep(1.0)
    assert reader.last_counter == 5999
    acquisition.stop()
    assert reader.last_counter == 6999


class WallInHand(WallClock):
    """A wall clock that stands until it is set; what runs on threads of its own is called by hand, by its period."""

    def __init__(self) -> None:
        super().__init__()
        self.time_ns = 0
        self.called: dict[float, Callable[[], None]] = {}

    def now_ns(self) -> int:
        return self.time_ns

    def every(self, period_s: float, callback: Callable[[], None], *, observer: bool = True) -> Any:
        self.called.setdefault(period_s, callback)
        return SimpleNamespace(cancel=lambda: None)


def test_frames_are_decoded_twice_a_second_and_at_once_while_somebody_looks() -> None:
    clock, definition = WallInHand(), frame("ngu_a")
    reader = reader_of(definition, clock)
    acquisition = Acquisition({"port_a": reader}, clock, lambda now_ns: None, StopSwitch())
    decoded = []
    for turn in range(30):
        clock.time_ns += round(SERVICE_S * NS)
        if turn >= 20:
            acquisition.looked_at()
        reader.link.waiting += frames(definition, turn, 1).tobytes()  # type: ignore[attr-defined]
        reader.receive()
        reader.record(QUEUE_BYTES)
        clock.called[SERVICE_S]()
        decoded.append(reader.decoder.counts.frames)
    acquisition.stop()
    assert decoded == [0] * 4 + [5] * 5 + [10] * 5 + [15] * 5 + [20] + list(range(21, 31))


def test_recording_does_not_wait_for_decoding() -> None:
    definition, clock = frame("ngu_a"), VirtualClock()
    reader = reader_of(definition, clock)
    recorded, began = threading.Event(), threading.Event()

    def listen(batch: object) -> None:
        began.set()
        assert recorded.wait(10.0)

    reader.listeners.append(listen)
    reader.link.waiting += frames(definition, 0, 1).tobytes()  # type: ignore[attr-defined]
    reader.receive()
    reader.record(QUEUE_BYTES)
    decoding = threading.Thread(target=reader.decode)
    decoding.start()
    assert began.wait(10.0)
    reader.link.waiting += frames(definition, 1, 1).tobytes()  # type: ignore[attr-defined]
    reader.receive()
    reader.record(QUEUE_BYTES)
    recorded.set()
    decoding.join()
    assert reader.decoder.counts.frames == 1
    assert reader.decoder.pending_bytes == LENGTH
