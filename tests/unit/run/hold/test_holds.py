"""Standing still, taking a point again and skipping it, through the whole sequencer on a fake bench."""

import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_rig import RECORD_S, SETTLE_S, HoldRig, Instrument, Passive, Rig, instrument_error, sound

from bench.model.errors import BenchError, ExitStatus
from bench.model.ports import Effect, Identity, action
from bench.plan import Step
from bench.run.hold import ALARM_S, ASK_S, MOST_HOLDS
from bench.run.stop import AWAY_LIMIT_S, Holds, Interruption, StopSwitch, Wish

POINT_S = SETTLE_S + RECORD_S
SOAK = {"temperature": 20.0, "ramp": 0.5, "slot": 600.0, "within": 1.0, "for": 120.0, "sensor": "unit", "late": "abort"}


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_holds_at_random_instants_cost_time_and_no_record(tmp_path: Path, seed: int, *, flat: bool) -> None:
    rng = np.random.default_rng(seed)
    rig, points = HoldRig(tmp_path, 4, flat=flat), 4
    holds = rig.stop.holds
    moments = np.sort(rng.uniform(0.1, points * POINT_S, 3))
    for number, moment_s in enumerate(moments):
        rig.at(float(moment_s), lambda number=number: holds.hold(f"by {number}", "test"))  # type: ignore[misc]
        length_s = float(rng.uniform(0.0, 50.0))
        rig.at(float(moment_s) + length_s, lambda number=number: holds.release(f"by {number}"))  # type: ignore[misc]
    outcome = rig.run_beside()
    print(f"seed {seed}: {moments}")
    assert outcome.error is None
    sound(rig, points)
    assert len(rig.events("hold")) == len(rig.events("release"))
    held_s = sum(event["seconds"] for event in rig.events("release"))
    end_s = rig.ran.rows[points].window.t_end_ns / 1e9
    again_s = end_s - points * POINT_S - outcome.slip_s  # a last record that was taken again alone is no slip
    assert again_s == pytest.approx(0.0, abs=0.05) or (flat and again_s == pytest.approx(RECORD_S, abs=0.05))
    assert outcome.slip_s >= held_s


def test_only_what_drives_the_stimulus_goes_off_and_the_point_is_taken_again(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 2)
    rig.at(8.0, lambda: rig.stop.holds.hold("door", "the door is open"))
    rig.at(40.0, lambda: rig.stop.holds.release("door"))
    outcome = rig.run_beside()
    assert outcome.error is None
    sound(rig, 2)
    safe = rig.called("source.make_safe")
    assert 8.0 <= safe[0] <= 15.1
    assert rig.called("supply.make_safe") == rig.called("supply.make_safe")[-1:]  # only at the end of the run
    assert rig.events("hold")[0] | {"step": 2} == {"step": 2, "by": "door", "reason": "the door is open"}
    assert rig.events("release")[0]["seconds"] > 20.0
    assert rig.events("alarm") == []


def test_a_record_that_is_complete_is_taken_back_when_its_point_is_not(tmp_path: Path) -> None:
    """The wish comes between the record and its verification: nobody knows what the stimulus did by then."""
    rig = HoldRig(tmp_path, 2)
    rig.source.slow_s["operating"] = 1.0  # 15 s to 16 s
    rig.at(14.9, lambda: rig.stop.holds.wish(Wish("retake", "somebody", "test")))
    outcome = rig.run_beside()
    assert outcome.error is None
    sound(rig, 2)
    rig = HoldRig(tmp_path, 2)
    rig.listener.on_step = lambda step: (
        rig.stop.holds.wish(Wish("retake", "somebody", "test")) if step.number == 3 and outcomes() == 1 else None
    )

    def outcomes() -> int:
        return rig.listener.steps.count(3)

    outcome = rig.run_beside()
    assert outcome.error is None
    sound(rig, 2)


