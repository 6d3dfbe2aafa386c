"""Windows of the unit's integrated mode, which hold one frame each."""

from __future__ import annotations

import numpy as np

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.model.shipped import find_shipped
from bench.record import RecordCutter, RecordRow

PERIOD_NS = 100 * NS


def cut(frames: int, chunks: list[tuple[int, bytes]], first: int) -> list[RecordRow]:
    definition = load_frame(find_shipped("frames", "ngu_a_100s"))
    decoder, cutter = LinkDecoder(definition), RecordCutter(definition)
    house = LinkDecoder(load_frame(find_shipped("frames", "ngu_b")))
    for number in range(3):
        start_ns = (number + 1) * PERIOD_NS
        cutter.open(RecordWindow(number + 1, "port_a", first + number * frames, frames, start_ns, start_ns + PERIOD_NS))
    for t_ns, sent in chunks:
        if sent[1] == 0x9B:
            house.push(t_ns, sent)
            cutter.feed_context(house.flush())
        else:
            decoder.push(t_ns, sent)
            cutter.feed(decoder.flush())
    return cutter.finished()


def test_a_window_of_one_frame_knows_its_temperature() -> None:
    """The frame arrives at its end: the housekeeping of the 100 s before it is that of its counts."""
    a, b = (load_frame(find_shipped("frames", name)) for name in ("ngu_a_100s", "ngu_b"))
    chunks: list[tuple[int, bytes]] = []
    for second in range(1, 451):
        columns = {
            "counter": np.array([second]), "unit_temperature": np.full((1, 4), 10 * second), "supply_voltage": 28000,
            "supply_current": 1800, "rails": np.full((1, 3), 5000), "status": 1,
        }  # fmt: skip
        chunks.append((second * NS, b.encode(columns, 1, "housekeeping").tobytes()))
        if second % 100 == 0:
            counts = {name: np.zeros((1, 10), int) for name in ("npp", "ppp")} | {"counter": np.array([second // 100])}
            clocks = {"af_clock": 25_600_000, "master_count": 10**9, "fg_count": 10**9, "status": 0}
            chunks.append((second * NS + 2_000_000, a.encode(counts | clocks, 1).tobytes()))
    rows = cut(1, chunks, first=2)
    # frame 2 comes at 200.002 s and counts from 100 s on: housekeeping of seconds 101 to 200, 0.1 degC per second
    means = [row.context["unit_temperature_degC"] for row in rows]
    assert np.allclose(means, [15.05, 25.05, 35.05], rtol=0, atol=1e-9)
