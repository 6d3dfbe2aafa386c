"""Counts of a damaged link, bounds of what waits, the state a link is in; turns of the virtual clock taken at once."""

import threading
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyvisa
import serial
from run_rig import Rig, Sink, frame
from sim_bench import Bench, station

from bench.frame import FrameDefinition, LinkBatch, load_frame
from bench.model.clock import NS, Clock, VirtualClock, WallClock
from bench.model.lab import find_shipped
from bench.record import RecordError
from bench.run.bus import reader as link_reader
from bench.run.bus.acquisition import QUEUE_BYTES, SERVICE_S, Acquisition
from bench.run.bus.port import PortLink
from bench.run.bus.reader import LinkReader, age_s, is_stale, state_of
from bench.run.stop import StopSwitch
from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.worlds.simulation import open_world

SEED = 3
MILLION = pytest.mark.parametrize("total", [100_000, pytest.param(1_000_000, marks=pytest.mark.sweep)])
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


@MILLION
@pytest.mark.parametrize("rate", [1e-5, 1e-4, 1e-3])
def test_no_damaged_frame_of_a_million_is_accepted_and_no_whole_one_missed(rate: float, total: int) -> None:
    """Every frame without a flipped bit is found, every other one is not, and each found one is as it was sent."""
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


@MILLION
def test_lost_and_repeated_among_a_million_frames_are_counted_exactly(total: int) -> None:
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

    def state(name: str = "port_a") -> str:
        acquisition.refresh()
        reader, now_ns = acquisition.readers[name], rig.clock.now_ns()
        return state_of(reader, now_ns, stale=is_stale(reader, now_ns))

    assert state() == "waiting"
    rig.clock.sleep(3.0)
    assert state() == "streaming"
    counts = acquisition.readers["port_a"].decoder.counts
    assert (counts.frames, counts.lost, counts.bad) == (299, 0, 0)
    assert acquisition.readers["port_a"].rate_Hz == pytest.approx(100.0, rel=0.02)
    rig.port_a.dropped = lambda counter: True
    rig.clock.sleep(0.0195)  # the newest frame was stamped at 3 s
    assert state() == "streaming"
    rig.clock.sleep(0.001)
    assert (state(), state("port_b")) == ("stale", "streaming")
    rig.clock.sleep(1.97)
    assert state() == "stale"
    rig.clock.sleep(0.02)
    assert state() == "silent"
    assert counts.frames == 299
    assert age_s(acquisition.readers["port_a"], rig.clock.now_ns()) == pytest.approx(2.0105, abs=1e-3)


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


FRAMES = {"port_b": "ngu_b", "port_a": "ngu_a"}
POLL_S = [{"port_a": 1.0, "port_b": 1.0}, {"port_a": 1.0, "port_b": 0.01}]
TURNS_SEED = 5


class NotingSink:
    """Notes what is recorded and when a second ends, in order; and every flush with what it gave."""

    def __init__(self) -> None:
        self.noted: list[tuple[Any, ...]] = []
        self.reads = 0

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        self.noted.append((link, direction, t_mono_ns, chunk))

    def tick(self, t_mono_ns: int) -> None:
        self.noted.append(("tick", t_mono_ns))

    def decoded(self, link: str, clock: VirtualClock, batch: LinkBatch) -> None:
        self.noted.append((link, clock.now_ns(), [(name, len(part)) for name, part in batch.messages.items()]))


class Calm:
    """Nothing is wrong with the links; notes when it is asked to look after them."""

    calm = True

    def judge(self) -> None: ...

    def service(self) -> None: ...


@pytest.fixture(autouse=True)
def simulated_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial, "protocol_handler_packages", [*serial.protocol_handler_packages, "sim_instruments.bus"])


@contextmanager
def acquiring(poll_s: dict[str, float], sink: NotingSink) -> Iterator[tuple[Bench, Acquisition]]:
    """The simulated unit on its bench, with everything that its links give noted in ``sink``."""
    clock = VirtualClock()
    with ExitStack() as opened:
        world = open_world("af_converter", clock=clock, seed=TURNS_SEED, station=station(), options={})
        opened.callback(world.close)
        bench = Bench(world, pyvisa.ResourceManager(world.visa_library))
        opened.callback(bench.manager.close)
        readers = {}
        for name, frame in FRAMES.items():
            link = PortLink(lambda name=name: serial.serial_for_url(world.link_url(name), baudrate=921_600, timeout=0))
            opened.callback(link.close)
            definition = load_frame(find_shipped("frames", frame))
            readers[name] = LinkReader(name, link, definition, clock, sink, poll_s=poll_s[name])
            readers[name].listeners.append(partial(sink.decoded, name, clock))
        acquisition = Acquisition(readers, clock, sink.tick, StopSwitch())
        acquisition.watch = Calm()
        yield bench, acquisition
        acquisition.stop()


def eight_minutes(poll_s: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> NotingSink:
    """Eight minutes of the simulated unit: started, silent for a while, over a noisy cable, without supply."""
    sink, read = NotingSink(), PortLink.read

    def counted(link: PortLink, size: int = 1) -> bytes:
        sink.reads += 1
        return read(link, size)

    with monkeypatch.context() as patched, acquiring(poll_s, sink) as (bench, acquisition):
        patched.setattr(PortLink, "read", counted)
        bench.clock.every(7.3, acquisition.refresh)
        bench.clock.sleep(3.3)
        bench.send("supply", "CURR 2;VOLT 18;:OUTP ON")
        bench.clock.sleep(140.0)
        faults = bench.world.faults.link("port_a")
        faults.silent = True
        bench.clock.sleep(12.5)
        faults.silent = False
        faults.bit_error_rate = 1e-4
        bench.clock.sleep(123.4)
        bench.send("supply", "OUTP OFF")
        bench.clock.sleep(20.0)
        bench.send("supply", "OUTP ON")
        bench.clock.sleep(180.0)
    return sink


@pytest.mark.parametrize("poll_s", POLL_S, ids=str)
def test_the_same_is_recorded_with_fewer_reads(poll_s: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = eight_minutes(poll_s, monkeypatch)
    monkeypatch.setattr(PortLink, "arrivals", lambda self, turns_ns: ())
    single = eight_minutes(poll_s, monkeypatch)
    assert len(single.noted) > 900
    assert at_once.noted == single.noted, f"seed {TURNS_SEED}"
    assert at_once.reads < single.reads / 2, (at_once.reads, single.reads)


def test_what_a_disk_refuses_in_between_is_recorded_later() -> None:
    refusals = [RecordError("B-REC-003", "the disk takes nothing")]

    class Refusing(NotingSink):
        def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
            if t_mono_ns > 12 * NS and refusals:
                raise refusals.pop()
            super().raw(link, direction, t_mono_ns, chunk)

    taken = []
    for sink in (NotingSink(), Refusing()):
        with acquiring(POLL_S[0], sink) as (bench, _):
            bench.send("supply", "CURR 2;VOLT 18;:OUTP ON")
            bench.clock.sleep(60.0)
        taken.append([b"".join(noted[3] for noted in sink.noted if noted[:2] == (name, "rx")) for name in FRAMES])
    assert not refusals
    assert taken[0] == taken[1]
    assert len(taken[0][1]) > 200_000


def test_a_port_that_is_gone_knows_nothing_of_the_coming_turns() -> None:
    sink = NotingSink()
    with acquiring(POLL_S[0], sink) as (bench, acquisition):
        reader = acquisition.readers["port_a"]
        reader.kept = True
        bench.world.faults.link("port_a").unplugged = True
        bench.clock.sleep(10.0)
        assert "unplugged" in reader.lost