@pytest.mark.parametrize("moment_s", [0.5, 4.0, 9.0, 14.5])
def test_a_skipped_point_leaves_no_record_and_the_next_ones_are_whole(tmp_path: Path, moment_s: float) -> None:
    rig = HoldRig(tmp_path, 3)
    rig.at(moment_s, lambda: rig.stop.holds.wish(Wish("skip", "somebody", "bad point")))
    outcome = rig.run_beside()
    assert outcome.error is None
    assert [row.window.conditions["point"] for row in outcome.rows] == [1, 2]
    assert [row.frames for row in outcome.rows] == [1000, 1000]
    assert [row.window.number for row in outcome.rows] == [1, 2]
    (skip,) = rig.events("skip")
    assert (skip["first"], skip["stop"], skip["reason"]) == (0, 4, "bad point")


def test_holding_longer_than_the_limit_of_its_reason_ends_the_run_safely(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 2)
    rig.at(7.0, lambda: rig.stop.holds.hold("chamber", "it is cold", limit_s=900.0))
    rig.at(8.0, lambda: rig.stop.holds.hold("operator", "lunch", limit_s=86_400.0))
    outcome = rig.run_beside()
    assert outcome.error.code == "B-RUN-070"
    assert "it is cold" in outcome.error.message
    assert outcome.error.exit_status is ExitStatus.SAFE_AFTER_FAULT
    assert rig.called("source.make_safe")[-1] == pytest.approx(7.0 + 900.0, abs=20.0)
    (alarm,) = rig.events("alarm")
    assert alarm["what"] == "hold"
    assert ALARM_S <= alarm["seconds"] <= ALARM_S + 1.0
    assert alarm["reasons"] == {"chamber": "it is cold", "operator": "lunch"}


@pytest.mark.parametrize("end", ["stop", "fault"])
def test_a_run_that_holds_still_stops(tmp_path: Path, end: str) -> None:
    rig = HoldRig(tmp_path, 2)
    rig.at(7.0, lambda: rig.stop.holds.hold("somebody", "test"))
    fault = BenchError("B-RUN-024", "gone")
    rig.at(100.0, (lambda: rig.stop.request("SIGTERM")) if end == "stop" else (lambda: rig.stop.fail(fault)))
    outcome = rig.run_beside()
    assert outcome.error.code == ("B-RUN-010" if end == "stop" else "B-RUN-024")
    assert rig.called("source.make_safe")[-1] <= 101.0
    assert rig.called("supply.make_safe")


def test_the_end_of_a_run_is_not_held_up(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 1)
    rig.step("settle", duration_s=30.0, bus_s=0.0, phase="finally")
    rig.at(20.0, lambda: rig.stop.holds.hold("somebody", "too late"))
    outcome = rig.run_beside()
    assert outcome.error is None
    assert rig.events("hold") == []


@pytest.mark.parametrize(("silent_s", "code"), [(30.0, None), (1e9, "B-RUN-070")])
def test_a_stimulus_that_does_not_go_off_is_told_again_and_nothing_goes_on_before(
    tmp_path: Path, silent_s: float, code: str | None
) -> None:
    rig = HoldRig(tmp_path, 2)

    def broken() -> None:
        rig.source.fail["make_safe"] = instrument_error()
        rig.stop.holds.hold("somebody", "test")

    rig.at(7.0, broken)
    rig.at(20.0, lambda: rig.stop.holds.release("somebody"))
    rig.at(7.0 + silent_s, rig.source.fail.clear)
    outcome = rig.run_beside()
    assert (outcome.error.code if outcome.error else None) == code
    told = [alarm for alarm in rig.events("alarm") if alarm["what"] == "stimulus"]
    assert {(alarm["role"], alarm["code"]) for alarm in told} == {("source", "B-INST-001")}
    assert len(told) >= 3
    if code is None:
        sound(rig, 2)
        assert rig.events("release")[0]["seconds"] >= silent_s - 15.0
    else:
        assert f"{AWAY_LIMIT_S:g} s" in outcome.error.message
        assert [(one.code, one.where) for one in outcome.unsafe] == [("B-RUN-060", "source")]


def test_wishes_standing_still_comes_first_and_a_wish_is_granted_once() -> None:
    holds = Holds()
    holds.wish(Wish("skip", "a", "first"))
    holds.wish(Wish("retake", "b", "second"))
    holds.hold("c", "third")
    assert holds.take() == Wish("hold", "c", "third")
    assert holds.release("c")
    assert not holds.release("c")
    assert holds.take() == Wish("skip", "a", "first")
    assert holds.take() is None
    assert holds.overdue(1e9) is None


