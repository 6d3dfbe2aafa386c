"""When the guard acts: the edges of silence, limits and goodbyes; and what the controller tells it, and when."""

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from run_rig import Listener
from waiting import until

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InputError, RunError
from bench.model.lab import find_shipped
from bench.plan import Step, compile_sequence
from bench.plan.station import load_station
from bench.run.guard import start
from bench.run.guard.decision import Action, Address, Brief, Watched, decide
from bench.run.guard.guarding import guard_beside
from bench.run.guard.start import BEAT_S, GOODBYE_S, UNANSWERED_S, GuardProcess
from bench.run.guard.temperatures import LONGEST_S, WALL_S, patience_s
from bench.run.operator import SimulatedOperator
from bench.run.session import Conducted, conduct
from bench.run.stop import CHAMBER_AIR, LINKS, SEQUENCER, Health, StopSwitch
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World

LIMITS = {"chamber_air_degC": 65.0, "unit_degC": 70.0}


def watched(**changes: object) -> Watched:
    state = Watched(LIMITS, silence_s=2.0, heard_ns=100 * NS)
    for name, value in changes.items():
        setattr(state, name, value)
    return state


def test_silence_counts_from_its_limit_on() -> None:
    assert decide(watched(), 102 * NS - 1) is None
    found = decide(watched(), 102 * NS)
    assert (found.reason, found.heat_off) == ("silent", False)
    assert "2.00 s" in found.text


def test_a_limit_is_crossed_where_it_is_reached() -> None:
    below = watched(values={"chamber_air_degC": math.nextafter(65.0, 0.0), "unit_degC": 69.9})
    assert decide(below, 100 * NS) is None
    found = decide(watched(values={"chamber_air_degC": 65.0}), 100 * NS)
    assert found == Action("limit", "chamber_air_degC is 65, the hard limit is 65", heat_off=True)
    found = decide(watched(values={"chamber_air_degC": 60.0, "unit_degC": 71.25}), 100 * NS)
    assert found.text == "unit_degC is 71.25, the hard limit is 70"


@pytest.mark.parametrize("values", [{}, {"chamber_air_degC": math.nan}, {"lab_degC": 1000.0}])
def test_what_is_not_known_crosses_nothing(values: dict[str, float]) -> None:
    assert decide(watched(values=values), 100 * NS) is None


@pytest.mark.parametrize(("air_degC", "heat_off"), [(20.0, False), (66.0, True)])
def test_a_controller_that_is_gone_is_not_waited_for_and_a_hot_chamber_goes_off(
    air_degC: float, heat_off: bool
) -> None:
    found = decide(watched(gone=True, values={"chamber_air_degC": air_degC}), 100 * NS)
    assert (found.reason, found.heat_off) == ("limit" if heat_off else "gone", heat_off)


@given(
    gone=st.booleans(),
    now_s=st.floats(0.0, 1e6),
    values=st.dictionaries(st.sampled_from(sorted(LIMITS)), st.floats(allow_nan=True)),
)
def test_after_a_goodbye_nothing_is_done(gone: bool, now_s: float, values: dict[str, float]) -> None:
    assert decide(watched(goodbye={}, gone=gone, values=values), round(now_s * NS)) is None


def test_what_a_controller_left_behind_is_gone_on_with_whatever_else_is_wrong() -> None:
    found = decide(watched(goodbye={"calibrator": "unreachable"}, gone=True, values={"chamber_air_degC": 99.0}), NS)
    assert (found.reason, found.left, found.heat_off) == ("left", ("calibrator",), False)
    assert "calibrator unreachable" in found.text


@given(air=st.floats(allow_nan=False), unit=st.floats(allow_nan=False), silent_s=st.floats(0.0, 10.0))
def test_it_acts_exactly_when_something_is_wrong(air: float, unit: float, silent_s: float) -> None:
    found = decide(watched(values={"chamber_air_degC": air, "unit_degC": unit}), 100 * NS + round(silent_s * NS))
    hot = air >= 65.0 or unit >= 70.0
    assert (found is not None) == (hot or round(silent_s * NS) >= 2 * NS)
    if found is not None:
        assert found.heat_off == hot


LIMIT_DEGC = 65.0
HEAT_OFF_S = 2.0
SEQUENCE = """\
sequence: hot
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
timeline:
  - {at: 0 s, call: {chamber.set_temperature: {temperature: 55 degC, ramp: 1 degC/min}}}
  - {at: 10 s, call: chamber.run}
  - {at: 20 s, call: {switch.route: {channel: 3, polarity: +}}}
  - {at: 30 s, call: {calibrator.output: {current: 1 mA, range: lowest_that_holds}}}
  - {at: 40 s, call: calibrator.operate}
  - {at: 7200 s, call: calibrator.operating}
  - {at: 14400 s, call: calibrator.standby}
"""


