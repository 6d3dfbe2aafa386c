"""An instrument that falls silent: the run stands still until it answers, and does its step again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from run_rig import Instrument, Rig, instrument_error

from bench.model.ports import Effect, Identity, action
from bench.run.hold.standing import ASK_S, MOST_HOLDS
from bench.run.stop import AWAY_LIMIT_S


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


class Source(Instrument):
    """An instrument that drives the stimulus."""

    @action(effect=Effect.STIMULUS_ON)
    def operate(self) -> None:
        self._call("operate")


def stimulus_rig(folder: Path, safe_s: float) -> Rig:
    """A run that is paused for a moment while the calibrator cannot be told to be safe before ``safe_s``."""
    rig = Rig(folder, "calibrator")
    rig.safe_order = ("calibrator",)
    calibrator = rig.instruments["calibrator"] = Source("calibrator", rig)
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


def test_nothing_goes_on_before_the_stimulus_is_off(tmp_path: Path) -> None:
    rig = stimulus_rig(tmp_path, 60.0)
    outcome = rig.run()
    assert outcome.error is None
    (release,) = rig.events("release")
    assert release["seconds"] >= 58.0
    alarms = rig.events("alarm")
    assert len(alarms) >= 5
    assert {alarm["role"] for alarm in alarms} == {"calibrator"}


def test_a_stimulus_that_cannot_be_switched_off_ends_the_run(tmp_path: Path) -> None:
    outcome = stimulus_rig(tmp_path, 1e9).run()
    assert outcome.error.code == "B-RUN-070"
    assert f"{AWAY_LIMIT_S:g} s" in outcome.error.message
    assert [error.where for error in outcome.unsafe] == ["calibrator"]


def test_nobody_is_asked_any_more_once_the_bench_is_made_safe(tmp_path: Path) -> None:
    """On a shared bus a question that climbs its ladder would keep the safe commands waiting."""
    rig = silent_rig(tmp_path, back_s=1e9)
    logger: Any = rig.instruments["logger"]
    asked: list[int] = []
    identify = logger.identify
    logger.identify = lambda: (asked.append(rig.clock.now_ns()), identify())
    rig.clock.every(30.0, lambda: rig.stop.request("SIGTERM"))
    outcome = rig.run()
    assert outcome.error.code == "B-RUN-010"
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
    rig.instruments["switch"] = Source("switch", rig)
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
