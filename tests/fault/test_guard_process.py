"""The guard as a process, on benches served in real time: killed, stopped and hung controllers, a dead guard, a machine
that sleeps. What counts is what the simulated instruments really do, never a readback of the bench's own.
"""

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from controller import FSYNC_S
from kill_drill import LONGEST_S, Process, after_some_records, session_in
from plan_sample import ONE_TEMPERATURE, one_temperature
from served import SAFE_S, Controller, Served, serving
from waiting import until

from bench.commands.session import replay
from bench.model.clock import NS, WallClock
from bench.model.errors import RunError
from bench.plan import load_station
from bench.record import SessionReader
from bench.replay import replay_rows
from bench.run.guard.diary import read_diary
from bench.run.guard.drill import drill, latest_drill
from bench.run.watch.disk import LATE_S

pytestmark = [pytest.mark.waits, pytest.mark.limit(SAFE_S)]

STIMULUS = """\
sequence: stimulus
station: af_bench_sim
frame: {{port_a: ngu_a, port_b: ngu_b}}
prepare:
  - prompt: Somebody looks at the bench.
timeline:
  - {{at: 0 s, call: calibrator.standby}}
{chamber}  - {{at: {on} s, call: {{switch.route: {{channel: 3, polarity: +}}}}}}
  - {{at: {on}.4 s, call: {{calibrator.output: {{current: 1 mA, range: lowest_that_holds}}}}}}
  - {{at: {on}.6 s, call: calibrator.operate}}
  - {{at: {then} s, call: calibrator.operating}}
  - {{at: {end} s, call: calibrator.standby}}
  - {{at: {end}.6 s, call: switch.open_all}}
"""
CHAMBER = """\
  - {at: 0.2 s, call: {chamber.set_temperature: {temperature: 23 degC, ramp: 1 degC/min}}}
  - {at: 3 s, call: chamber.run}
"""
HEAT_OFF_S = 2.0  # after a hard limit is reached
Start = Callable[..., Controller]


@pytest.fixture
def start(served: Served, tmp_path: Path, out: Path) -> Iterator[Start]:
    """Start a controller whose stimulus is on until ``end``; on a station of its own the chamber runs too."""
    begun: list[Controller] = []

    def start(act: str = "none", end: int = 600, station: Path | None = None) -> Controller:
        sequence = tmp_path / "stimulus.yaml"
        on, chamber = (1, "") if station is None else (5, CHAMBER)
        sequence.write_text(STIMULUS.format(on=on, then=on + 1.5, end=end, chamber=chamber))
        begun.append(Controller(station or served.station, sequence, out, act))
        return begun[-1]

    yield start
    for controller in begun:
        controller.kill()


def is_on(served: Served, controller: Controller) -> None:
    """Wait until the stimulus is on."""
    controller.wait_for("operating")
    assert served.on() == ["calibrator", "switch"]


def off_after_s(served: Served, moment_s: float) -> float:
    """Seconds from a moment of this machine until the last output of the stimulus went off."""
    assert served.on() == []
    after_s = served.changed_s("calibrator", "switch") - moment_s
    print(f"outputs off {after_s:.2f} s after")
    return after_s


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_stopped_controller_leaves_a_safe_bench(
    served: Served, start: Start, number: signal.Signals
) -> None:
    controller = start()
    is_on(served, controller)
    moment_s = time.monotonic()
    os.kill(controller.process.pid, number)
    assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
    assert 0 < off_after_s(served, moment_s) <= SAFE_S
    assert controller.end() == -signal.SIGKILL  # a stopped one is ended too: it must never go on by itself
    assert controller.why == {signal.SIGKILL: "gone", signal.SIGSTOP: "silent"}[number]


@pytest.mark.slow
def test_a_sequencer_that_hangs_is_ended(served: Served, start: Start) -> None:
    controller = start("hang")
    controller.wait_for("hanging")
    moment_s = time.monotonic()
    assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
    assert 0 < off_after_s(served, moment_s) <= SAFE_S
    assert controller.end() == -signal.SIGKILL


@pytest.mark.slow
def test_a_mute_calibrator_goes_off_all_the_same(served: Served, start: Start) -> None:
    controller = start()
    is_on(served, controller)
    served.fault("mute", "calibrator")
    moment_s = time.monotonic()
    os.kill(controller.process.pid, signal.SIGKILL)
    first = controller.wait_for_guard("instrument")
    assert (first["role"], first["safe"]) == ("calibrator", False)
    until(lambda: "switch" in {entry.get("role") for entry in controller.diary}, "the switch in the diary")
    assert 0 < off_after_s(served, moment_s) <= SAFE_S
    served.fault("clear")
    assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_run_whose_guard_is_killed_or_stopped_ends_safely_and_says_so(
    served: Served, start: Start, number: signal.Signals
) -> None:
    controller = start()
    is_on(served, controller)
    guard = int(controller.wait_for_guard("ready")["pid"])
    os.kill(guard, number)
    try:
        controller.wait_for("ended")
    finally:
        with suppress(ProcessLookupError):
            os.kill(guard, signal.SIGKILL)
    assert controller.end() == 3
    assert "B-RUN-091" in controller.heard
    assert "unsafe: []" in controller.heard
    assert served.on() == []


