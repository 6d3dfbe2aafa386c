"""Links that are pulled out or fall silent in the middle of a campaign: the run waits, and nothing is done twice."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from plan_sample import reworded
from rehearsal import Rehearsal, rehearsed

from bench.frame import load_frame
from bench.model.clock import NS
from bench.model.errors import ExitStatus
from bench.model.lab import find_shipped
from bench.plan import Plan, check_plan, compile_sequence
from bench.replay import replay_rows
from sim_instruments.worlds.af_converter import ngu as ngu_core
from sim_instruments.worlds.common.world import World

SEED = 5
SEQUENCE = """\
sequence: links
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
unit_commands:
  start_stream: {code: 2, payload: "64"}
  identify: {code: 1}
timeline:
  - {at: 0 s, call: {supply.configure: {voltage: 18 V, current_limit: 2 A, over_voltage: 21 V}}}
  - {at: 1 s, call: supply.output_on}
  - {at: 3 s, unit: {port_b: start_stream}}
  - {at: 4 s, unit: {port_b: identify}}
  - {at: 10 s, record: 10 s}
  - {at: 21 s, record: 10 s}
  - {at: 32 s, record: 10 s}
finally:
  - supply.output_off
  - soak:
      {temperature: 23 degC, ramp: 0.5 degC/min, slot: 120 s, late: skip,
       stable: {within: 2 degC, for: 1 min, sensor: air}}
"""
SECOND_RECORD_S = 21
KINDS = ("link", "hold", "release", "error", "end", "answer", "gap", "exchange")
ERASE = 1


Happening = tuple[float, Callable[[World], object]]
Start = Callable[..., Rehearsal]
Watch = Callable[[Plan, Sequence[Happening]], Rehearsal]


@pytest.fixture
def watch(tmp_path: Path) -> Watch:
    """Run a plan while things happen at seconds of the bench clock."""

    def run(plan: Plan, happens: Sequence[Happening]) -> Rehearsal:
        def arrange(world: World) -> None:
            for at_s, do in happens:
                world.after(at_s, partial(do, world))

        return rehearsed(tmp_path / "out", plan, arrange, seed=SEED, kept=KINDS)

    return run


def links_of(ran: Rehearsal) -> list[str]:
    return [f"{event['link']} {event['state']}" for event in ran.events("link")]


@pytest.fixture
def start(tmp_path: Path, watch: Watch) -> Start:
    """Run the sequence, changed, while things happen."""

    def run(*happens: Happening, changes: tuple[tuple[str, str], ...] = ()) -> Rehearsal:
        path = tmp_path / "links.yaml"
        path.write_text(reworded(SEQUENCE, *changes))
        plan = compile_sequence(path, None, {})
        assert check_plan(plan) == []
        return watch(plan, happens)

    return run


def unplug(name: str, unplugged: bool) -> Callable[[World], None]:
    return lambda world: world.faults.link(name).unplug(unplugged)


def silent(name: str, quiet: bool) -> Callable[[World], None]:
    return lambda world: setattr(world.faults.link(name), "silent", quiet)


def stuck(name: str, pattern: bytes) -> Callable[[World], None]:
    return lambda world: setattr(world.faults.link(name), "stuck", pattern)


def assert_whole(ran: Rehearsal) -> None:
    """Three records without a flaw, and a replay that finds the same."""
    assert ran.run.outcome.error is None
    rows = ran.run.outcome.rows
    assert [(row.frames, row.lost, row.quality) for row in rows] == [(1000, 0, 0)] * 3
    again = replay_rows(ran.run.folder, strict=True)
    assert [row.window for row in again.measurement_rows] == [row.window for row in rows]
    assert again.totals == dict(ran.run.counts)


def test_a_run_without_trouble_says_nothing_of_links(start: Start) -> None:
    ran = start()
    assert_whole(ran)
    assert links_of(ran) == []


@pytest.mark.parametrize("name", ["port_a", "port_b"])
def test_a_port_that_is_pulled_out_and_put_back(start: Start, name: str) -> None:
    ran = start((SECOND_RECORD_S + 6, unplug(name, True)), (SECOND_RECORD_S + 30, unplug(name, False)))
    assert_whole(ran)
    assert links_of(ran) == [f"{name} lost", f"{name} back"]
    lost, back = ran.events("link")
    assert "unplugged" in lost["reason"]
    assert 23 <= back["seconds"] <= 27
    assert back["how"] == "port opened again; counter went on; unit answers 'NGU SIM-1 1.0'"
    assert [event["by"] for event in ran.events("hold")] == [f"link {name}"]
    assert len(ran.events("release")) == 1
    assert ran.run.counts["frames_lost"] > 0  # those of the time without a port


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        (silent("port_a", True), silent("port_a", False)),
        (stuck("port_a", b"\x00"), stuck("port_a", b"")),
        (stuck("port_a", b"\xeb\x90"), stuck("port_a", b"")),
    ],
    ids=["nothing", "constant byte", "endless preamble"],
)
def test_a_stream_without_frames_is_silence(start: Start, begin: Any, end: Any) -> None:
    ran = start((SECOND_RECORD_S + 6, begin), (SECOND_RECORD_S + 30, end))
    assert_whole(ran)
    assert links_of(ran) == ["port_a silent", "port_a back"]
    assert ran.events("link")[1]["how"].startswith("'start_stream' sent again; counter went on; unit answers")


def test_both_links_at_once(start: Start) -> None:
    ran = start(
        (SECOND_RECORD_S + 6, unplug("port_a", True)), (SECOND_RECORD_S + 7, unplug("port_b", True)),
        (SECOND_RECORD_S + 20, unplug("port_b", False)), (SECOND_RECORD_S + 26, unplug("port_a", False)),
    )  # fmt: skip
    assert_whole(ran)
    assert links_of(ran) == ["port_a lost", "port_b lost", "port_b back", "port_a back"]
    assert len(ran.events("hold")) == 1


def test_a_unit_that_was_restarted_gets_its_command_again(start: Start) -> None:
    ran = start(
        (SECOND_RECORD_S + 6, lambda world: world.unit.set_power(False, world.clock.now_ns())),
        (SECOND_RECORD_S + 18, lambda world: world.unit.set_power(True, world.clock.now_ns(), 18.0)),
    )
    assert_whole(ran)
    backs = [event for event in ran.events("link") if event["state"] == "back"]
    assert {event["link"] for event in backs} == {"port_a", "port_b"}
    assert all("counter began anew: the unit was restarted" in event["how"] for event in backs)
    assert all("'start_stream' sent again" in event["how"] for event in backs)


def test_another_unit_ends_the_run(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    def swap(world: World) -> None:
        monkeypatch.setattr(ngu_core, "IDENTITY", b"NGU SIM-2 1.0")
        world.faults.link("port_a").unplug(False)

    ran = start((SECOND_RECORD_S + 6, unplug("port_a", True)), (SECOND_RECORD_S + 12, swap))
    error = ran.run.outcome.error
    assert (error.code, error.where, error.exit_status) == ("B-RUN-025", "port_a", ExitStatus.SAFE_AFTER_FAULT)
    assert "'NGU SIM-2 1.0', expected 'NGU SIM-1 1.0'" in error.message
    assert ran.run.outcome.unsafe == ()
    assert len(ran.run.outcome.rows) == 1


def test_a_plan_that_cannot_ask_goes_by_frames_and_counter(start: Start) -> None:
    ran = start(
        (SECOND_RECORD_S + 6, unplug("port_a", True)), (SECOND_RECORD_S + 12, unplug("port_a", False)),
        changes=(("  - {at: 4 s, unit: {port_b: identify}}\n", ""),),
    )  # fmt: skip
    assert_whole(ran)
    assert ran.events("link")[1]["how"] == "port opened again; counter went on; identity not asked"


@pytest.mark.parametrize(("fault", "code"), [(unplug, "B-RUN-024"), (silent, "B-RUN-021")])
def test_patience_ends(start: Start, fault: Callable[[str, bool], Any], code: str) -> None:
    ran = start((SECOND_RECORD_S + 6, fault("port_a", True)))
    error = ran.run.outcome.error
    assert (error.code, error.where) == (code, "port_a")
    assert "not back after 600 s" in error.message
    assert ran.run.outcome.unsafe == ()
    assert 600 <= ran.run.events[-1][1] / NS - SECOND_RECORD_S - 6 <= 640


def test_nobody_waits_for_a_link_before_it_has_spoken(start: Start) -> None:
    ran = start((0.5, unplug("port_a", True)), (2.0, unplug("port_a", False)))
    assert_whole(ran)
    assert links_of(ran) == ["port_a lost", "port_a back"]
    assert ran.events("hold") == []


def test_a_unit_that_the_plan_switches_off_is_not_missed(start: Start) -> None:
    power_cycle = """\
  - {at: 42.5 s, call: supply.output_off}
  - {at: 60 s, call: supply.output_on}
  - {at: 63 s, unit: {port_b: start_stream}}
  - {at: 70 s, record: 10 s}
