"""The sequencer and its observers: order, journal, retakes, and that every way out leaves the bench safe."""

import os
import signal
from pathlib import Path

import pytest
from run_rig import Listener, Rig, Sink, instrument_error

from bench.model.clock import VirtualClock
from bench.model.errors import ExitStatus, OperatorStop
from bench.model.events import Config, Disk, Event, Phase
from bench.record import RecordError, read_journal
from bench.run.observers import AtTerminal, Observer, Observers, Order, Recorder
from bench.run.stop import StopSwitch


def three_steps(folder: Path) -> Rig:
    rig = Rig(folder, "calibrator", "switch", "supply")
    for current in (1.0, 2.0, 3.0):
        rig.step("call", "calibrator", "output", current=current, conditions={"current_A": current})
    return rig


def point(rig: Rig, retry: int = 1, records: int = 1) -> None:
    """One measuring point: output, settle, record(s), verify; all of it is done again when the verify fails."""
    first = len(rig.steps)
    rig.step("call", "calibrator", "output", current=1.0)
    rig.step("settle", duration_s=5.0, bus_s=0.5)
    for _ in range(records):
        rig.step("record", "port_a", seconds=1.0, retry=retry, max_lost=0.0, retry_step=first)
    rig.step("verify", "calibrator", "operating")


def safe_calls(rig: Rig) -> list[str]:
    return [name.removesuffix(".make_safe") for _, name, _ in rig.calls if name.endswith("make_safe")]


