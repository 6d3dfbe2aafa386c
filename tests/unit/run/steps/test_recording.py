"""Records: cut by the counter from the first whole gate on, taken again when frames are lost, silence noticed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_rig import GATE_NS, K0_C, LINE_NS, PortA, Rig

from bench.model.clock import NS
from bench.model.errors import ExitStatus
from bench.model.quality import Quality
from bench.run.steps.recording import measurement_rows
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


def test_a_record_ends_by_the_counter_and_sums_its_frames_only(tmp_path: Path) -> None:
    rig = recording(tmp_path)
    rig.port_a.npp = np.arange(10)
    (row,) = rig.run().rows
    assert row.sums["npp"].tolist() == [200 * k for k in range(10)]
    assert int(row.sums["master_count"]) == 200 * 100_000
    (event,) = rig.events("record")
    assert (event["number"], event["frames"], event["first_counter"]) == (1, 200, row.window.first_counter)


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


def test_random_loss_is_counted_exactly(tmp_path: Path) -> None:
    gone = set(np.flatnonzero(np.random.default_rng(SEED).random(2000) < 0.01).tolist())
    print(f"seed {SEED}")
    rig = recording(tmp_path)
    rig.port_a.dropped = lambda counter: counter in gone
    (row,) = rig.run().rows
    first = row.window.first_counter
    assert row.lost == len([counter for counter in gone if first <= counter < first + 200]) > 0


@pytest.mark.parametrize("silent_from", [0, 100])
def test_a_unit_that_is_silent_before_a_record_ends_the_run(tmp_path: Path, silent_from: int) -> None:
    rig = recording(tmp_path)
    rig.port_a.dropped = lambda counter: counter >= silent_from
    error = rig.run().error
    assert error.code == "B-RUN-021"
    assert error.exit_status is ExitStatus.SAFE_AFTER_FAULT


@pytest.mark.parametrize("retry", [0, 3])
def test_a_unit_that_is_silent_through_a_record_ends_the_run(tmp_path: Path, retry: int) -> None:
    rig = recording(tmp_path, retry=retry)
    rig.port_a.dropped = lambda counter: counter >= 495
    outcome = rig.run()
    assert outcome.error.code == "B-RUN-021"
    assert outcome.rows == []


# --- wiring --------------------------------------------------------------------------------------------------------

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


@pytest.mark.parametrize(("polarity", "npp", "ppp"), [(1, {3: PER_FRAME}, {}), (-1, {}, {3: PER_FRAME})])
def test_right_wiring_passes_and_is_no_measurement(
    tmp_path: Path, polarity: int, npp: dict[int, int], ppp: dict[int, int]
) -> None:
    rig = wiring(tmp_path, npp, ppp, polarity)
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.rows == []
    assert len(rig.ran.rows) == 1
    assert measurement_rows(rig.ran.rows) == []


@pytest.mark.parametrize(
    ("polarity", "npp", "ppp"),
    [
        (1, {}, {3: PER_FRAME}),  # crossed
        (-1, {3: PER_FRAME}, {}),
        (1, {3: PER_FRAME // 2}, {}),  # half the current
        (1, {3: 2 * PER_FRAME}, {}),
        (1, {3: PER_FRAME}, {3: PER_FRAME}),  # both at once
        (1, {}, {}),  # an open wire
    ],
)
def test_wrong_polarity_or_amount(tmp_path: Path, polarity: int, npp: dict[int, int], ppp: dict[int, int]) -> None:
    rig = wiring(tmp_path, npp, ppp, polarity)
    error = rig.run().error
    assert error.code == "B-RUN-050"
    assert error.where == "test.yaml:2:1"


@pytest.mark.parametrize("other", [1, 2, 4, 10])
@pytest.mark.parametrize("also_own", [True, False])
def test_the_current_reaches_another_channel(tmp_path: Path, other: int, also_own: bool) -> None:
    rig = wiring(tmp_path, {other: PER_FRAME, 3: PER_FRAME if also_own else 0}, {})
    error = rig.run().error
    assert error.code == "B-RUN-051"
    assert f"channel 3 moves channel {other}" in error.message


# --- soak ----------------------------------------------------------------------------------------------------------


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
    for temperature in (50.0,):
        rig.step("soak", "chamber", "soak", temperature=temperature, ramp=0.5, slot=600.0, within=1.0,
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
