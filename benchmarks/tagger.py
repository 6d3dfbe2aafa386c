"""Edges of the time tagger through the bench: edges a second, share of a processor, losses.

600,000 edges/s from a source that costs next to nothing, so that tagger, bus, driver and decoder are what is measured:
blocks alone, driver and simulator under the virtual clock, and over HiSLIP in real time with the reader each 50 ms, as
the acquisition comes. Both sides of the bus run in this process.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
import pyvisa

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import NS, Clock, VirtualClock, WallClock
from instruments.pendulum_cnt_91 import PendulumCnt91
from sim_instruments.bus.time_tag_blocks import TagBlocks
from sim_instruments.served.process import InstrumentServers
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import open_world

FRAME = Path(__file__).resolve().parents[1] / "frames" / "time_tags.yaml"
EDGES_HZ, PERIOD_PS = 600_000, 1_666_667
CLOCK_HZ = 100_000_000
SECONDS = 10
READ_S = 0.05
MOST_BYTES = 10_000_000
STATION = {
    "instruments": {"tagger": {"driver": "pendulum_cnt_91", "resource": "TCPIP0::192.168.1.91::INSTR", "options": {}}},
    "links": {},
}


class Row(NamedTuple):
    """One way, for so many seconds of edges: processor time, what arrived, what did not."""

    way: str
    seconds: float
    cpu_s: float
    edges: int
    lost: int


class Edges:
    """A beat without any physics."""

    def __init__(self, epoch_ns: int) -> None:
        self.edges_epoch_ns, self._next = epoch_ns, 0

    def edges_until(self, t_ns: int) -> tuple[Any, ...]:
        """Events not handed out yet."""
        end = (t_ns - self.edges_epoch_ns) * 1000 // PERIOD_PS
        k = np.arange(self._next, end)
        self._next = end
        return k * PERIOD_PS, np.zeros(len(k), np.uint8), (k & 1).astype(np.uint8), (k >> 1 & 1).astype(np.uint8)

    def skip_edges(self, t_ns: int) -> None:
        """Nobody wants those."""
        self._next = (t_ns - self.edges_epoch_ns) * 1000 // PERIOD_PS


@contextmanager
def bench(clock: Clock) -> Iterator[World]:
    """A bench with a tagger on such a beat."""
    world = open_world("af_converter", clock=clock, seed=1, station=STATION)
    edges = Edges(clock.now_ns())
    for name in ("edges_until", "skip_edges", "edges_epoch_ns"):
        setattr(world, name, getattr(edges, name))
    try:
        yield world
    finally:
        world.close()


def driver_at(visa: pyvisa.ResourceManager, address: str, clock: Clock) -> PendulumCnt91:
    """A driver whose stream runs."""
    resource: Any = visa.open_resource(address)
    tagger = PendulumCnt91(resource, role="tagger", clock=clock, transcript=lambda *_: None)
    tagger.configure(float(CLOCK_HZ))
    tagger.start()
    return tagger


def read(tagger: PendulumCnt91, clock: Clock, every_s: float) -> tuple[float, float, list[bytes]]:
    """Seconds of edges, processor time, chunks."""
    chunks, began_s, began_ns = [], process_time(), clock.now_ns()
    while clock.now_ns() < began_ns + SECONDS * NS:
        clock.sleep(every_s)
        chunks.append(tagger.read_stream(MOST_BYTES))
    return (clock.now_ns() - began_ns) / NS, process_time() - began_s, chunks


def decoded(chunks: list[bytes]) -> tuple[float, int, int]:
    """Processor time of decoding, edges, blocks that are bad or missing."""
    decoder, edges, began_s = LinkDecoder(load_frame(FRAME)), 0, process_time()
    for chunk in chunks:
        decoder.push(0, chunk)
        found = decoder.flush().messages["frame"]
        edges += int(found.raw("edges").sum()) if len(found) else 0
        if len(found):
            found.raw("events")
    return process_time() - began_s, edges, decoder.counts.bad + decoder.counts.lost


def blocks() -> Row:
    """Blocks from events, a second at a time."""
    k = np.arange(EDGES_HZ - 1)
    ticks, flags, made, cpu_s = k * PERIOD_PS // 10_000, (k & 3).astype(np.uint32), TagBlocks(), 0.0
    made.start(CLOCK_HZ, 0)
    for second in range(SECONDS):
        began_s = process_time()
        made.add(ticks + second * CLOCK_HZ, flags)
        made.close_until((second + 1) * CLOCK_HZ)
        made.take(MOST_BYTES)
        cpu_s += process_time() - began_s
    return Row("blocks alone", SECONDS, cpu_s, SECONDS * len(k), made.dropped)


def virtual() -> Iterator[Row]:
    """Driver and simulator in one thread; then what the decoder takes."""
    clock = VirtualClock()
    with bench(clock) as world:
        visa = pyvisa.ResourceManager(world.visa_library)
        tagger = driver_at(visa, "TCPIP0::192.168.1.91::INSTR", clock)
        seconds, cpu_s, chunks = read(tagger, clock, 1.0)
        lost = tagger.events_lost()
        visa.close()
    decode_s, edges, missing = decoded(chunks)
    yield Row("simulator, bus and driver, virtual clock", seconds, cpu_s, edges, lost)
    yield Row("decoder", seconds, decode_s, edges, missing)


def served() -> Row:
    """The same over HiSLIP in real time."""
    clock = WallClock()
    with bench(clock) as world:
        servers, visa = InstrumentServers(world), pyvisa.ResourceManager("@py")
        tagger = driver_at(visa, servers.resources()["tagger"], clock)
        seconds, cpu_s, chunks = read(tagger, clock, READ_S)
        lost = tagger.events_lost()
        tagger.stop()
        visa.close()
        servers.close()
    _, edges, missing = decoded(chunks)
    return Row("the same over HiSLIP, real time, both sides", seconds, cpu_s, edges, lost + missing)


def main() -> None:
    """Print one table."""
    ways: list[Callable[[], Any]] = [lambda: [blocks()], virtual, lambda: [served()]]
    sys.stdout.write(f"{'way':<46}{'edges/s':>10}{'CPU %':>8}{'lost':>6}\n")
    for way in ways:
        for row in way():
            rate_Hz, share = row.edges / row.seconds, 100.0 * row.cpu_s / row.seconds
            sys.stdout.write(f"{row.way:<46}{rate_Hz:>10.0f}{share:>8.2f}{row.lost:>6}\n")


if __name__ == "__main__":
    main()