def test_steps_are_done_in_order_and_journalled_with_their_conditions(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    rig.step("settle", duration_s=2.0, bus_s=0.5)
    rig.step("call", "switch", "operating", phase="finally")
    outcome = rig.run()
    assert outcome.error is None
    assert rig.listener.steps == [0, 1, 2, 3, 4]
    entries = read_journal(tmp_path).entries
    assert [entry.number for entry in entries] == [0, 1, 2, 3, 4]
    assert [dict(entry.conditions) for entry in entries[:3]] == [
        {"current_A": 1.0},
        {"current_A": 2.0},
        {"current_A": 3.0},
    ]
    assert [entry.phase for entry in entries] == ["campaign"] * 4 + ["finally"]
    assert [event["name"] for event in rig.events("phase")] == ["campaign", "finally"]
    names = [name for _, name, _ in rig.calls]
    assert names.index("switch.operating") < names.index("calibrator.make_safe")


def test_a_failed_verify_takes_the_point_again_and_replaces_the_record(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "calibrator")
    point(rig)
    point(rig)
    rig.instruments["calibrator"].answers["operating"] = [False, True, True]
    outcome = rig.run()
    assert outcome.error is None
    assert rig.listener.steps == [0, 1, 2, 3, 0, 1, 2, 3, 4, 5, 6, 7]
    assert [event["record"] for event in rig.events("retake")] == [1]
    assert [event["number"] for event in rig.events("record")] == [1, 1, 2]
    assert [row.window.number for row in outcome.rows] == [1, 2]
    (_, second_output, _) = rig.called("calibrator.output")
    assert outcome.rows[0].window.t_start_ns / 1e9 - second_output >= 4.5  # it has its full settle time
    assert outcome.retaken == 1
    assert any("taken again" in text for text in rig.listener.messages)


@pytest.mark.parametrize("retry", [0, 1, 2])
def test_attempts_are_limited_and_then_the_run_ends_safely(tmp_path: Path, retry: int) -> None:
    rig = Rig(tmp_path, "calibrator", "switch")
    point(rig, retry)
    rig.instruments["calibrator"].answers["operating"] = [False] * 9
    outcome = rig.run()
    assert outcome.error.code == "B-RUN-030"
    assert outcome.error.exit_status is ExitStatus.SAFE_AFTER_FAULT
    assert len(rig.called("calibrator.operating")) == 1 + retry
    assert safe_calls(rig) == ["calibrator", "switch"]


@pytest.mark.parametrize("records", [2, 3])
def test_a_point_with_several_records_replaces_them_all_and_ends(tmp_path: Path, records: int) -> None:
    rig = Rig(tmp_path, "calibrator")
    point(rig, retry=2, records=records)
    rig.instruments["calibrator"].answers["operating"] = [False, False, True]
    outcome = rig.run()
    assert outcome.error is None
    numbers = list(range(1, records + 1))
    assert [event["number"] for event in rig.events("record")] == 3 * numbers
    assert sorted(event["record"] for event in rig.events("retake")) == sorted(2 * numbers)
    assert [row.window.number for row in outcome.rows] == numbers
    rig = Rig(tmp_path / "again", "calibrator")
    (tmp_path / "again").mkdir()
    point(rig, retry=1, records=records)
    rig.instruments["calibrator"].answers["operating"] = [False] * 9
    assert rig.run().error.code == "B-RUN-030"  # type: ignore[union-attr]
    assert len(rig.called("calibrator.operating")) == 2


def test_an_error_in_a_step_makes_everything_safe_in_order_even_if_one_fails(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    rig.instruments["calibrator"].fail = {
        "output": instrument_error("B-INST-005"),
        "make_safe": instrument_error("B-INST-009"),
    }
    outcome = rig.run(safe_order=("switch", "calibrator"))
    assert outcome.error.code == "B-INST-005"
    assert rig.listener.steps == [0]
    assert safe_calls(rig) == ["switch", "calibrator", "supply", "calibrator", "calibrator"]
    (failure,) = outcome.unsafe
    assert (failure.code, failure.where) == ("B-RUN-060", "calibrator")
    assert "B-INST-009" in str(failure)
    assert rig.events("safe") == [{"failures": [str(failure)], "roles": ["calibrator"]}]
    assert rig.events("end")[0]["error"] == "B-INST-005"


@pytest.mark.parametrize("surprise", [ZeroDivisionError("x"), KeyError("role"), AttributeError("y"), MemoryError()])
def test_an_error_nobody_foresaw_ends_safely_too(tmp_path: Path, surprise: Exception) -> None:
    rig = three_steps(tmp_path)
    rig.instruments["calibrator"].fail["output"] = surprise
    rig.instruments["switch"].fail["make_safe"] = surprise
    outcome = rig.run()
    assert outcome.error.code == "B-INT-001"
    assert outcome.error.exit_status is ExitStatus.INTERNAL
    assert type(surprise).__name__ in str(outcome.error)
    assert "run_rig" in outcome.error.where
    assert safe_calls(rig) == ["calibrator", "switch", "supply", "switch", "switch"]
    assert [failure.code for failure in outcome.unsafe] == ["B-RUN-060"]


def test_an_instrument_that_is_silent_for_a_while_is_made_safe_at_the_second_attempt(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    plain = rig.instruments["calibrator"].make_safe
    rig.instruments["calibrator"].fail["make_safe"] = instrument_error()

    def back_again() -> None:
        rig.instruments["calibrator"].fail.clear()
        plain()

    rig.instruments["supply"].make_safe = back_again  # type: ignore[method-assign]
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.unsafe == ()


def test_an_exit_out_of_a_step_still_makes_the_bench_safe(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    rig.operator.act = lambda: (_ for _ in ()).throw(SystemExit(1))
    rig.step("prompt", text="ready?")
    assert rig.run().error.code == "B-INT-001"
    assert safe_calls(rig) == ["calibrator", "switch", "supply"]


def test_a_stop_request_ends_before_the_next_step(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    rig.listener.on_step = lambda step: os.kill(os.getpid(), signal.SIGINT) if step.number == 1 else None
    with rig.stop:
        error = rig.run().error
    assert (error.code, error.exit_status) == ("B-RUN-010", ExitStatus.SAFE_BY_OPERATOR)
    assert "SIGINT" in error.message
    assert rig.listener.steps[-1] == 1
    assert safe_calls(rig) == ["calibrator", "switch", "supply"]


def test_a_second_signal_ends_inside_a_step(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)

    def twice() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
        raise AssertionError("not reached")

    rig.listener.on_step = lambda step: twice()
    with rig.stop:
        outcome = rig.run()
    assert outcome.error.code == "B-RUN-011"
    assert safe_calls(rig) == ["calibrator", "switch", "supply"]


def test_signals_on_the_way_to_the_safe_state_interrupt_nothing(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    plain = rig.instruments["calibrator"].make_safe

    def impatient() -> None:
        for _ in range(3):
            os.kill(os.getpid(), signal.SIGINT)
        plain()

    rig.instruments["calibrator"].make_safe = impatient  # type: ignore[method-assign]
    with rig.stop:
        outcome = rig.run()
    assert outcome.error is None
    assert outcome.unsafe == ()
    assert safe_calls(rig) == ["calibrator", "switch", "supply"]


def test_a_hang_up_of_the_terminal_stops_nothing() -> None:
    before = signal.getsignal(signal.SIGHUP)
    with StopSwitch() as stop:
        os.kill(os.getpid(), signal.SIGHUP)
        stop.check()
    assert signal.getsignal(signal.SIGHUP) == before


def test_a_signal_at_a_prompt_is_honoured_at_once(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    rig.step("prompt", text="ready?")
    rig.operator.act = lambda: os.kill(os.getpid(), signal.SIGINT)
    with rig.stop:
        outcome = rig.run()
    assert outcome.error.code == "B-RUN-010"
    assert rig.events("prompt") == []


def test_a_fault_beside_the_steps_ends_the_run(tmp_path: Path) -> None:
    rig = three_steps(tmp_path)
    rig.step("settle", duration_s=60.0, bus_s=0.5)
    rig.listener.on_step = lambda step: setattr(rig.port_a, "broken", OSError("device disconnected"))
    outcome = rig.run()
    assert outcome.error.code == "B-RUN-024"
    assert outcome.error.exit_status is ExitStatus.SAFE_AFTER_FAULT
    assert safe_calls(rig) == ["calibrator", "switch", "supply"]


def test_a_disk_that_refuses_journal_lines_does_not_end_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise RecordError("B-REC-005", "no space", where="journal")

    monkeypatch.setattr("bench.record.Journal.step", refuse)
    rig = three_steps(tmp_path)
    assert rig.run().error is None
    assert len([text for text in rig.listener.messages if "B-REC-005" in text]) == 1


PHASE = Phase(name="campaign", t_start_ns=0)
CONFIG = Config(file="a.yaml", change="changed")


class Noting(Observer):
    def __init__(self, told: list[str], name: str, order: Order, error: Exception | None = None) -> None:
        self.told, self.name, self.error = told, name, error
        self.order = order  # type: ignore[misc]

    def event(self, event: Event, t_mono_ns: int) -> None:
        self.told.append(self.name)
        if self.error is not None:
            raise self.error


def test_the_recorder_is_first_wherever_it_comes_in() -> None:
    told: list[str] = []
    observers = Observers(VirtualClock())
    for name, order in (("page", Order.WATCHERS), ("keeper", Order.SAFETY), ("writer", Order.RECORDER)):
        observers.add(Noting(told, name, order))
    observers.event(PHASE)
    assert told == ["writer", "keeper", "page"]


def test_one_that_fails_is_said_once_and_stops_nobody() -> None:
    told: list[str] = []
    broken, listener = Noting(told, "broken", Order.WATCHERS, ValueError("x")), Listener()
    broken.loss = "nobody draws any more"  # type: ignore[misc]
    observers = Observers(VirtualClock(), broken, Noting(told, "next", Order.WATCHERS), AtTerminal(listener))
    observers.event(PHASE)
    observers.event(PHASE)
    assert told == ["broken", "next", "next"]
    assert listener.messages == ["nobody draws any more (ValueError: x); the run goes on"]


def test_what_the_run_cannot_do_without_ends_it_and_a_second_signal_is_not_lost() -> None:
    vital = Noting([], "keeper", Order.SAFETY, ValueError("x"))
    vital.vital = True  # type: ignore[misc]
    with pytest.raises(ValueError, match="x"):
        Observers(VirtualClock(), vital).event(PHASE)
    stop = Noting([], "page", Order.WATCHERS, OperatorStop("B-RUN-011", "stopped"))
    with pytest.raises(OperatorStop):
        Observers(VirtualClock(), stop).event(PHASE)


def test_nobody_acts_on_what_is_not_written_and_a_person_still_hears_of_it() -> None:
    class Full(Sink):
        def event(self, *_: object) -> None:
            raise RecordError("B-REC-003", "full")

    told: list[str] = []
    listener = Listener()
    observers = Observers(VirtualClock(), Recorder(Full()), Noting(told, "page", Order.WATCHERS), AtTerminal(listener))
    with pytest.raises(RecordError):
        observers.event(CONFIG)
    observers.note(CONFIG)
    assert (told, listener.messages) == ([], [CONFIG.sentence])


def test_a_full_disk_is_told_and_not_written() -> None:
    sink, listener = Sink(), Listener()
    Observers(VirtualClock(), Recorder(sink), AtTerminal(listener)).event(Disk(code="B-REC-001", text="full"))
    assert (sink.events, listener.messages) == ([], ["full"])
