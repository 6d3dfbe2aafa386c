"""The simulated time tagger: its blocks byte by byte, the stream of the driver, restarts, faults of the bus."""

import struct
from fractions import Fraction

import numpy as np
import pytest
from crccheck.crc import Crc32
from tagger_bench import SLOW_PS, WIRES, Blocks, tagger_bench

from sim_instruments.bus.time_tag_blocks import MEMORY_BLOCKS, MOST_EVENTS, TagBlocks


def test_a_run_begins_with_its_own_blocks_and_ends_with_the_safe_state() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        bench.clock.sleep(1.0)
        other = bench.driver()
        other.configure(100e6)
        began_tick = bench.clock.now_ns() // 10
        other.start()
        bench.clock.sleep(0.5)
        found = Blocks(other.read_stream(10**8))
        assert found.tick[0] >= began_tick
        assert found.counter[0] >= 100  # numbered on all the same
        assert found.dropped.max() == 0
        bench.stream()
        bench.clock.sleep(0.5)
        bench.tagger.make_safe()
        assert not bench.tagger.measuring()
        assert len(Blocks(bench.tagger.read_stream(10**8)).counter) in (50, 51)
        bench.clock.sleep(1.0)
        assert bench.tagger.read_stream(10**8) == b""


def written(counter: int, tick: int, clock_Hz: int, dropped: int, events: str) -> bytes:
    """A block out of the words of frames/time_tags.yaml; the checksum is another library's."""
    words = bytes.fromhex(events)
    size = 4 + 24 + len(words) + 4
    body = struct.pack("<HIQIIH", size, counter, tick, clock_Hz, dropped, len(words) // 4) + words
    return bytes.fromhex("a55ac33c") + body + struct.pack("<I", Crc32.calc(body))


def add(blocks: TagBlocks, *events: tuple[int, int]) -> None:
    ticks, flags = zip(*events, strict=True)
    blocks.add(np.array(ticks, np.int64), np.array(flags, np.uint32))


def test_blocks_are_those_written_by_hand() -> None:
    """At 10 MHz a block has 100,000 ticks. Edges: tick 7 beat up, cosine up; 70,007 pick-off up; 100,006 beat down."""
    blocks = TagBlocks()
    blocks.start(10_000_000, 7)
    add(blocks, (7, 0b011), (70_007, 0b101), (100_006, 0b000))
    blocks.close_until(100_006)
    assert blocks.take(1000) == b""
    blocks.close_until(100_007)
    expected = bytes.fromhex(
        "a55ac33c 2c00 00000000 0700000000000000 80969800 00000000 0300"
        "03000000"  # 0 ticks << 3 | 3
        "858b0800"  # 70,000 << 3 | 5 = 0x88b85
        "f8340c00"  # 99,999 << 3 = 0xc34f8
    )
    assert blocks.take(1000) == expected + struct.pack("<I", Crc32.calc(expected[4:]))
    blocks = TagBlocks()
    blocks.start(10_000_000, 0)
    add(blocks, (99_999, 1), (100_000, 0))
    blocks.close_until(400_000)
    assert blocks.take(10_000) == b"".join(
        [
            written(0, 0, 10_000_000, 0, "f9340c00"),
            written(1, 100_000, 10_000_000, 0, "00000000"),
            written(2, 200_000, 10_000_000, 0, ""),
            written(3, 300_000, 10_000_000, 0, ""),
        ]
    )
    blocks = TagBlocks()
    blocks.start(10_000_000, 0)
    blocks.close_until(300_000)  # three of 32 bytes
    assert [len(blocks.take(size)) for size in (31, 63, 64, 64)] == [0, 32, 64, 0]


def test_edges_come_in_any_portions() -> None:
    rng = np.random.default_rng(17)
    ticks, flags = np.sort(rng.integers(0, 5_000_000, 20_000)), rng.integers(0, 8, 20_000).astype(np.uint32)
    streams = []
    for cuts in ([5_000_000], [*np.sort(rng.integers(0, 5_000_000, 60)).tolist(), 5_000_000]):
        blocks, begin = TagBlocks(), 0
        blocks.start(20_000_000, 0)
        for cut in cuts:
            end = int(np.searchsorted(ticks, cut))
            blocks.add(ticks[begin:end], flags[begin:end])
            blocks.close_until(cut)
            begin = end
        streams.append(blocks.take(10**7))
    assert streams[0] == streams[1]
    found = Blocks(streams[0])
    np.testing.assert_array_equal(found.ticks, ticks)
    np.testing.assert_array_equal(found.words & 7, flags)


def test_what_does_not_fit_into_block_or_memory_is_counted() -> None:
    blocks = TagBlocks()
    blocks.start(100_000_000, 0)
    ticks = np.arange(12_500) * 160  # 6,250 in each of two blocks
    blocks.add(ticks, np.zeros(12_500, np.uint32))
    blocks.close_until(3_000_000)
    found = Blocks(blocks.take(10**7))
    assert found.edges.tolist() == [MOST_EVENTS, MOST_EVENTS, 0]
    assert found.dropped.tolist() == [250, 500, 500]
    np.testing.assert_array_equal(found.ticks, [*ticks[:6000], *ticks[6250:12_250]])
    blocks = TagBlocks()
    blocks.start(10_000_000, 0)
    total = MEMORY_BLOCKS + 5
    blocks.add(np.arange(total) * 100_000, np.ones(total, np.uint32))
    blocks.close_until(total * 100_000)
    first = Blocks(blocks.take(10**7))
    assert len(first.counter) == MEMORY_BLOCKS
    assert first.dropped[-1] == 0
    add(blocks, (total * 100_000, 1))
    blocks.close_until((total + 1) * 100_000)
    after = Blocks(blocks.take(10**7))
    assert after.counter.tolist() == [total]
    assert after.dropped.tolist() == [5] == [blocks.dropped]


@pytest.mark.parametrize("clock_Hz", [10_000_000, 20_000_000, 50_000_000, 100_000_000])
@pytest.mark.parametrize("error_ppm", [0.0, 25.0, -312.5])
def test_stamps_are_whole_ticks_of_its_own_clock(clock_Hz: int, error_ppm: float) -> None:
    """Each stamp against exact fractions; the tagger starts where its clock has counted for some milliseconds."""
    with tagger_bench(period_ps=33_333_331, clock_error_ppm=error_ppm) as bench:
        bench.stream(float(clock_Hz))
        found = Blocks(bench.collect(0.5))
        rate = Fraction(clock_Hz) * (1 + Fraction(error_ppm) / 10**6)
        first = round(float(found.ticks[0] / rate) * 1e12 / 33_333_331)
        times_ps = [int(t) for t in bench.edges.times_ps(np.arange(first, first + len(found.ticks)))]
        np.testing.assert_array_equal(found.ticks, [t * rate // 10**12 for t in times_ps])
        np.testing.assert_array_equal(found.words & 7, bench.edges.flags(np.arange(first, first + len(found.ticks))))
        assert set(found.clock_Hz.tolist()) == {clock_Hz}
        assert set(np.diff(found.tick).tolist()) == {clock_Hz // 100}


def test_an_idle_tagger_asks_for_no_edge_and_without_comparators_blocks_are_empty() -> None:
    with tagger_bench() as bench:
        bench.tagger.configure(100e6)
        bench.clock.sleep(3600.0)
        assert bench.edges.asked_ns == []
        bench.tagger.start()
        bench.collect(5.0, every_s=2.5)
        assert len(bench.edges.asked_ns) >= 6
        assert np.diff([bench.clock.now_ns() - 5 * 10**9, *bench.edges.asked_ns]).max() <= 10**9
    with tagger_bench() as bench:
        for name in WIRES:
            delattr(bench.world, name)
        bench.stream()
        found = Blocks(bench.collect(1.0))
        assert len(found.counter) >= 100
        assert found.edges.sum() == 0


def test_the_instrument_refuses_what_it_cannot_do_and_a_reset_forgets_everything() -> None:
    with tagger_bench() as bench:
        bench.tagger.configure(20e6, 0.1014)
        assert float(bench.tagger.raw("INP2:LEV?") or "") == pytest.approx(0.1025)
        bench.tagger.start()
        bench.clock.sleep(0.5)
        bench.tagger.raw("*RST")
        assert bench.tagger.raw("STR:DATA? 100000") == "#10"
        assert not bench.tagger.measuring()
        assert bench.tagger.raw("INP:COUP?") == "AC"
        assert int(bench.tagger.raw("STR:CLOC?") or 0) == 10_000_000
        tagger = bench.tagger
        tagger.identify()
        for commands, code in (
            (["STR:CLOC 30E6"], -222),
            (["STR:CLOC 1E9"], -222),
            (["INIT", "INIT"], -213),
            (["STR:CLOC 2E7"], -221),
            (["INP:LEV 5.1"], -222),
            (["INP2:COUP HF"], -224),
            (["FETC:ARR? MAX"], -113),
        ):
            for command in commands:
                tagger.bus.write(command, 1.0)
            assert tagger.drain_errors()[0].startswith(str(code)), commands