class Bench(Listener):
    """A run of SEQUENCE whose world is watched each ``look_s`` of virtual time."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, look_s: float) -> None:
        super().__init__()
        self.folder, self.clock = folder, VirtualClock()
        self.world: World | None = None
        self.reached_s = self.stopped_s = self.off_s = 0.0
        plain = simulation.open_world

        def open_world(*words: Any, **options: Any) -> World:
            self.world = plain(*words, **options)
            self.clock.every(look_s, self.look)
            return self.world

        monkeypatch.setattr(simulation, "open_world", open_world)

    def look(self) -> None:
        """Note when the chamber's own sensor shows the limit, and when heat and stimulus are off after that."""
        chamber, now_s = self.world.instruments["chamber"], self.clock.now_ns() / NS
        if not self.reached_s and round(chamber._air_degC(), 1) >= LIMIT_DEGC:
            self.reached_s = now_s
        if self.reached_s and not self.stopped_s and not chamber.mode & 16:
            self.stopped_s = now_s
        if self.reached_s and not self.off_s and not self.world.instruments["calibrator"].operating:
            self.off_s = now_s

    def step(self, step: Step, at_s: float) -> None:
        if step.number == self.fault_at:
            self.world.switches.switch("chamber_runaway", "", 2.0)

    def run(self, fault_at: int = -1) -> Conducted:
        self.fault_at = fault_at
        path = self.folder / "hot.yaml"
        path.write_text(SEQUENCE)
        plan = compile_sequence(path, None, {})
        return conduct(
            plan, clock=self.clock, seed=3, out=self.folder / "out", operator=SimulatedOperator(), listener=self,
            keep_events=("guard",), beside=[guard_beside(plan.station)],
        )  # fmt: skip


def test_a_chamber_that_runs_away_loses_its_heat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, monkeypatch, look_s=0.05)
    run = bench.run(fault_at=4)
    error = run.outcome.error
    assert error.code == "B-RUN-094"
    assert "chamber_air_degC is 65" in error.message
    heat_off_s, stimulus_off_s = bench.stopped_s - bench.reached_s, bench.off_s - bench.reached_s
    print(f"heat off {heat_off_s:.2f} s after, stimulus {stimulus_off_s:.2f} s after")
    assert 0.0 <= heat_off_s <= HEAT_OFF_S
    assert 0.0 <= stimulus_off_s <= 5.0
    assert run.outcome.unsafe == ()
    assert [fields["state"] for _, _, fields in run.events] == ["acted"]


def test_a_hot_campaign_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, monkeypatch, look_s=1.0)
    run = bench.run()
    assert run.outcome.error is None
    assert run.events == []
    assert bench.reached_s == 0.0


def test_patience_ends_before_the_limit_can_be_reached() -> None:
    limits = {"chamber_air_degC": 65.0, "unit_degC": 70.0}
    assert patience_s({"chamber_air_degC": 60.0}, limits) == pytest.approx(60.0)  # 5 degC at 5 degC/min
    assert patience_s({"chamber_air_degC": 60.0, "unit_degC": 69.0}, limits) == pytest.approx(12.0)
    assert patience_s({"chamber_air_degC": -40.0}, limits) == LONGEST_S
    assert patience_s({"chamber_air_degC": 65.0}, limits) == WALL_S
    assert patience_s({}, limits) == WALL_S


def test_hard_limits_come_from_the_chamber_unless_they_are_written(tmp_path: Path) -> None:
    shipped = find_shipped("stations", "af_bench_sim")
    assert load_station(shipped).guard_limits_degC == {"chamber_air_degC": 65.0, "unit_degC": 70.0}
    text = Path(shipped).read_text()
    own = tmp_path / "own.yaml"
    own.write_text(text + "\nguard: {limits: {chamber_air: 62 degC}, silence: 1.5 s}\n")
    station = load_station(own)
    assert station.guard_limits_degC == {"chamber_air_degC": 62.0, "unit_degC": 70.0}
    assert station.file.guard.silence == 1.5


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("guard: {limits: {chamber_air: 60 degC}}", "not above the chamber's own limit of 60 degC"),
        ("guard: {limits: {chamber_air: 65}}", "chamber_air"),
        ("guard: {silence: 10 s}", "silence"),
        ("guard: {silent: 2 s}", "silent"),
    ],
)
def test_a_guard_that_makes_no_sense_is_refused(tmp_path: Path, section: str, said: str) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(Path(find_shipped("stations", "af_bench_sim")).read_text() + f"\n{section}\n")
    with pytest.raises(InputError, match=said):
        load_station(own)


START_LONGEST_S = 30.0  # only ends a test that hangs
BRIEF = Brief(1, "@py", (Address("calibrator", "fluke_5720a", "GPIB0::4::INSTR"),), {}, 2.0, "guard.jsonl")
GUARD = """\
import os, sys
log = open(sys.argv[1], "ab", buffering=0)
os.write(1, b"rea"); log.write(sys.stdin.buffer.readline()); os.write(1, b"dy\\n")
while line := sys.stdin.buffer.readline():
    log.write(line)
    try: "answers" in sys.argv and os.write(1, b".")
    except OSError: pass
    if "dies" in sys.argv and not os.path.exists(sys.argv[1] + ".died"):
        open(sys.argv[1] + ".died", "w").close(); sys.exit()
log.write(b"null\\n")
"""


