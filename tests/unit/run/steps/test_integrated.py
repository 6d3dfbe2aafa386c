"""The unit's integrated mode against its 100 Hz mode: the same gates give the same sums, window by window."""

from __future__ import annotations

import numpy as np
from ngu_rig import decoded, gate_frames, powered_unit, send_command, warm
from numpy.typing import NDArray

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.model.shipped import find_shipped
from bench.record import RecordCutter, RecordRow

SEED = 5
GATES = 10_000
NAMES = ("npp", "ppp", "af_clock", "master_count", "fg_count")
PERIOD_NS = 100 * NS


def sums(rows: dict[str, NDArray[np.int64]], window: int) -> dict[str, list[int]]:
    span = slice(GATES * window, GATES * (window + 1))
    return {name: np.atleast_1d(column[span].sum(axis=0)).tolist() for name, column in rows.items()}


def test_both_modes_count_the_same_gates() -> None:
    """Two units of one seed; one is told to integrate from 7.3 s on, and counts from the next gate."""
    told_s, seconds = 7.3, 420
    units = [powered_unit(seed=SEED, thermal=warm) for _ in range(2)]
    for (clock, unit), payload in zip(units, (b"\x64", b"\x00"), strict=True):
        clock.sleep(told_s)
        for port in ("port_a", "port_b"):
            unit.discard(port)
        send_command(unit, 2, payload)
        clock.sleep(seconds)
    gates = gate_frames(units[0][1].read("port_a", 10**9))
    sent = units[1][1].read("port_a", 10**9)
    integrated = decoded(sent, "ngu_a_100s")["frame"]
    assert integrated.raw("counter").tolist() == [0, 1, 2, 3]
    # the gates before the command is done, 2 ms after it was sent, still come at 100 Hz
    begun = 1 + int(gate_frames(sent).raw("counter")[-1]) if b"\xeb\x90" in sent else int(gates.raw("counter")[0])
    start = begun - int(gates.raw("counter")[0])
    columns = {name: gates.raw(name)[start:].astype(np.int64) for name in NAMES}
    for window in range(4):
        frame = {name: np.atleast_1d(integrated.raw(name)[window].astype(np.int64)).tolist() for name in NAMES}
        assert frame == sums(columns, window)
    print(f"seed {SEED}: N pulses of the last window {frame['npp']}")
    assert sum(frame["npp"]) + sum(frame["ppp"]) > 100


def cut(frame: str, frames: int, chunks: list[tuple[int, bytes]], first: int) -> list[RecordRow]:
    definition = load_frame(find_shipped("frames", frame))
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
    rows = cut("ngu_a_100s", 1, chunks, first=2)
    # frame 2 comes at 200.002 s and counts from 100 s on: housekeeping of seconds 101 to 200, 0.1 degC per second
    means = [row.context["unit_temperature_degC"] for row in rows]
    assert np.allclose(means, [15.05, 25.05, 35.05], rtol=0, atol=1e-9)
