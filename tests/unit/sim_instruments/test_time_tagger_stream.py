"""The driver's stream from the simulated tagger: restarts, readers inside other calls, faults of the bus."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scripted import refused
from tagger_bench import Blocks, TaggerBench, tagger_bench

from bench.model.clock import NS
from bench.model.errors import InstrumentError

SLOW_PS = 33_333_331  # 30,000 edges/s


def numbers(bench: TaggerBench, found: Blocks) -> np.ndarray:
    """Which edge each stamp is of, from its time; at 100 MHz a period has 3333 ticks."""
    ticks_ps = found.ticks * (10**12 // found.clock_Hz[0])
    return np.ceil(ticks_ps / bench.edges.period_ps).astype(np.int64)


def test_stop_and_start_lose_no_block_and_number_them_on() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        stream = b""
        for clock_Hz in (20e6, 100e6, 10e6):
            bench.stream(clock_Hz)
            stream += bench.collect(0.95, every_s=0.37)
            bench.tagger.stop()
        stream += bench.collect(0.2, every_s=0.1)
        found = Blocks(stream)
        np.testing.assert_array_equal(np.diff(found.counter), 1)
        assert found.counts.lost == found.counts.bad == 0
        changes = np.flatnonzero(np.diff(found.clock_Hz))
        assert found.clock_Hz[changes].tolist() == [20_000_000, 100_000_000]
        assert found.clock_Hz[-1] == 10_000_000
        assert found.dropped.max() == 0


def test_what_an_earlier_run_left_is_not_of_this_one() -> None:
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


def test_the_safe_state_ends_the_stream_and_what_was_buffered_can_be_read() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        bench.clock.sleep(0.5)
        bench.tagger.make_safe()
        assert not bench.tagger.measuring()
        assert len(Blocks(bench.tagger.read_stream(10**8)).counter) in (50, 51)
        bench.clock.sleep(1.0)
        assert bench.tagger.read_stream(10**8) == b""


@pytest.mark.parametrize("size", [24_032, 100_000, 1_000_000])
def test_no_more_than_asked_for(size: int) -> None:
    with tagger_bench() as bench:
        bench.stream()
        bench.clock.sleep(1.0)
        stream = b""
        while chunk := bench.tagger.read_stream(size):
            assert len(chunk) <= size
            stream += chunk
            if len(stream) > 2_000_000:
                break
        assert Blocks(stream).counts.bad == 0
        assert bench.tagger.read_stream(24_031) == b""  # no block may fit


def test_a_reader_inside_every_call_takes_no_reply_of_theirs() -> None:
    """A task of the virtual clock reads each 0.7 ms: inside writes and reads of the driver, whatever it is doing."""
    with tagger_bench(period_ps=SLOW_PS) as bench:
        chunks: list[bytes] = []
        inside: list[bool] = []

        def read() -> None:
            inside.append(bench.tagger.bus._conversation.depth > 0)
            chunks.append(bench.tagger.read_stream(10**7))
            assert not (inside[-1] and chunks[-1])

        task = bench.clock.every(0.0007, read)
        for clock_Hz in (20e6, 100e6) * 3:
            bench.stream(clock_Hz)
            for _ in range(40):
                assert bench.tagger.events_lost() == 0
                assert bench.tagger.measuring()
            bench.clock.sleep(0.2)
        bench.tagger.stop()
        bench.clock.sleep(0.1)
        task.cancel()
        found = Blocks(b"".join(chunks))
        np.testing.assert_array_equal(np.diff(found.counter), 1)
        assert found.counts.bad == found.counts.lost == 0
        assert len(found.counter) > 200
        assert bench.tagger.drain_errors() == []
        assert inside.count(True) > 100 < inside.count(False)


def test_a_mute_tagger_costs_little_time_and_its_stream_goes_on_afterwards() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        stream = bench.collect(1.0)
        bench.faults.mute = True
        for is_asked in (True, False, True, False):  # in between it is cleared
            began_ns = bench.clock.now_ns()
            if is_asked:
                with refused("B-INST-001"):
                    bench.tagger.read_stream(10**7)
            else:
                assert bench.tagger.read_stream(10**7) == b""
            assert bench.clock.now_ns() - began_ns < 1.5 * NS
        bench.faults.mute = False
        stream += bench.collect(1.0)
        found = Blocks(stream)
        lost = np.diff(found.counter).max() - 1
        assert 0 < lost < 400  # the blocks of the replies that never came are gone, and seen to be
        assert found.counts.lost == np.sum(np.diff(found.counter) - 1)
        assert found.counts.bad == 0
        assert bench.tagger.drain_errors() == []


def test_a_tagger_that_hangs_costs_little_time() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        bench.faults.hang = True
        for _ in range(3):
            began_ns = bench.clock.now_ns()
            with pytest.raises(InstrumentError):
                bench.tagger.read_stream(10**7)
            assert bench.clock.now_ns() - began_ns < 1.5 * NS
        bench.faults.hang = False
        assert len(Blocks(bench.collect(1.0, every_s=0.5)).counter) > 50


def test_a_late_block_is_not_taken_for_a_later_one() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        stream = bench.collect(0.5, every_s=0.1)
        bench.faults.late_s, bench.faults.late_replies = 1.2, 1
        bench.clock.sleep(0.1)
        with pytest.raises(InstrumentError):
            bench.tagger.read_stream(10**7)
        stream += bench.collect(2.0, every_s=0.1)
        found = Blocks(stream)
        assert found.counts.bad == 0
        assert np.all(np.diff(found.counter) > 0)
        assert found.counts.lost == found.counter[-1] - found.counter[0] + 1 - len(found.counter) > 0
        assert bench.tagger.events_lost() == 0  # they were lost on the way, not in the instrument


@pytest.mark.parametrize("replies", [1, 3])
def test_damaged_blocks_are_left_to_the_checksum(replies: int) -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        stream = bench.collect(0.5, every_s=0.1)
        bench.faults.garbled_replies = replies
        codes = set()
        for _ in range(30):
            bench.clock.sleep(0.1)
            try:
                stream += bench.tagger.read_stream(10**7)
            except InstrumentError as error:
                codes.add(error.code)
        assert codes <= {"B-INST-001", "B-INST-004"}
        found = Blocks(stream)
        np.testing.assert_array_equal(found.words & 7, bench.edges.flags(numbers(bench, found)))
        assert 0 < found.counts.lost < 60
        assert found.counter[-1] > 300


def test_power_that_was_gone_leaves_a_silent_stream_until_it_is_started_again() -> None:
    with tagger_bench(period_ps=SLOW_PS) as bench:
        bench.stream()
        bench.collect(0.5)
        bench.device.reset()
        for _ in range(3):
            bench.clock.sleep(0.5)
            assert bench.tagger.read_stream(10**7) == b""
        with refused("B-INST-011", "reads back"):
            bench.tagger.start()
        bench.stream()
        assert len(Blocks(bench.collect(0.5)).counter) >= 50


def test_the_words_of_the_bench_stay_within_a_second() -> None:
    """Stop, configure and start on the bus: less than the pause between two blocks of different clocks may be."""
    with tagger_bench() as bench:
        bench.stream()
        began_ns = bench.clock.now_ns()
        bench.tagger.stop()
        bench.stream(20e6)
        assert bench.clock.now_ns() - began_ns < 0.2 * NS


def test_the_transcript_has_sizes_and_no_bytes() -> None:
    with tagger_bench() as bench:
        bench.stream()
        bench.collect(1.0)
        replies: list[Any] = [line[2] for line in bench.transcript if line[1] == "rx"]
        assert sum(int(text[1:-7]) for text in replies if text.endswith(" bytes>")) > 2_000_000
        assert max(map(len, replies)) < 60