class Run:
    """A run in virtual time with a guard that is a process of a few lines, which notes what it hears."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, *ways: str, program: str = GUARD) -> None:
        self.log = folder / "heard"
        command = [sys.executable, "-I", "-S", "-c", program, str(self.log), *ways]
        monkeypatch.setattr(start, "own_process", lambda _: command)
        self.clock, self.stop = VirtualClock(), StopSwitch()
        self.health = Health(self.clock)
        self.told: list[dict[str, Any]] = []
        self.guard = GuardProcess(
            BRIEF, self.health, self.stop, self.clock, lambda event: self.told.append(event.document())
        )

    def states(self) -> list[str]:
        return [event["state"] for event in self.told]

    def heard(self, what: Callable[[list[Any]], bool]) -> list[Any]:
        """Wait until the guard has heard something; return its messages behind the brief."""
        messages: list[Any] = []

        def has_come() -> bool:
            messages[:] = [json.loads(line) for line in self.log.read_bytes().splitlines()][1:]
            return what(messages)

        until(has_come, lambda: messages, START_LONGEST_S, each_s=0.01)
        return messages

    def beats(self, until_s: float) -> None:
        """Let time pass, beat by beat; the guard has heard each, and answered where it does."""
        while self.clock.now_ns() < until_s * NS:
            before = len(self.heard(lambda _: True))
            self.health.alive(SEQUENCER, "step 7")
            self.health.alive(LINKS)
            self.clock.sleep(BEAT_S)
            if "lost" not in self.states():
                self.heard(lambda messages, least=before: len(messages) > least)


def test_each_heartbeat_is_told_in_time_and_a_goodbye_ends_the_guard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch, "answers")
    with run.guard:
        run.heard(lambda messages: len(messages) == 1)  # at once
        run.beats(2.0)
        run.health.note(CHAMBER_AIR, 41.5)
        run.beats(3.0)
    first, *_, before, last, goodbye, end = run.heard(lambda messages: messages[-1:] == [None])
    assert first == {"values": {}, "air_age_s": 0.0, "at": ["", 0.0]}
    assert (before["values"], before["air_age_s"]) == ({CHAMBER_AIR: 41.5}, 0.5)
    assert (last["air_age_s"], last["at"]) == (1.0, ["step 7", 3.0])
    assert goodbye == {"goodbye": {}, "heat_off": False}
    assert end is None
    assert run.states() == ["ready"]
    assert run.guard._process.returncode == 0  # it left by itself: its pipes were closed
    run.stop.check()


def test_what_is_left_at_the_end_is_the_guards_at_once_and_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch, "answers")
    with run.guard:
        run.health.begin(["calibrator", "dmm"])  # the guard has no meter to make safe
        run.health.over({"calibrator": "commanded", "dmm": "unreachable"}, heat_off=True)
        run.guard.beat()
        run.guard.beat()
    goodbyes = [message for message in run.heard(lambda all_: all_[-1:] == [None]) if message and "goodbye" in message]
    assert goodbyes == [{"goodbye": {"calibrator": "commanded"}, "heat_off": True}]
    assert start._AT_WORK.pop() is run.guard._process  # it is left alone, and outlives this process
    assert run.guard._process.wait(GOODBYE_S) == 0


def test_a_guard_that_died_is_replaced_where_somebody_has_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch, "dies")
    with run.guard:
        run.health.begin(["calibrator"])
        run.guard._process.wait(START_LONGEST_S)
        run.guard.beat()
        assert run.states() == ["ready", "lost"]
        with pytest.raises(RunError, match="B-RUN-091"):
            run.stop.check()
    messages = run.heard(lambda all_: all_[-1:] == [None])
    assert messages[-2] == {"goodbye": {"calibrator": "unreachable"}, "heat_off": False}
    assert start._AT_WORK.pop().wait(GOODBYE_S) == 0


def test_a_guard_that_does_not_answer_for_5_s_ends_the_run_and_no_sooner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch)
    with run.guard:
        run.beats(UNANSWERED_S)  # the first beat that can be missed is that at once
        assert run.states() == ["ready"]
        run.stop.check()
        run.beats(UNANSWERED_S + 2 * BEAT_S)
        assert run.states() == ["ready", "lost"]
        with pytest.raises(RunError, match="has not answered for 5 s"):
            run.stop.check()
        run.beats(UNANSWERED_S + 10 * BEAT_S)
    assert run.states() == ["ready", "lost"]
    beats = [message for message in run.heard(lambda all_: all_[-1:] == [None]) if message and "at" in message]
    assert max(beat["at"][1] for beat in beats) <= UNANSWERED_S + 2 * BEAT_S  # nothing is told to one that is lost


@pytest.mark.parametrize("program", ["import sys; sys.exit('no bus')", "import os; os.write(1, b'ready')"])
def test_a_guard_that_ends_before_it_is_ready_starts_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    with pytest.raises(RunError) as refused:
        Run(tmp_path, monkeypatch, program=program).guard.__enter__()
    assert refused.value.code == "B-RUN-090"
    assert ("no bus" in refused.value.message) == ("no bus" in program)
