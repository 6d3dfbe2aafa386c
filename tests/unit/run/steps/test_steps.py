"""Single steps and the timeline: readings, prompts, commands to the unit; waits, slip, and settle times in full."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from run_rig import PortB, Rig, instrument_error

from bench.model.clock import NS, VirtualClock
from bench.model.errors import BenchError
from bench.model.quality import Quality
from bench.run.control.operator import Answer, Question, SimulatedOperator, judge
from bench.run.steps.timing import Timeline
from bench.run.stop import StopSwitch

OHM = {"text": "resistance?", "unit": "ohm", "low": 1.0, "high": 2.0}


def test_a_reading_becomes_an_event(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "logger")
    rig.instruments["logger"].answers["measure"] = [21.5]
    rig.step("call", "logger", "measure")
    assert rig.run().error is None
    expected = {"step": 0, "role": "logger", "name": "measure", "value": 21.5, "conditions": {}}
    assert rig.events("reading") == [expected]


@pytest.mark.parametrize(
    ("code", "flag"),
    [
        ("B-INST-007", Quality.OVERLOAD),
        ("B-INST-001", Quality.NOT_FINITE),
        ("B-INST-004", Quality.NOT_FINITE),
    ],
)
def test_a_pure_measurement_without_a_reading_is_flagged_and_the_run_goes_on(
    tmp_path: Path, code: str, flag: Quality
) -> None:
    rig = Rig(tmp_path, "logger")
    rig.instruments["logger"].fail["measure"] = instrument_error(code)
    rig.step("call", "logger", "measure")
    rig.step("call", "logger", "operating")
    assert rig.run().error is None
    flagged = rig.events("reading")[0]
    assert (flagged["value"], flagged["quality"], flagged["code"]) == (None, flag, code)
    assert rig.listener.steps == [0, 1]
    assert any("flagged" in text for text in rig.listener.messages)


@pytest.mark.parametrize(
    ("kind", "name", "code"),
    [
        ("call", "output", "B-INST-007"),  # does something to the bench
        ("verify", "measure", "B-INST-007"),  # its answer is needed
        ("call", "operating", "B-INST-007"),  # declares no reading
        ("call", "measure", "B-INST-005"),
    ],
)
def test_every_other_instrument_error_ends_the_run(tmp_path: Path, kind: str, name: str, code: str) -> None:
    rig = Rig(tmp_path, "logger")
    rig.instruments["logger"].fail[name] = instrument_error(code)
    rig.step(kind, "logger", name, **({"current": 1.0} if name == "output" else {}))
    rig.step("call", "logger", "operating")
    assert rig.run().error.code == code
    assert rig.listener.steps == [0]


def test_raw_text_is_sent(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "logger")
    rig.step("send", "logger", text="FUNC SQU")
    assert rig.run().error is None
    assert ("logger.raw", ("FUNC SQU",)) in [(name, arguments) for _, name, arguments in rig.calls]


@pytest.mark.parametrize(
    ("value", "code"),
    [(1.0, ""), (1.5, ""), (2.0, ""), (None, "B-RUN-040"), (0.99, "B-RUN-041"), (2.01, "B-RUN-041")],
)
def test_an_answer_is_recorded_and_one_outside_the_limits_ends_the_run(
    tmp_path: Path, value: float | None, code: str
) -> None:
    rig = Rig(tmp_path)
    rig.operator.value = value
    rig.step("prompt", **OHM)
    error = rig.run().error
    assert (error.code if error else "") == code
    (event,) = rig.events("prompt")
    assert (event["by"], event["value"], event["unit"]) == ("somebody", value, "ohm")


def test_a_nan_is_not_inside_any_limits() -> None:
    with pytest.raises(BenchError, match="B-RUN-041"):
        judge(Question("x", unit="V", low=0.0, high=1.0), Answer("somebody", float("nan")), "")


@pytest.mark.parametrize(("low", "high"), [(1.0, 3.0), (None, 3.0), (1.0, None)])
def test_the_simulated_operator_answers_inside_the_limits(low: float | None, high: float | None) -> None:
    question = Question("x", unit="V", low=low, high=high)
    judge(question, SimulatedOperator().ask(question), "")


def test_what_a_person_did_is_done_to_a_simulated_bench_behind_the_answer(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    done: list[tuple[str, object]] = []
    rig.operator.act = lambda: done.append(("asked", 0))
    rig.step("prompt", text="put unit SIM-2 on the board", sets={"unit": "SIM-2", "dip_switch": 0})
    rig.step("prompt", text="go on?")
    assert rig.run(operate=lambda name, value: done.append((name, value))).error is None
    assert done == [("asked", 0), ("unit", "SIM-2"), ("dip_switch", 0), ("asked", 0)]
    first, second = rig.events("prompt")
    assert first["sets"] == {"unit": "SIM-2", "dip_switch": 0}
    assert "sets" not in second


def test_a_refused_value_changes_nothing_on_the_bench(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.operator.value = 3.0
    rig.step("prompt", **OHM, sets={"unit": "SIM-2"})
    done: list[str] = []
    outcome = rig.run(operate=lambda name, value: done.append(name))
    assert outcome.error is not None
    assert done == []


def unit_step(folder: Path) -> Rig:
    rig = Rig(folder)
    rig.step("settle", duration_s=1.0, bus_s=0.0)
    rig.step("unit", "port_b", "start_stream", command=2, payload=(0x64,))
    return rig


def test_a_command_waits_for_its_answer(tmp_path: Path) -> None:
    rig = unit_step(tmp_path)
    rig.port_b.answer = {2: (0, 0.5)}
    assert rig.run().error is None
    sent = rig.port_b.definition.decoder("reference").feed(rig.port_b.written).messages["command"]
    assert [int(number) for number in sent.raw("command")] == [2]
    assert bytes(sent.raw("payload")[0]) == b"\x64"
    assert rig.events("answer")[0]["status"] == 0


@pytest.mark.parametrize(
    ("arrange", "code"),
    [
        (lambda port: None, "B-RUN-022"),
        (lambda port: port.answer.update({1: (0, 0.1)}), "B-RUN-022"),  # to another command
        (lambda port: port.say(2, 0, delay_s=0.9999), "B-RUN-022"),  # before the command; nobody has looked yet
        (lambda port: port.answer.update({2: (1, 0.1)}), "B-RUN-023"),
        (lambda port: port.answer.update({2: (255, 0.1)}), "B-RUN-023"),
        (lambda port: setattr(port, "accepts", 3), "B-RUN-020"),
    ],
)
def test_a_command_without_its_answer_ends_the_run(tmp_path: Path, arrange: Callable[[PortB], None], code: str) -> None:
    rig = unit_step(tmp_path)
    arrange(rig.port_b)
    error = rig.run().error
    assert error.code == code
    assert "start_stream" in error.message or code == "B-RUN-020"


def test_the_time_a_person_takes_to_answer_is_a_slip_and_no_overrun(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "logger")
    rig.operator.act = lambda: rig.clock.sleep(600.0)
    rig.step("prompt", text="ready?")
    rig.step("settle", duration_s=10.0, bus_s=1.0)
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.overruns == 0
    assert outcome.slip_s == pytest.approx(600.0)
    assert rig.events("slip") == [{"step": 0, "seconds": 600.0, "reason": "prompt"}]


def timeline() -> Timeline:
    clock = VirtualClock()
    clock.sleep(5.0)
    return Timeline(clock, StopSwitch(), clock.now_ns())


def test_waits_end_at_planned_times() -> None:
    line = timeline()
    for at_s in (0.5, 2.0, 2.0, 7.25):
        line.wait_until(at_s)
        assert line.clock.now_ns() == 5 * NS + round(at_s * NS)
    assert line.lateness_ns == [0, 0, 0, 0]


def test_a_late_wait_is_noted_and_takes_no_time() -> None:
    line = timeline()
    line.clock.sleep(3.0)
    line.wait_until(1.0)
    assert line.clock.now_ns() == 8 * NS
    assert line.lateness_ns == [2 * NS]


def test_reach_never_goes_back() -> None:
    line = timeline()
    line.clock.sleep(3.0)
    line.reach(1.0)
    assert line.clock.now_ns() == 8 * NS
    assert line.lateness_ns == []
    line.reach(4.0)
    assert line.clock.now_ns() == 9 * NS


def test_slip_moves_everything_after_it() -> None:
    line = timeline()
    line.add_slip(NS)
    line.add_slip(NS // 2)
    line.wait_until(1.0)
    assert line.clock.now_ns() == 7 * NS + NS // 2
    assert line.target_ns(10.0) == 16 * NS + NS // 2


@pytest.mark.parametrize("bus_takes_s", [0.5, 2.0, 2.5, 30.0])
def test_settle_is_never_shorter_than_planned_minus_its_bus_time(tmp_path: Path, bus_takes_s: float) -> None:
    """Planned: 20 s with 2 s of bus time in it. Whatever the bus takes, at least 18 s remain, and later steps shift."""
    rig = Rig(tmp_path, "calibrator")
    rig.instruments["calibrator"].slow_s["output"] = bus_takes_s
    rig.step("call", "calibrator", "output", current=1.0)
    rig.step("settle", duration_s=20.0, bus_s=2.0)
    rig.step("call", "calibrator", "operating")
    rig.step("settle", duration_s=10.0, bus_s=0.1)
    rig.step("call", "calibrator", "operating")
    outcome = rig.run()
    slip_s = max(0.0, bus_takes_s - 2.0)
    first, second = rig.called("calibrator.operating")
    assert first == pytest.approx(20.0 + slip_s, abs=1e-9)
    assert first - bus_takes_s >= 18.0 - 1e-9
    assert second == pytest.approx(first + 10.0, abs=1e-9)
    assert outcome.slip_s == pytest.approx(slip_s)
    assert outcome.overruns == (1 if slip_s else 0)
    assert [event["seconds"] for event in rig.events("overrun")] == pytest.approx([slip_s] if slip_s else [])


def test_lateness_of_the_whole_run_is_in_the_outcome(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "calibrator")
    rig.instruments["calibrator"].slow_s["output"] = 3.0
    rig.step("call", "calibrator", "output", current=1.0)
    rig.step("record", "port_a", seconds=1.0, retry=0, max_lost=0.0, retry_step=0)
    rig.step("settle", duration_s=1.0, bus_s=0.0)
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.lateness_ms == (0.0, 0.0, 0.0)  # shifted by slip, then on time
    assert outcome.slip_s == pytest.approx(3.01)  # the last frame is on the wire 0.6 ms after its gate; 10 ms per look