def test_a_check_raises_the_wish_only_where_a_run_may_be_interrupted() -> None:
    stop = StopSwitch()
    stop.holds.hold("a", "b")
    stop.interruptible = False
    stop.check()
    stop.interruptible = True
    with pytest.raises(Interruption, match="hold: b"):
        stop.check()
    stop.shield()
    assert stop.over
    stop.check()


def test_an_abort_reaches_a_run_that_waits_for_a_person() -> None:
    """The thread that waits for an answer sees no request; it is woken, and this counts as a first wish to stop."""
    with StopSwitch() as stop:
        timer = threading.Thread(target=lambda: waiting.wait(20.0) and stop.request("abort by me"))
        waiting = threading.Event()
        timer.start()

        def ask() -> None:
            with stop.at_once():
                waiting.set()
                threading.Event().wait(20.0)

        with pytest.raises(BenchError) as caught:
            ask()
        timer.join()
    assert caught.value.code == "B-RUN-010"
    assert "abort by me" in caught.value.message


def test_a_second_abort_or_signal_after_an_abort_stops_at_once() -> None:
    with StopSwitch() as stop:
        stop.request("abort by me")
        with pytest.raises(BenchError, match="B-RUN-011"):
            os.kill(os.getpid(), signal.SIGTERM)


def test_a_reason_that_comes_during_a_long_pause_has_its_own_limit(tmp_path: Path) -> None:
    """A pause may last a day; a door that opens late in it has its own time from then on, and not none."""
    rig = HoldRig(tmp_path, 2)
    holds = rig.stop.holds
    rig.at(7.0, lambda: holds.hold("operator", "lunch", limit_s=86_400.0))
    for since_s, until_s in ((500.0, 650.0), (700.0, 850.0)):
        rig.at(since_s, lambda: holds.hold("interlock door", "open", limit_s=200.0))
        rig.at(until_s, lambda: holds.release("interlock door"))
    rig.at(900.0, lambda: holds.release("operator"))
    outcome = rig.run_beside()
    assert outcome.error is None
    sound(rig, 2)


@pytest.mark.parametrize("kind", ["settle", "soak"])
def test_what_is_no_point_is_never_skipped(tmp_path: Path, kind: str) -> None:
    """Records behind a soak that was left out would carry a temperature the unit never had."""
    rig = HoldRig(tmp_path, 0)
    rig.instruments["chamber"] = Passive("chamber", rig)
    if kind == "soak":
        rig.step("soak", "chamber", "soak", **SOAK)
    else:
        rig.step("settle", duration_s=600.0, bus_s=0.0)
    rig.step("call", "supply", "output", current=2.0)
    first = len(rig.steps)
    rig.step("settle", duration_s=SETTLE_S, bus_s=0.0)
    rig.step("record", "port_a", seconds=RECORD_S, retry=1, max_lost=0.0, retry_step=first, conditions={"point": 0})
    rig.at(300.0, lambda: rig.stop.holds.wish(Wish("skip", "interlock", "slope")))
    outcome = rig.run_beside()
    assert outcome.error is None
    assert rig.events("skip") == []
    assert rig.called("supply.output")
    assert outcome.rows[0].window.t_start_ns >= 600e9


def test_a_hold_in_a_soak_does_not_go_back_to_the_temperature_before(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 0)
    rig.instruments["chamber"] = Passive("chamber", rig)
    rig.unit_degC = lambda t_s: 20.0 if t_s < 600.0 else min(40.0, 20.0 + (t_s - 600.0) / 20.0)
    rig.step("soak", "chamber", "soak", **SOAK)
    rig.step("soak", "chamber", "soak", **{**SOAK, "temperature": 40.0, "slot": 900.0})
    rig.at(700.0, lambda: rig.stop.holds.hold("test", "a door"))
    rig.at(750.0, lambda: rig.stop.holds.release("test"))
    outcome = rig.run_beside()
    assert outcome.error is None
    set_points = [words[0] for _, name, words in rig.calls if name == "chamber.set_temperature"]
    assert set_points == [20.0, 40.0, 40.0]
    assert rig.clock.now_ns() < 1700e9