finally:
"""
    ran = start(changes=(("finally:\n", power_cycle),))
    assert ran.run.outcome.error is None
    assert len(ran.run.outcome.rows) == 4
    assert ran.events("hold") == []
    assert links_of(ran) == []


def test_nothing_is_held_while_the_bench_is_put_away(start: Start) -> None:
    ran = start((43.0, unplug("port_a", True)))
    assert ran.run.outcome.error is None
    assert ran.events("hold") == []
    assert links_of(ran) == ["port_a lost"]
    assert len(ran.run.outcome.rows) == 3


@pytest.mark.parametrize("pulled_s", [6.0, 12.0, 14.5])
def test_a_run_of_unit_tests_waits_for_its_link(watch: Watch, pulled_s: float) -> None:
    plan = compile_sequence("gnc_unit_test", None, {"units": "GNC-01"})
    ran = watch(plan, [(pulled_s, unplug("rs422", True)), (pulled_s + 5, unplug("rs422", False))])
    assert ran.run.outcome.error is None
    assert links_of(ran) == ["rs422 lost", "rs422 back"]
    told = ran.events("exchange")
    assert [one["step"] for one in told] == [step.number for step in plan.steps if step.kind == "unit"]
    assert {one["status"] for one in told} == {0}
    memory = load_frame(find_shipped("frames", "gnc_422")).commands["memory"]
    erases = [one for one in told if one["name"] == "memory" and one["conditions"]["operation"] == ERASE]
    assert [memory.decode(bytes.fromhex(one["received"]))["erases"] for one in erases] == [1, 1]