@pytest.mark.slow
def test_waits_and_prompts_are_no_silence(served: Served, start: Start) -> None:
    controller = start("slow", end=8)
    assert controller.end() == 0, controller.heard
    assert "asked" in controller.heard
    assert [entry["what"] for entry in controller.diary] == ["ready", "dismissed"]


@pytest.mark.slow
def test_two_fsyncs_that_are_late_hold_the_run_and_do_not_end_it(served: Served, start: Start) -> None:
    """8 s each, so that 16 s pass without a sign of life of the thread that waits for the disk."""
    controller = start("late_disk", end=10)
    is_on(served, controller)
    moment_s = time.monotonic()
    assert "an fsync is not over after 5 s" in controller.wait_for("holding at step")
    until(lambda: not served.on(), "outputs that are off", 2 * FSYNC_S)
    assert off_after_s(served, moment_s) <= LATE_S + 2.0
    assert controller.end() == 0, controller.heard
    assert [entry["what"] for entry in controller.diary] == ["ready", "dismissed"]


@pytest.fixture
def cool_station(served: Served, tmp_path: Path) -> Path:
    """The served station with a hard limit that the laboratory's air is 1 degC below."""
    text = served.station.read_text()
    old = '"temperature": ["-40 degC", "60 degC"]'
    assert text.count(old) == 1
    path = tmp_path / "station.yaml"
    cool = text.replace(old, '"temperature": ["-40 degC", "23.5 degC"]')
    path.write_text(cool + "guard: {limits: {chamber_air: 24 degC}}\n")
    return path


def heat_off_after_s(served: Served) -> float:
    """Seconds from the moment the chamber's air reached 24 degC until its heat went off."""
    reached = served.until(lambda state: state["chamber_air_degC"] >= 24.0, "the limit")
    off = served.until(lambda state: state["instruments"]["chamber"]["mode"] == "stopped", "no heat")
    after_s = float(off["time_s"] - off["instruments"]["chamber"]["unchanged_s"] - reached["time_s"])
    print(f"heat off {after_s:.2f} s after the air reached the limit")
    return after_s


@pytest.mark.slow
@pytest.mark.limit(HEAT_OFF_S)
@pytest.mark.parametrize(("act", "degC", "limit_s"), [("none", "20", HEAT_OFF_S), ("blind", "6", math.inf)])
def test_a_chamber_that_runs_away_loses_its_heat(
    served: Served, start: Start, cool_station: Path, act: str, degC: str, limit_s: float
) -> None:
    """A guard looks itself where the controller is blind, if not in the 10 s in which it trusts what it was told."""
    controller = start(act, station=cool_station)
    is_on(served, controller)
    served.fault("chamber_runaway", degC)
    assert heat_off_after_s(served) <= limit_s
    assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
    assert served.on() == []
    assert controller.why == "limit"


@pytest.mark.slow
def test_the_drill_finds_the_bench_safe_and_says_where_it_cannot_begin(served: Served, out: Path) -> None:
    station = load_station(served.station)
    found = drill(station, served.station, out, WallClock())
    assert found["passed"]
    assert [(trial["kill"], trial["still_on"]) for trial in found["trials"]] == [("SIGKILL", {}), ("SIGSTOP", {})]
    assert served.on() == []
    assert latest_drill(out, station)["utc"] == found["utc"]
    served.fault("identity", "calibrator", "FLUKE,5500E,1,1")
    with pytest.raises(RunError) as refused:
        drill(station, served.station, out, WallClock())
    assert refused.value.code == "B-RUN-096"
    assert "B-INST-002" in refused.value.message