def test_a_chamber_that_is_silent_on_the_way_back_is_waited_for(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 0)
    chamber = rig.instruments["chamber"] = Passive("chamber", rig)
    rig.unit_degC = lambda t_s: 15.0 if 620.0 < t_s < 900.0 else 20.0
    rig.step("soak", "chamber", "soak", **SOAK)
    first = len(rig.steps)
    rig.step("settle", duration_s=60.0, bus_s=0.0)
    rig.step("record", "port_a", seconds=RECORD_S, retry=1, max_lost=0.0, retry_step=first, conditions={"point": 0})

    def door() -> None:
        chamber.fail["set_temperature"] = instrument_error()
        rig.stop.holds.hold("test", "a door")

    rig.at(610.0, door)
    rig.at(680.0, lambda: rig.stop.holds.release("test"))
    rig.at(682.0, chamber.fail.clear)
    outcome = rig.run_beside()
    assert outcome.error is None
    assert [hold["by"] for hold in rig.events("hold")] == ["test", "instrument chamber"]
    assert [one["soaked"] for one in rig.events("reentry")] == [True]
    assert outcome.rows[0].window.t_start_ns > 1200e9


def test_the_end_of_a_run_needs_no_sign_of_life(tmp_path: Path) -> None:
    """The bench is safe by then: a message that takes its time must not make the guard end the controller."""
    rig = HoldRig(tmp_path, 1)
    rig.run_beside()
    rig.clock.sleep(100.0)
    assert rig.ran.health.silence_s() == {}


def test_a_record_that_was_taken_back_does_not_count_when_the_run_ends_before_the_next(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 1)
    rig.source.answers["operating"] = [False]

    def trip(step: Step) -> None:
        if step.number == 0 and rig.listener.steps.count(0) == 2:
            rig.source.fail["operate"] = instrument_error("B-INST-013")

    rig.listener.on_step = trip
    outcome = rig.run_beside()
    assert outcome.error.code == "B-INST-013"
    assert [event["record"] for event in rig.events("retake")] == [1]
    assert outcome.rows == []


def silent_rig(folder: Path, code: str = "B-INST-001", back_s: float = 47.0) -> Rig:
    """A logger that answers nothing from the beginning until ``back_s``."""
    rig = Rig(folder, "logger", "calibrator")
    logger: Any = rig.instruments["logger"]
    logger.fail["operating"] = instrument_error(code)

    def identify() -> Identity:
        if rig.clock.now_ns() < back_s * 1e9:
            raise instrument_error(code)
        logger.fail.clear()
        return Identity("maker", "logger", "1", "1")

    logger.identify = identify
    rig.step("settle", duration_s=3.0)
    rig.step("call", "logger", "operating")
    rig.step("settle", duration_s=5.0)
    return rig


@pytest.mark.parametrize("code", ["B-INST-001", "B-INST-003", "B-INST-004"])
def test_the_step_is_done_when_the_instrument_is_back(tmp_path: Path, code: str) -> None:
    rig = silent_rig(tmp_path, code)
    outcome = rig.run()
    assert outcome.error is None
    assert rig.listener.steps == [0, 1, 1, 2]
    (hold,) = rig.events("hold")
    assert (hold["by"], hold["step"]) == ("instrument logger", 1)
    assert code in hold["reason"]
    (release,) = rig.events("release")
    assert 44.0 <= release["seconds"] <= 44.0 + ASK_S + 0.5
    assert outcome.slip_s == pytest.approx(release["seconds"], abs=1e-6)


def test_an_instrument_that_stays_away_ends_the_run(tmp_path: Path) -> None:
    outcome = silent_rig(tmp_path, back_s=1e9).run()
    assert outcome.error.code == "B-RUN-070"
    assert f"{AWAY_LIMIT_S:g} s" in outcome.error.message
    assert "B-INST-001" in outcome.error.message


