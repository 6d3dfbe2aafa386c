"""Single steps and the timeline: readings, prompts, commands, waits, slip; and soaks that the lag of the unit ends."""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plan_sample import planned
from run_rig import PortB, Rig, instrument_error
from scipy.signal import lfilter

from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.errors import BenchError, InstrumentError
from bench.model.events import Event, ThermalLag
from bench.model.quantities import Quality
from bench.plan import PlannedSoak
from bench.run.context import Decided, InUse, Timeline
from bench.run.operator import Answer, Question, SimulatedOperator, judge
from bench.run.steps.soak import Approach, Rest
from bench.run.stop import StopSwitch
from sim_instruments.worlds.common.thermal import UNIT_LAG_S, Thermal

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


def test_reach_never_goes_back_and_a_wait_that_is_late_is_noted() -> None:
    clock = VirtualClock()
    clock.sleep(5.0)
    line = Timeline(clock, StopSwitch(), clock.now_ns())
    line.clock.sleep(3.0)
    line.reach(1.0)
    assert line.clock.now_ns() == 8 * NS
    assert line.lateness_ns == []
    line.reach(4.0)
    line.wait_until(2.0)
    assert line.clock.now_ns() == 9 * NS
    assert line.lateness_ns == [0, 2 * NS]


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


TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
SLOT_s, LOOK_s, RAMP_degC_min = 9000.0, 60.0, 0.5
SAMPLE_degC = 0.005  # four sensors of 0.01 degC, ten times a second, in steps of 0.01 degC
WANDER_s = 300.0


@dataclass(frozen=True)
class Part:
    share: float
    lag: float  # in lags of the usual unit


ONE = (Part(1.0, 1.0),)


class Bench:
    """Chamber and unit without records; the unit is a sum of parts, the air may wander."""

    def __init__(self, seed: int, parts: Sequence[Part] = ONE, wander_degC: float = 0.0) -> None:
        self.clock, self.parts = VirtualClock(), parts
        self.thermals = [Thermal(unit_lag=part.lag) for part in parts]
        self._rng = np.random.default_rng(seed)
        self._wander = self._of_air(wander_degC)
        self.events: list[Event] = []
        self.decided = Decided(())
        self.in_use, self.instruments = InUse(), {"chamber": self}
        self.acquisition = SimpleNamespace(readers={}, lock=nullcontext())
        self.silent_s: tuple[float, float] = (math.inf, math.inf)

    def _of_air(self, rms_degC: float) -> Any:
        """What a wander of the air, each 10 s, does to the unit; its display has steps of 0.1 degC."""
        alike, lag = math.exp(-10.0 / WANDER_s), math.exp(-10.0 / UNIT_LAG_S)
        air = lfilter([rms_degC * math.sqrt(1.0 - alike**2)], [1.0, -alike], self._rng.normal(size=6000))
        return lfilter([1.0 - lag], [1.0, -lag], air)

    def event(self, event: Event) -> None:
        self.events.append(event)
        self.decided.take(event)

    def measure_air(self) -> float:
        first, last = self.silent_s
        if first <= self.clock.now_ns() / NS < last:
            raise InstrumentError("B-INST-001", "no answer", where="chamber")
        return round(float(self.thermals[0].air_degC(self.clock.now_ns())), 1)

    def unit_degC(self, t_ns: Any) -> Any:
        parts = zip(self.parts, self.thermals, strict=True)
        return sum(part.share * thermal.unit_degC(t_ns) for part, thermal in parts)

    def said(self, until_s: float) -> tuple[Any, Any]:
        """Samples since the look before."""
        t_ns = np.round(np.arange(until_s - LOOK_s + 0.1, until_s + 0.05, 0.1) * NS).astype(np.int64)
        noise = self._rng.normal(0.0, SAMPLE_degC, t_ns.size) + self._wander[int(until_s / 10.0) % 6000]
        return t_ns, np.round(self.unit_degC(t_ns) + noise, 2)

    def soak(self, target_degC: float, residual_degC: float) -> float:
        """Soak as the step does; return how far from the air the unit is then, or will be."""
        start_s = self.clock.now_ns() / NS
        step = soak_step(target_degC, residual_degC, start_s)
        approach = Approach(self, step, [None])  # type: ignore[arg-type]
        for thermal in self.thermals:
            thermal.ramp(target_degC, RAMP_degC_min, self.clock.now_ns())
        moment_s, is_over = start_s, False
        while not is_over and moment_s < start_s + SLOT_s:
            moment_s += LOOK_s
            self.clock.sleep_until_ns(to_ns(moment_s))
            approach.means[None].add(*self.said(moment_s))
            is_over = approach.look(moment_s)
        approach.note(start_s + SLOT_s - moment_s)
        later_ns = self.clock.now_ns() + np.arange(0, 36_000, 300) * NS
        return float(np.abs(self.unit_degC(later_ns) - target_degC).max())

    def campaign(self, residual_degC: float) -> list[tuple[ThermalLag, float]]:
        """Return, of each soak, what it noted and the truth."""
        found = []
        for target_degC in TEMPERATURES_degC:
            truth_degC = self.soak(target_degC, residual_degC)
            noted = self.events[-1]
            assert isinstance(noted, ThermalLag)
            found.append((noted, truth_degC))
        return found


