"""A time tagger alone on a bench, its inputs on edges that can be written down, and the blocks of its stream."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyvisa
from numpy.typing import NDArray
from pyvisa.resources import MessageBasedResource
from scripted import Log
from sim_bench import bare_world

from bench.frame import LinkDecoder, MessageBatch, load_frame
from bench.model.lab import find_shipped
from instruments.pendulum_cnt_91 import PendulumCnt91

ADDRESS = "TCPIP0::192.168.1.91::INSTR"
PERIOD_PS = 1_666_667  # 599,999.9 edges/s: 6,000 in a block at most
PICK_OFF = 500  # one edge in so many is the pick-off's

Int64 = NDArray[np.int64]


class Edges:
    """Edge k comes k periods after the epoch; its levels and channel follow from k."""

    def __init__(self, period_ps: int, epoch_ns: int) -> None:
        self.period_ps, self.edges_epoch_ns = period_ps, epoch_ns
        self.asked_ns: list[int] = []
        self._next = 0

    def times_ps(self, k: Int64) -> Int64:
        return k * self.period_ps

    def flags(self, k: Int64) -> Int64:
        """Bits 0 to 2 as the wire has them."""
        return k % 2 + 2 * (k // 2 % 2) + 4 * (k % PICK_OFF == 0)

    def edges_until(self, t_ns: int) -> tuple[Any, ...]:
        k = np.arange(self._next, self._before(t_ns))
        self._next = max(self._next, self._before(t_ns))
        self.asked_ns.append(t_ns)
        columns = (k % PICK_OFF == 0, k % 2, k // 2 % 2)
        return (self.times_ps(k), *(column.astype(np.uint8) for column in columns))

    def skip_edges(self, t_ns: int) -> None:
        self._next = self._before(t_ns)

    def _before(self, t_ns: int) -> int:
        """Index of the first edge at this time or later."""
        return -(-(t_ns - self.edges_epoch_ns) * 1000 // self.period_ps)


WIRES = ("edges_until", "skip_edges", "edges_epoch_ns")  # to the tagger's inputs


class TaggerBench:
    """A bench with nothing but the tagger: world, edges, driver."""

    def __init__(self, options: dict[str, Any], period_ps: int) -> None:
        self.world = bare_world({"tagger": {"driver": "pendulum_cnt_91", "resource": ADDRESS, "options": options}}, 91)
        self.clock, self.log = self.world.clock, Log()
        self.edges = Edges(period_ps, self.clock.now_ns())
        for name in WIRES:
            setattr(self.world, name, getattr(self.edges, name))
        self.visa = pyvisa.ResourceManager(self.world.visa_library)
        self.tagger = self.driver(options)

    def driver(self, options: dict[str, Any] | None = None) -> PendulumCnt91:
        """Another driver of the same instrument."""
        resource = self.visa.open_resource(ADDRESS, resource_pyclass=MessageBasedResource)
        assert isinstance(resource, MessageBasedResource)
        return PendulumCnt91(resource, role="tagger", clock=self.clock, transcript=self.log, options=options)

    def stream(self, clock_Hz: float = 100e6) -> None:
        """Configure and start."""
        self.tagger.configure(clock_Hz)
        self.tagger.start()

    def collect(self, seconds: float, every_s: float = 1.0) -> bytes:
        """What the reader gets who comes that often."""
        found = b""
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        while self.clock.now_ns() < end_ns:
            self.clock.sleep(every_s)
            found += self.tagger.read_stream(10_000_000)
        return found

    def close(self) -> None:
        self.visa.close()
        self.world.close()


@contextmanager
def tagger_bench(period_ps: int = PERIOD_PS, **options: Any) -> Iterator[TaggerBench]:
    """An open bench under the virtual clock."""
    bench = TaggerBench(options, period_ps)
    try:
        yield bench
    finally:
        bench.close()


class Blocks:
    """Decoded blocks of a stream, with what the decoder counted."""

    def __init__(self, stream: bytes) -> None:
        decoder = LinkDecoder(load_frame(find_shipped("frames", "time_tags")))
        decoder.push(0, stream)
        batch = decoder.flush()
        self.counts = decoder.counts
        found: MessageBatch = batch.messages["frame"]
        self.counter = found.raw("counter").astype(np.int64)
        self.tick = found.raw("tick").astype(np.int64)
        self.clock_Hz = found.raw("clock").astype(np.int64)
        self.dropped = found.raw("dropped").astype(np.int64)
        self.edges = found.raw("edges").astype(np.int64)
        words = [np.frombuffer(events, "<u4") for events in found.raw("events")]
        assert [len(one) for one in words] == self.edges.tolist()
        self.words = np.concatenate([np.empty(0, "<u4"), *words]).astype(np.int64)

    @property
    def ticks(self) -> Int64:
        """Of every event, of the tagger's clock."""
        return np.repeat(self.tick, self.edges) + (self.words >> 3)


SLOW_PS = 33_333_331  # 30,000 edges/s