def test_one_that_answers_its_name_and_never_the_step_is_not_waited_for_for_ever(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "logger")
    rig.instruments["logger"].fail["operating"] = instrument_error()
    rig.step("call", "logger", "operating")
    outcome = rig.run()
    assert outcome.error.code == "B-INST-001"
    assert len(rig.events("hold")) == MOST_HOLDS


def test_a_fault_is_not_a_silence(tmp_path: Path) -> None:
    rig = silent_rig(tmp_path, "B-INST-013")
    outcome = rig.run()
    assert outcome.error.code == "B-INST-013"
    assert rig.events("hold") == []


class Drive(Instrument):
    """An instrument that drives the stimulus."""

    @action(effect=Effect.STIMULUS_ON)
    def operate(self) -> None:
        self._call("operate")


def stimulus_rig(folder: Path, safe_s: float) -> Rig:
    """A run that is paused for a moment while the calibrator cannot be told to be safe before ``safe_s``."""
    rig = Rig(folder, "calibrator")
    rig.safe_order = ("calibrator",)
    calibrator = rig.instruments["calibrator"] = Drive("calibrator", rig)
    calibrator.fail["make_safe"] = instrument_error("B-INST-009")

    def watch() -> None:
        if rig.clock.now_ns() >= safe_s * 1e9:
            calibrator.fail.clear()

    rig.clock.every(1.0, watch)
    rig.step("settle", duration_s=2.0)
    rig.step("settle", duration_s=2.0)
    rig.clock.every(1.5, lambda: rig.stop.holds.hold("test", "a moment") if rig.clock.now_ns() < 2e9 else None)
    rig.clock.every(4.0, lambda: rig.stop.holds.release("test") and None)
    return rig


def test_nobody_is_asked_any_more_once_the_bench_is_made_safe(tmp_path: Path) -> None:
    """On a shared bus a question that climbs its ladder would keep the safe commands waiting."""
    rig = silent_rig(tmp_path, back_s=1e9)
    logger: Any = rig.instruments["logger"]
    asked: list[int] = []
    identify = logger.identify
    logger.identify = lambda: (asked.append(rig.clock.now_ns()), identify())
    rig.clock.every(30.0, lambda: rig.stop.request("SIGTERM"))
    assert rig.run().error.code == "B-RUN-010"
    before = len(asked)
    assert before >= 3
    rig.clock.sleep(100.0)
    assert len(asked) == before


def test_it_is_asked_on_the_thread_of_the_steps(tmp_path: Path) -> None:
    """A thread of its own would hold the bus for a whole ladder while a stimulus has to be made safe."""
    rig = silent_rig(tmp_path)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("nobody else may ask")

    rig.listener.on_step = lambda step: setattr(rig.clock, "every", refuse)
    assert rig.run().error is None
    assert rig.listener.steps == [0, 1, 1, 2]


class Supply(Instrument):
    """Powers the unit."""

    @action(effect=Effect.POWER)
    def output_on(self) -> None:
        self._call("output_on")

    def look(self) -> None:
        self._call("look")


CASES = [("B-INST-003", "", "B-RUN-054"), ("", "", None), ("B-INST-003", "B-INST-003", None)]


@pytest.mark.parametrize(("relays", "supply", "code"), CASES)
def test_supplies_go_off_where_neither_source_nor_relays_do(
    tmp_path: Path, relays: str, supply: str, code: str | None
) -> None:
    """Relays that are confirmed open break the path; a supply that is mute is told nothing: it might come late."""
    rig = stimulus_rig(tmp_path, 30.0)
    rig.instruments["switch"] = Drive("switch", rig)
    rig.instruments["supply"] = Supply("supply", rig)
    rig.safe_order = ("calibrator", "switch", "supply")
    if relays:
        rig.instruments["switch"].fail["make_safe"] = instrument_error(relays)
        rig.clock.every(30.0, rig.instruments["switch"].fail.clear)
    if supply:
        rig.instruments["supply"].fail["look"] = instrument_error(supply)
    outcome = rig.run()
    assert (outcome.error.code if outcome.error else None) == code
    off_s = [t_s for t_s, name, _ in rig.calls if name == "supply.make_safe"]
    (hold,) = rig.events("hold")
    assert hold["by"] == "test"
    assert (off_s[0] < 5.0) == (code is not None)