def soak_step(target_degC: float, residual_degC: float, at_s: float = 0.0) -> PlannedSoak:
    step = planned(
        "soak", role="chamber", name="soak", at_s=at_s, duration_s=SLOT_s, temperature=target_degC,
        ramp=RAMP_degC_min, slot=SLOT_s, residual=residual_degC, least=2400.0,
    )  # fmt: skip
    assert isinstance(step, PlannedSoak)
    return step


@pytest.mark.parametrize("seeds", [2, pytest.param(20, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("residual_degC", [0.2, 0.5])
def test_the_lag_of_the_first_soak_ends_the_others_as_near_as_is_stated(residual_degC: float, seeds: int) -> None:
    """The first takes its slot, the least time holds, and what is stated holds by the truth."""
    saved_h, worst_degC = [], 0.0
    for seed in range(seeds):
        (first, _), *others = Bench(seed).campaign(residual_degC)
        assert first.saved_s == 0.0
        assert first.lag_s == pytest.approx(UNIT_LAG_S, rel=5e-3)
        for noted, truth_degC in others:
            assert 0.0 < noted.saved_s <= SLOT_s - 2400.0
            worst_degC = max(worst_degC, truth_degC)
            assert truth_degC <= residual_degC
            assert truth_degC <= noted.bound_degC <= residual_degC
        saved_h.append(sum(noted.saved_s for noted, _ in others) / 3600.0)
    print(
        f"{seeds} seeds, {residual_degC} degC stated: {min(saved_h):.2f} to {max(saved_h):.2f} h of 10 h saved, "
        f"worst truth {worst_degC:.3f} degC"
    )


WRONG = {
    "5 % of it 80 min": ((Part(0.95, 0.8), Part(0.05, 3.2)), 0.0),
    "5 % of it 80 min, air wanders": ((Part(0.95, 0.8), Part(0.05, 3.2)), 0.02),
    "3 % of it 120 min, air wanders": ((Part(0.97, 0.8), Part(0.03, 4.8)), 0.03),
    "10 % of it 60 min, air wanders": ((Part(0.9, 1.0), Part(0.1, 2.4)), 0.05),
    "20 % of it 7 min": ((Part(0.8, 1.0), Part(0.2, 0.27)), 0.0),
    "one lag, air wanders": (ONE, 0.03),
}


@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_world_ends_no_soak_too_early(name: str, seeds: int) -> None:
    """A second mass that is slower than the sensor's: its soaks are as near as stated, or take their slots."""
    parts, wander_degC = WRONG[name]
    early, worst_degC = 0, 0.0
    for seed in range(seeds):
        for noted, truth_degC in Bench(seed, parts, wander_degC).campaign(0.3):
            if noted.saved_s:
                early, worst_degC = early + 1, max(worst_degC, truth_degC)
    print(f"{name}: {early} of {4 * seeds} soaks ended early, 0.3 degC stated, worst truth {worst_degC:.3f} degC")
    assert worst_degC <= 0.3


def test_a_silent_chamber_ends_no_soak() -> None:
    bench = Bench(1)
    bench.soak(-10.0, 0.5)
    bench.silent_s = (SLOT_s + 3600.0, 2.0 * SLOT_s + 1.0)
    count = len(bench.events)
    bench.soak(5.0, 0.5)
    assert bench.clock.now_ns() == to_ns(2.0 * SLOT_s)
    assert {event.kind for event in bench.events[count:]} == {"error"}  # no look was at air that stands still


def test_air_is_at_rest_when_its_readings_lie_together() -> None:
    rest = Rest()
    assert [rest.look(degC) for degC in (40.0, 45.0, 49.0, 49.8)] == [0, 0, 0, 0]
    assert [rest.look(50.0) for _ in range(12)] == [0] * 6 + [0, 0, 0, 1, 2, 3]
    assert rest.look(50.4) == 0
    assert [rest.look(50.0) for _ in range(10)][-2:] == [0, 0]
    assert rest.look(math.nan) == 0


def test_moments_that_have_passed_behind_a_hold_are_no_looks() -> None:
    """A soak that goes on behind a hold comes to its first moments at once, with nothing said in between."""
    bench = Bench(1)
    bench.clock.sleep_until_ns(to_ns(3000.0))
    approach = Approach(bench, soak_step(23.0, 0.5), [None])  # type: ignore[arg-type]
    for moment_s in np.arange(60.0, 3060.0, 60.0):
        assert not approach.look(moment_s)
    approach.note(0.0)
    assert bench.events == []