SPINNING = """\
sequence: spinning
station: gnc_bench_sim
frame: {rs422: gnc_422}
prepare:
  - turntable.set_limits: {axis: 1, rate: 300 deg/s, acceleration: 300 deg/s2}
  - turntable.set_limits: {axis: 2, rate: 300 deg/s, acceleration: 300 deg/s2}
  - turntable.set_limits: {axis: 3, rate: 300 deg/s, acceleration: 300 deg/s2}
  - turntable.close_interlock
  - settle: 2.4 s
steps:
  - turntable.spin: {axis: 1, rate: -250 deg/s}
  - settle: 2 s
  - turntable.spin: {axis: 3, rate: 270 deg/s}
  - settle: 2 s
  - turntable.measure_rate: {axis: 3}
  - settle: 10 min
finally:
  - turntable.open_interlock
"""
STOPPED = pytest.param(signal.SIGSTOP, marks=pytest.mark.sweep)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("table"), of="gnc_bench_sim") as served:
        yield served


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, STOPPED])
def test_a_killed_or_stopped_controller_leaves_a_table_at_rest_with_open_interlocks(
    table: Served, tmp_path: Path, number: signal.Signals
) -> None:
    path, station = tmp_path / "sequence.yaml", tmp_path / "station.yaml"
    path.write_text(SPINNING)
    station.write_text(table.station.read_text().replace("bus_time_factor: 1.0", "bus_time_factor: 0.1"))
    controller = Controller(station, path, tmp_path / "out")
    try:
        controller.wait_for("measure_rate")
        time.sleep(0.5)
        assert table.state()["instruments"]["turntable"]["rates_deg_s"] == [-250.0, 0.0, 270.0]
        moment_s = time.monotonic()
        os.kill(controller.process.pid, number)
        assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
        rest = table.state()["instruments"]["turntable"]
        assert (rest["rates_deg_s"], rest["interlocks"]) == ([0.0] * 3, ["Open"] * 3)
        after_s = table.changed_s("turntable") - moment_s
        print(f"{number.name}: at rest {after_s:.2f} s after")
        assert 0 < after_s <= SAFE_S
    finally:
        controller.kill()


STOPPED_S = 5.0
AHEAD_S = 0.5  # the guard goes on before its controller, and must not take it for dead


def stopped_together(served: Served, process: Process, guard: int) -> tuple[float, float]:
    """Stop both while the calibrator is on, and let both go on; returns when the controller stopped and went on, s."""
    until(lambda: served.on() == ["calibrator", "switch"], "a stimulus that is on", each_s=0.02)
    stopped_s = time.monotonic()
    for pid in (guard, process.pid):
        os.kill(pid, signal.SIGSTOP)
    time.sleep(STOPPED_S)
    assert served.on() == ["calibrator", "switch"]  # nobody is there
    os.kill(guard, signal.SIGCONT)
    time.sleep(AHEAD_S)
    awake_s = time.monotonic()
    os.kill(process.pid, signal.SIGCONT)
    return stopped_s, awake_s


@pytest.mark.slow
def test_the_stimulus_goes_off_and_the_point_is_taken_again(served: Served, out: Path) -> None:
    sequence = str(one_temperature(out.parent))
    words = ["run", sequence, "--station", str(served.station), "--clock", "wall", "--out", str(out)]
    out.mkdir()
    process = Process(out / "said", *words)
    try:
        after_some_records(out)
        folder = session_in(out)
        assert folder is not None
        guard = next(fields["pid"] for _, _, fields in SessionReader(folder).events("guard"))
        stopped_s, awake_s = stopped_together(served, process, guard)
        until(lambda: not served.on(), "outputs that are off", awake_s + SAFE_S - time.monotonic(), each_s=0.02)
        off_s = served.changed_s("calibrator") - awake_s
        print(f"off {off_s:.2f} s after both went on")
        assert 0.0 < off_s <= SAFE_S
        assert process.ended_by(LONGEST_S) == 0, process.said()
    finally:
        process.end()
    assert served.on() == []
    _judge(folder, stopped_s, awake_s)


def _judge(folder: Path, stopped_s: float, awake_s: float) -> None:
    """The session tells it, no record was taken across it, and all its numbers are found again."""

    def events(kind: str) -> list[dict[str, Any]]:
        return [fields for _, _, fields in SessionReader(folder).events(kind)]

    (suspend,), (hold,), (armed,) = events("suspend"), events("hold"), events("armed")
    assert suspend["seen"] == "late beat"
    assert STOPPED_S <= suspend["seconds"] <= awake_s - stopped_s + 1.0
    assert (hold["by"], hold["step"]) == ("suspend", armed["step"])
    windows = [row.window for row in replay_rows(folder, strict=True).measurement_rows]
    assert len({window.step for window in windows}) == len(windows) == ONE_TEMPERATURE
    for window in windows:
        assert window.t_end_ns < stopped_s * NS or window.t_start_ns > awake_s * NS
    assert [entry["what"] for entry in read_diary(folder / "guard.jsonl")] == ["ready", "asleep", "dismissed"]
    assert replay(folder, as_json=False) == 0
