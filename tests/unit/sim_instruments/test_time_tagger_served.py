"""The time tagger served over HiSLIP: blocks of any bytes through real sockets, in real time."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest
from pyvisa.util import parse_ieee_block_header
from sim_served import Served, serve
from tagger_bench import PERIOD_PS, Blocks, Edges, station, wire

from bench.model.errors import InputError
from instruments.pendulum_cnt_91 import PendulumCnt91


class ServedTagger:
    """Served bench, its edges and a driver on it."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.edges = Edges(PERIOD_PS, served.world.clock.now_ns())
        wire(served.world, self.edges)
        self.tagger = self.driver(served.open("tagger"))

    def driver(self, resource: object) -> PendulumCnt91:
        clock = self.served.world.clock
        return PendulumCnt91(resource, role="tagger", clock=clock, transcript=lambda *_: None)  # type: ignore[arg-type]

    def collect(self, seconds: float, every_s: float) -> bytes:
        clock, found = self.served.world.clock, b""
        end_ns = clock.now_ns() + round(seconds * 1e9)
        while clock.now_ns() < end_ns:
            clock.sleep(every_s)
            found += self.tagger.read_stream(1_000_000)
        return found


@pytest.fixture
def rack() -> Iterator[ServedTagger]:
    with serve(wiring=station()) as served:
        yield ServedTagger(served)


def test_600_000_edges_a_second_come_whole_through_the_sockets(rack: ServedTagger) -> None:
    rack.tagger.configure(100e6)
    rack.tagger.start()
    stream = rack.collect(1.0, 0.05)
    rack.tagger.stop()
    while chunk := rack.tagger.read_stream(1_000_000):
        stream += chunk
    found = Blocks(stream)
    assert rack.tagger.events_lost() == 0
    assert found.counts.bad == found.counts.lost == found.counts.skipped_bytes == 0
    np.testing.assert_array_equal(np.diff(found.counter), 1)
    k = np.arange(len(found.ticks)) + int(np.ceil(found.ticks[0] * 10_000 / PERIOD_PS))
    np.testing.assert_array_equal(found.ticks, rack.edges.times_ps(k) // 10_000)
    assert len(found.ticks) > 500_000
    assert 10 in stream  # line feeds are bytes like any other


def test_a_reader_in_another_thread_and_commands_do_not_meet(rack: ServedTagger) -> None:
    """Stop and start again and again while another thread reads: no block is lost, no reply taken for another."""
    chunks: list[bytes] = []
    over, failed = threading.Event(), list[Exception]()

    def read() -> None:
        try:
            while not over.wait(0.005):
                chunks.append(rack.tagger.read_stream(1_000_000))
        except Exception as error:
            failed.append(error)

    rack.tagger.configure(100e6)
    reader = threading.Thread(target=read)
    reader.start()
    for clock_Hz in (100e6, 20e6) * 5:
        rack.tagger.configure(clock_Hz)
        rack.tagger.start()
        for _ in range(5):
            assert rack.tagger.measuring()
            assert rack.tagger.events_lost() == 0
    rack.tagger.stop()
    over.set()
    reader.join()
    while chunk := rack.tagger.read_stream(1_000_000):
        chunks.append(chunk)
    assert failed == []
    found = Blocks(b"".join(chunks))
    assert found.counts.bad == found.counts.lost == found.counts.skipped_bytes == 0
    np.testing.assert_array_equal(np.diff(found.counter), 1)
    assert np.count_nonzero(np.diff(found.clock_Hz)) == 9


def test_a_stock_client_reads_the_same_blocks(rack: ServedTagger) -> None:
    rack.tagger.configure(100e6)
    rack.tagger.start()
    rack.served.world.clock.sleep(0.2)
    stock = rack.served.open("tagger")
    stock.read_termination = None
    stock.write("STR:DATA? 240320")
    reply = stock.read_raw(1 << 20)
    begin, length = parse_ieee_block_header(reply)[:2]
    assert reply[begin + length :] == b"\n"
    found = Blocks(reply[begin : begin + length])
    assert found.counts.frames >= 5
    assert found.counts.bad == found.counts.skipped_bytes == 0
    rack.tagger.stop()


def test_a_raw_socket_is_refused(rack: ServedTagger) -> None:
    with pytest.raises(InputError, match="no raw socket") as caught:
        rack.driver(rack.served.open_socket("tagger"))
    assert caught.value.code == "B-INST-020"
