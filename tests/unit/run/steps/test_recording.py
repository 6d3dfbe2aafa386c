"""Records: cut by the counter from the first whole gate on, taken again when frames are lost, and without a gap."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_rig import BLOCK, GATE_NS, K0_C, LINE_NS, PortA, Rig

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import NS
from bench.model.errors import ExitStatus
from bench.model.lab import find_shipped
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordCutter, RecordRow
from bench.run.steps.recording import AHEAD_S, measurement_rows
from bench.run.steps.soak import POLL_S

SEED = 7
FIRST_BYTE_NS = 11_000


def recording(folder: Path, start_s: float = 5.0, **arguments: Any) -> Rig:
    rig = Rig(folder)
    rig.step("settle", duration_s=start_s, bus_s=0.0)
    rig.step("record", "port_a", **{"seconds": 2.0, "retry": 0, "max_lost": 0.0, "retry_step": 0, **arguments})
    return rig


@pytest.mark.parametrize(
    "phase_ns", [0, FIRST_BYTE_NS, LINE_NS // 2, LINE_NS - 1, LINE_NS, LINE_NS + 1, GATE_NS // 2, GATE_NS - 1]
)
def test_the_first_frame_is_the_first_whose_whole_gate_is_in_the_record(tmp_path: Path, phase_ns: int) -> None:
    """Gate k lasts from 10 k to 10 (k + 1) ms; its frame has arrived 0.6 ms later.

    Before the first byte of a frame has arrived nobody can know of it: 11 us, against a settle time of seconds.
    """
    rig = recording(tmp_path, start_s=(500 * GATE_NS + phase_ns) / NS)
    (row,) = rig.run().rows
    window = row.window
    gate_start_ns = window.first_counter * GATE_NS
    print(f"start {phase_ns} ns in the gate: first frame {gate_start_ns - window.t_start_ns} ns later")
    assert window.t_start_ns == 500 * GATE_NS + phase_ns
    assert gate_start_ns >= window.t_start_ns
    assert gate_start_ns - window.t_start_ns < 2 * GATE_NS
    assert (row.frames, row.lost, row.quality) == (200, 0, Quality.GOOD)


@pytest.mark.parametrize("stall_s", [0.025, 0.3, 1.3, 1.9])
@pytest.mark.parametrize("phase_ns", [0, LINE_NS // 2, LINE_NS, GATE_NS // 2, GATE_NS - 1])
def test_a_link_that_is_behind_does_not_make_a_record_begin_in_the_settling(
    tmp_path: Path, stall_s: float, phase_ns: int
) -> None:
    """Nothing has come for a while when the record begins: an adapter or a machine that stalls."""
    start_ns = 500 * GATE_NS + phase_ns
    rig = recording(tmp_path, start_s=start_ns / NS)

    class Stalling(PortA):
        @property
        def in_waiting(self) -> int:
            stalled = start_ns - stall_s * NS < self.clock.now_ns() < start_ns + 0.2 * NS
            return 0 if stalled else PortA.in_waiting.fget(self)  # type: ignore[attr-defined, no-any-return]

    rig.port_a.__class__ = Stalling
    (row,) = rig.run().rows
    gate_start_ns = row.window.first_counter * GATE_NS
    assert gate_start_ns >= row.window.t_start_ns
    assert gate_start_ns - row.window.t_start_ns < 3 * GATE_NS
    assert (row.frames, row.lost) == (200, 0)


def test_what_was_received_while_the_links_were_read_lies_before_the_record(tmp_path: Path) -> None:
    """It is decoded before the record is opened; a replay goes by the stamps and must leave it out, too."""
    start_ns, read_ns = 500 * GATE_NS + GATE_NS // 2, 3 * GATE_NS
    rig = recording(tmp_path, start_s=start_ns / NS)
    stamps_ns: list[int] = []

    class Slow(PortA):
        def read(self, size: int = 1) -> bytes:
            if self.clock.now_ns() >= start_ns and not stamps_ns:
                stamps_ns.append(self.clock.now_ns() + read_ns)
                rig.clock.sleep_until_ns(stamps_ns[0])
            return PortA.read(self, size)

    rig.port_a.__class__ = Slow
    (row,) = rig.run().rows
    assert stamps_ns[0] == start_ns + read_ns <= row.window.t_start_ns
    assert (row.frames, row.lost) == (200, 0)


def test_lost_frames_take_the_record_again(tmp_path: Path) -> None:
    rig = recording(tmp_path, retry=2)
    rig.port_a.dropped = lambda counter: 520 <= counter < 530
    outcome = rig.run()
    assert outcome.error is None
    assert [event["reason"] for event in rig.events("retake")] == ["10 of 200 frames lost"]
    (row,) = outcome.rows
    assert (row.window.number, row.lost, outcome.retaken) == (1, 0, 1)
    assert row.window.first_counter > 700


@pytest.mark.parametrize(("max_lost", "taken"), [(0.0, 2), (0.04, 2), (0.05, 1)])
def test_a_loss_within_its_limit_is_flagged_and_kept(tmp_path: Path, max_lost: float, taken: int) -> None:
    rig = recording(tmp_path, retry=1, max_lost=max_lost)
    rig.port_a.dropped = lambda counter: counter % 20 == 0
    (row,) = rig.run().rows
    assert len(rig.events("record")) == taken
    assert (row.lost, row.frames, row.quality) == (10, 190, Quality.LOST)


@pytest.mark.parametrize(("silent_from", "retry"), [(0, 0), (100, 0), (495, 0), (495, 3)])
def test_a_unit_that_is_silent_before_or_through_a_record_ends_the_run(
    tmp_path: Path, silent_from: int, retry: int
) -> None:
    rig = recording(tmp_path, retry=retry)
    rig.port_a.dropped = lambda counter: counter >= silent_from
    outcome = rig.run()
    assert (outcome.error.code, outcome.error.exit_status) == ("B-RUN-021", ExitStatus.SAFE_AFTER_FAULT)
    assert outcome.rows == []


def test_a_unit_that_falls_silent_between_windows_ends_the_run(tmp_path: Path) -> None:
    rig = chained(tmp_path)
    rig.port_a.dropped = lambda counter: counter >= 900
    assert rig.run().error.code == "B-RUN-021"  # type: ignore[union-attr]


CURRENT_A = 1e-3
PER_FRAME = round(CURRENT_A * 0.01 / K0_C)  # 8 pulses in a gate


def wiring(folder: Path, npp: dict[int, int], ppp: dict[int, int], polarity: int = 1) -> Rig:
    """A wiring record of channel 3; counts per frame by channel."""
    conditions = {"channel": 3, "current_A": CURRENT_A, "polarity": polarity, "purpose": "wiring"}
    rig = recording(folder, purpose="wiring", conditions=conditions)
    for channel, count in npp.items():
        rig.port_a.npp[channel - 1] = count
    for channel, count in ppp.items():
        rig.port_a.ppp[channel - 1] = count
    return rig


@pytest.mark.parametrize(
    ("polarity", "npp", "ppp", "code"),
    [
        (1, {3: PER_FRAME}, {}, ""),
        (-1, {}, {3: PER_FRAME}, ""),
        (1, {}, {3: PER_FRAME}, "B-RUN-050"),  # crossed
        (-1, {3: PER_FRAME}, {}, "B-RUN-050"),
        (1, {3: PER_FRAME // 2}, {}, "B-RUN-050"),  # half the current
        (1, {3: 2 * PER_FRAME}, {}, "B-RUN-050"),
        (1, {3: PER_FRAME}, {3: PER_FRAME}, "B-RUN-050"),  # both at once
        (1, {}, {}, "B-RUN-050"),  # an open wire
    ],
)
def test_only_right_polarity_and_amount_pass_and_are_no_measurement(
    tmp_path: Path, polarity: int, npp: dict[int, int], ppp: dict[int, int], code: str
) -> None:
    rig = wiring(tmp_path, npp, ppp, polarity)
    outcome = rig.run()
    assert (outcome.error.code, outcome.error.where) == (code, "test.yaml:2:1") if code else outcome.error is None
    assert outcome.rows == measurement_rows(rig.ran.rows) == []
    assert len(rig.ran.rows) == 1


@pytest.mark.parametrize("other", [1, 2, 4, 10])
@pytest.mark.parametrize("also_own", [True, False])
def test_the_current_reaches_another_channel(tmp_path: Path, other: int, also_own: bool) -> None:
    rig = wiring(tmp_path, {other: PER_FRAME, 3: PER_FRAME if also_own else 0}, {})
    error = rig.run().error
    assert error.code == "B-RUN-051"
    assert f"channel 3 moves channel {other}" in error.message


def soaking(folder: Path, **arguments: Any) -> Rig:
    rig = Rig(folder, "chamber")
    given = {
        "temperature": 50.0, "ramp": 0.5, "slot": 1800.0, "within": 1.0, "for": 300.0, "sensor": "unit",
        "late": "hold", "hold_limit": 1800.0,
    }  # fmt: skip
    rig.step("soak", "chamber", "soak", **{**given, **arguments})
    rig.step("record", "port_a", seconds=1.0, retry=0, max_lost=0.0, retry_step=0, conditions={"channel": 1})
    return rig


def test_a_stable_soak_takes_its_slot(tmp_path: Path) -> None:
    rig = soaking(tmp_path)
    rig.unit_degC = lambda t_s: 50.5 if t_s > 600 else 20.0
    outcome = rig.run()
    assert outcome.error is None
    assert (outcome.slip_s, rig.events("late"), rig.events("slip")) == (0.0, [], [])
    assert outcome.rows[0].window.t_start_ns == 1800 * NS
    assert [call[1:] for call in rig.calls[:2]] == [("chamber.set_temperature", (50.0, 0.5)), ("chamber.run", ())]


@pytest.mark.parametrize(("sensor", "held_s"), [("unit", 540.0), ("air", 505.0)])
def test_a_late_soak_is_held_until_it_is_stable(tmp_path: Path, sensor: str, held_s: float) -> None:
    """2000 s + 300 s stable, at the next look: each 60 s at what the unit said since, each 5 s at the chamber."""
    rig = soaking(tmp_path, sensor=sensor)
    rig.unit_degC = rig.air_degC = lambda t_s: 50.0 if t_s > 2000 else 40.0
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.slip_s == pytest.approx(held_s)
    assert [event["seconds"] for event in rig.events("slip")] == [held_s]
    assert rig.events("late")[0]["policy"] == "hold"
    assert outcome.rows[0].quality == Quality.GOOD
    assert outcome.rows[0].window.t_start_ns == round((1800.0 + held_s) * NS)


@pytest.mark.parametrize(("arguments", "seconds"), [({"late": "abort"}, 1800), ({"hold_limit": 600.0}, 2400)])
def test_a_temperature_that_is_not_reached_ends_the_run(
    tmp_path: Path, arguments: dict[str, Any], seconds: int
) -> None:
    rig = soaking(tmp_path, **arguments)
    rig.unit_degC = lambda t_s: 48.2
    error = rig.run().error
    assert error.code == "B-RUN-031"
    assert f"in {seconds} s (last 48.20 degC, +0.000 degC/min)" in error.message
    assert rig.events("record") == []


def test_records_after_a_skipped_soak_are_flagged_until_the_next_one_is_stable(tmp_path: Path) -> None:
    rig = soaking(tmp_path, late="skip")
    rig.unit_degC = lambda t_s: 50.0 if t_s > 1801 else 40.0
    rig.step("soak", "chamber", "soak", temperature=50.0, ramp=0.5, slot=600.0, within=1.0,
             **{"for": 300.0}, sensor="unit", late="skip", hold_limit=0.0)  # fmt: skip
    rig.step("record", "port_a", seconds=1.0, retry=0, max_lost=0.0, retry_step=0)
    outcome = rig.run()
    assert outcome.error is None
    assert [row.quality for row in outcome.rows] == [Quality.NOT_SETTLED, Quality.GOOD]
    assert [row.window.conditions.get("settled") for row in outcome.rows] == [False, None]
    assert [event["conditions"].get("settled") for event in rig.events("record")] == [False, None]


def test_a_silent_sensor_is_never_taken_for_a_stable_temperature(tmp_path: Path) -> None:
    rig = soaking(tmp_path, hold_limit=120.0)
    rig.unit_degC = lambda t_s: 50.0
    rig.stop.check()

    def silence(_: object) -> None:
        rig.port_b.silent = rig.clock.now_ns() > 900 * NS

    rig.on_tick = silence
    error = rig.run().error
    assert error.code == "B-RUN-031"
    assert "nan" in error.message


def test_a_slot_of_no_length_is_judged_by_one_reading(tmp_path: Path) -> None:
    rig = soaking(tmp_path, slot=0.0, **{"for": 0.0})
    rig.unit_degC = lambda t_s: 50.0
    assert rig.run().error is None
    assert POLL_S == 60.0


WINDOWS_SEED = 21


def chained(folder: Path, *, windows: int = 5, seconds: float = 2.0, call_after: int = 0, **more: Any) -> Rig:
    """Windows behind each other; behind number ``call_after`` (from 1) the chamber is told to go on."""
    rig = Rig(folder, "chamber")
    rig.step("settle", duration_s=5.0, bus_s=0.0)
    for number in range(windows):
        follows = {"follows": True} if number else {}
        conditions = {"route": "open", "window_index": number}
        rig.step(
            "record", "port_a", seconds=seconds, retry=0, max_lost=0.0, retry_step=0, conditions=conditions, **follows,
            **more,
        )  # fmt: skip
        if number + 1 == call_after:
            rig.step("call", "chamber", "set_temperature", temperature=50.0, ramp=0.1)
            rig.step("call", "chamber", "run")
    return rig


def assert_contiguous(rows: list[RecordRow]) -> None:
    for before, after in pairwise(rows):
        assert after.window.first_counter == before.window.first_counter + before.window.frames
        assert after.window.t_start_ns == before.window.t_end_ns


@pytest.mark.parametrize("phase_ns", [0, 600_000, 11_000, GATE_NS // 2, GATE_NS - 1])
def test_windows_are_contiguous_wherever_they_begin(tmp_path: Path, phase_ns: int) -> None:
    rig = chained(tmp_path)
    rig.clock.sleep(phase_ns / NS)
    rig.port_a.npp = np.arange(10)
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.slip_s == 0.0
    assert [row.window.number for row in outcome.rows] == [1, 2, 3, 4, 5]
    assert_contiguous(list(outcome.rows))
    for row in outcome.rows:
        assert (row.frames, row.lost, row.quality, row.timing) == (200, 0, Quality.GOOD, {})
        assert row.sums["npp"].tolist() == [200 * k for k in range(10)]
        gate_ns = row.window.first_counter * GATE_NS
        assert abs(gate_ns - row.window.t_start_ns) < 4 * GATE_NS
    assert [event["number"] for event in rig.events("record")] == [1, 2, 3, 4, 5]
    assert rig.events("gap") == []


@pytest.mark.parametrize("slow_s", [0.0, 0.7, 1.9, 7.0, AHEAD_S - 1.0])
def test_calls_between_windows_cost_no_frame(tmp_path: Path, slow_s: float) -> None:
    """Even if the bus takes longer than whole windows."""
    rig = chained(tmp_path, windows=8, call_after=3)
    rig.instruments["chamber"].slow_s["set_temperature"] = slow_s
    outcome = rig.run()
    assert outcome.error is None
    assert len(rig.called("chamber.set_temperature")) == 1
    assert_contiguous(list(outcome.rows))
    assert {(row.frames, row.lost) for row in outcome.rows} == {(200, 0)}
    assert rig.events("gap") == []


def test_a_bus_that_hangs_for_longer_begins_anew_and_says_so(tmp_path: Path) -> None:
    rig = chained(tmp_path, windows=60, call_after=3)
    rig.instruments["chamber"].slow_s["set_temperature"] = AHEAD_S + 40.0
    outcome = rig.run()
    assert outcome.error is None
    assert len(outcome.rows) == 60
    assert {(row.frames, row.lost) for row in outcome.rows} == {(200, 0)}
    starts = [row.window.first_counter for row in outcome.rows]
    gaps = [k for k in range(1, 60) if starts[k] != starts[k - 1] + 200]
    (gap,) = rig.events("gap")
    assert [gap["record"]] == [outcome.rows[k].window.number for k in gaps]
    assert gap["first_counter"] == starts[gaps[0]] > starts[gaps[0] - 1] + 200  # later, never twice
    assert any("begun anew" in message for message in rig.listener.messages)


@pytest.mark.parametrize("share", [0.01, 0.3])
def test_no_frame_is_in_two_windows_and_none_between_with_dropped_frames(tmp_path: Path, share: float) -> None:
    """Frame k carries one pulse in channel (k mod 10): what arrives must be counted exactly once."""
    gone = set(np.flatnonzero(np.random.default_rng(WINDOWS_SEED).random(4000) < share).tolist())
    print(f"seed {WINDOWS_SEED}, share {share}")
    rig = chained(tmp_path, windows=12, call_after=4, pulse_timing=True)
    rig.port_a.dropped = lambda counter: counter in gone
    rig.port_a.npp = np.tile(np.eye(10, dtype=np.int64), (BLOCK // 10, 1))
    outcome = rig.run()
    assert outcome.error is None
    assert_contiguous(list(outcome.rows))
    first = outcome.rows[0].window.first_counter
    assert [row.window.first_counter for row in outcome.rows] == [first + 200 * k for k in range(12)]
    for row in outcome.rows:
        span = range(row.window.first_counter, row.window.first_counter + 200)
        arrived = [counter for counter in span if counter not in gone]
        assert (row.frames, row.lost) == (len(arrived), 200 - len(arrived))
        assert row.sums["npp"].tolist() == [sum(counter % 10 == k for counter in arrived) for k in range(10)]
        assert bool(row.timing) == (row.lost == 0)
    total = sum(row.sums["npp"].sum() for row in outcome.rows)
    assert total == len([counter for counter in range(first, first + 2400) if counter not in gone])


def test_pulse_times_are_kept_where_they_are_asked_for(tmp_path: Path) -> None:
    rig = chained(tmp_path, windows=2, pulse_timing=True)
    rig.port_a.npp[3] = 2
    first, second = rig.run().rows
    for row in (first, second):
        assert row.timing["npp.moment1"].tolist() == [0, 0, 0, 2 * 200 * 201 // 2] + [0] * 6
        assert row.timing["npp.first"].tolist() == [-1, -1, -1, row.window.first_counter] + [-1] * 6
        assert row.timing["npp.last"][3] == row.window.first_counter + 199
    assert [event["pulse_timing"] for event in rig.events("record")] == [True, True]


def test_a_window_without_any_frame_ends_no_run_that_goes_on(tmp_path: Path) -> None:
    """Of integrated frames a window holds one: a damaged one must not cost the other 899."""
    rig = chained(tmp_path)
    first = 500
    rig.port_a.dropped = lambda counter: first + 200 <= counter < first + 400
    outcome = rig.run()
    assert outcome.error is None
    assert [row.frames for row in outcome.rows] == [200, 0, 200, 200, 200]
    assert_contiguous(list(outcome.rows))


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_windows_follow_the_units_clock_not_the_benchs(tmp_path: Path, ppm: float) -> None:
    """200 ppm over 600 s are 0.12 s: waiting by the bench's clock would drift away from the frames."""
    rig = chained(tmp_path, windows=60, seconds=10.0)
    line_ns = 600_000
    period_ns = GATE_NS * (1 + 1e-6 * ppm)
    shown = rig.port_a.clock

    class UnitClock:
        """The bench's time as the unit's own oscillator counts it."""

        def now_ns(self) -> int:
            return round((shown.now_ns() - line_ns) * GATE_NS / period_ns) + line_ns

    rig.port_a.clock = UnitClock()  # type: ignore[assignment]
    outcome = rig.run()
    assert outcome.error is None
    assert_contiguous(list(outcome.rows))
    assert {row.lost for row in outcome.rows} == {0}
    for row in outcome.rows:
        end_ns = (row.window.first_counter + row.window.frames) * period_ns
        assert abs(row.window.t_end_ns - end_ns) < 1.2 * NS  # a poll each second is as near as the stamps can tell
    last = outcome.rows[-1].window
    assert abs(last.t_end_ns - (last.first_counter + last.frames) * period_ns) < 0.05 * NS


PERIOD_NS = 100 * NS


def cut_windows(frames: int, chunks: list[tuple[int, bytes]], first: int) -> list[RecordRow]:
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
    rows = cut_windows(1, chunks, first=2)
    # frame 2 comes at 200.002 s and counts from 100 s on: housekeeping of seconds 101 to 200, 0.1 degC per second
    means = [row.context["unit_temperature_degC"] for row in rows]
    assert np.allclose(means, [15.05, 25.05, 35.05], rtol=0, atol=1e-9)
