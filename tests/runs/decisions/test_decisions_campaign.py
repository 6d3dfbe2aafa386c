"""A campaign that decides by what it reads: run, held, killed at any place and gone on with, replayed."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from probe_bench import HEAD, NAME, WARM_UP, AtMeter, at_reading, command, deciding_plan, events_of, sequence_file
from rehearsal import SEED, Crashes, Rehearsal, contents, crashed_at, go_on, rehearsed

from bench.model.clock import NS
from bench.model.errors import InputError, InstrumentError
from bench.model.events import event_of
from bench.record import SessionReader
from bench.replay import replay_rows
from bench.run.context import RunContext
from bench.run.control.channel import OPERATOR
from bench.run.feed.run_state import RunState
from bench.run.session import Conducted
from bench.run.stop import Wish
from bench.session.service import read_view
from bench.session.view import analyse_view
from bench.web.recorded.past import Past
from instruments.thermotron_3800 import Thermotron3800

LOOP, IF, CHOOSE = 4, 65, 69  # numbers of decisions in the plan
OHM = "meter.measure_resistance: {range: 1 kohm, cycles: 10}"
PLAIN = HEAD.replace("analysis: probe_means\n", "")
ONCE = PLAIN + f"  - {OHM}\n  - settle: 10 s\n"
BRANCHES = "    then: [settle: 1 h]\n"
pytestmark = pytest.mark.usefixtures("probes")


def decided(folder: Path) -> list[tuple[int, str, float]]:
    return [(one["step"], one["outcome"], one["readings"][0]["value"]) for one in events_of(folder, "decision")]


@pytest.fixture(scope="module")
def crashes(tmp_path_factory: pytest.TempPathFactory, probes: None) -> Crashes:
    """The run is copied in the loop at a record, at a decision and at a settle time, behind it, and in a branch."""
    folder = tmp_path_factory.mktemp("decisions")
    return crashed_at(deciding_plan(folder), folder, {9, 13, 14, 28, IF, 66, CHOOSE, 72})


def test_a_loop_stops_by_its_reading(crashes: Crashes) -> None:
    """The air rises by 1 degC a minute, so that it passes 35 degC in the seventh or eighth turn of two minutes."""
    loop = [one for one in decided(crashes.whole) if one[0] < IF]
    assert [step for step, _, _ in loop] == [LOOP + 3 * turn for turn in range(len(loop))]
    assert [outcome for _, outcome, _ in loop] == ["turn"] * (len(loop) - 1) + ["done"]
    assert all(degC < 35.0 for _, _, degC in loop[:-1])
    assert loop[-1][2] >= 35.0
    assert len(loop) - 1 in (7, 8)
    assert [one[:2] for one in decided(crashes.whole)[-2:]] == [(IF, "then"), (CHOOSE, "case 2")]
    skipped = [(one["first"], one["stop"]) for one in events_of(crashes.whole, "skip")]
    assert skipped == [(loop[-1][0] + 1, IF), (67, CHOOSE), (70, 71)]


def test_the_time_of_what_is_left_out_does_not_pass(crashes: Crashes) -> None:
    end = events_of(crashes.whole, "end")[0]
    assert (end["slip_s"], end["overruns"], end["steps"], end["error"]) == (0.0, 0, len(crashes.plan.steps), None)
    clock = SessionReader(crashes.whole).messages()
    last_s = max(message.t_ns for message in clock) / 1e9
    turns = sum(one["outcome"] == "turn" for one in events_of(crashes.whole, "decision"))
    assert last_s == pytest.approx(10.0 + 120.0 * turns + 1800.0 + 120.0 + 10.0, abs=1.0)


def test_the_same_seed_gives_the_same_bytes(crashes: Crashes, tmp_path: Path) -> None:
    again = rehearsed(tmp_path / "out", deciding_plan(tmp_path)).run
    assert contents(again.folder) == contents(crashes.whole)


def test_every_reader_of_a_session_takes_it(tmp_path: Path) -> None:
    """A record that was not decided for is not missing; what decided cannot be made up point by point."""
    said = command("run", sequence_file(tmp_path), "--out", tmp_path / "out", "--seed", SEED)
    assert "while chamber.measure_air" in said
    assert "left out" not in said, "what was decided has been told"
    folder = tmp_path / "out" / NAME
    assert "every number is identical" in command("replay", folder)
    records = len(events_of(folder, "record"))
    assert f"{records} valid, 0 missing, 0 invalid of {records} records" in command("recover", folder)
    state = Past().final(folder)
    assert (state["records"]["done"], state["records"]["planned"]) == (records, records)
    report = (folder / "report.html").read_text()
    assert "What the sequence decided, by what was read last." in report
    assert f"<td>chamber.measure_air {decided(folder)[0][2]:g} °C</td>" in report
    assert report.count("<td>while</td>") == sum(step < IF for step, _, _ in decided(folder))
    checked = command("check", sequence_file(tmp_path), "--plot", tmp_path / "timetable.svg")
    assert "decisions    23: steps and records are those of all branches" in checked


def test_what_decided_is_not_made_up(crashes: Crashes, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(crashes.at(14), tmp_path / "stopped"))
    with pytest.raises(InputError, match=r"B-RES-008: .*decides by what it reads"):
        command("recover", folder, "--make-up", tmp_path / "rest.yaml")


@pytest.mark.parametrize("number", [9, 13, 14, 28, IF, 66, CHOOSE, 72])
def test_a_killed_run_goes_on_with_what_was_decided(crashes: Crashes, number: int, tmp_path: Path) -> None:
    """Nothing is decided twice, and the ways taken are those of the undisturbed run."""
    source = crashes.at(number)
    before = decided(source)
    folder = Path(shutil.copytree(source, tmp_path / NAME))
    assert go_on(folder).outcome.error is None
    steps = [step for step, _, _ in decided(folder)]
    assert steps == sorted(set(steps))
    assert decided(folder)[: len(before)] == before
    assert [one[:2] for one in decided(folder)] == [one[:2] for one in decided(crashes.whole)]
    results, whole = (analyse_view(read_view(one))[0] for one in (folder, crashes.whole))
    assert [one["conditions"] for one in results["estimates"]] == [one["conditions"] for one in whole["estimates"]]


def failing(times: int) -> AtMeter:
    """The meter reads nothing the first ``times``; what a decision holds is released at once."""

    def act(context: RunContext, number: int) -> None:
        if number <= times:
            raise InstrumentError("B-INST-007", "overload", where="meter")

    return AtMeter(act, held_s=0.0)


def conducted(tmp_path: Path, text: str, meter: AtMeter | None = None) -> Conducted:
    return rehearsed(tmp_path / "out", deciding_plan(tmp_path, text), beside=[meter or failing(0)]).run


def test_a_missing_reading_holds_until_it_is_read(tmp_path: Path) -> None:
    meter = failing(2)
    text = ONCE + "  - if: {reading: meter.measure_resistance, above: 1 ohm}\n" + BRANCHES
    done = conducted(tmp_path, text, meter)
    assert done.outcome.error is None
    why = "meter.measure_resistance gave no value at step 0, so nothing can be decided by it"
    assert meter.held == [why, why]
    ((step, outcome, ohm),) = decided(done.folder)
    assert (step, outcome) == (2, "then")
    assert ohm == pytest.approx(109.0, abs=1.0)


@pytest.mark.parametrize(
    ("decision", "outcome"),
    [
        ("if: {reading: meter.measure_resistance, above: 1 ohm}\n" + BRANCHES + "    else: [settle: 1 s]\n", "else"),
        ("choose: meter.measure_resistance\n    cases: [{above: 1 ohm, do: [settle: 1 s]}]\n"
         "    else: [settle: 2 s]\n", "else"),
        (f"while: {{reading: meter.measure_resistance, above: 1 ohm}}\n    at_most: 2\n    else: go_on\n"
         f"    do: [{{{OHM}}}, settle: 10 s]\n", "done"),
    ],
)  # fmt: skip
def test_a_missing_reading_takes_what_is_declared(tmp_path: Path, decision: str, outcome: str) -> None:
    meter = failing(1)
    done = conducted(tmp_path, f"{ONCE}  - {decision}", meter)
    assert (done.outcome.error, meter.held) == (None, [])
    assert decided(done.folder) == [(2, outcome, None)]
    assert str(event_of("decision", events_of(done.folder, "decision")[0]).sentence).endswith(f"a value: {outcome}")


def test_a_prompt_is_a_reading(tmp_path: Path) -> None:
    """The simulated operator answers with the middle of the limits, 2 ohm."""
    asked = PLAIN + (
        "  - prompt: {text: measure, value: {unit: ohm, low: 1 ohm, high: 4 ohm, quantity: isolation}}\n"
        "  - choose: isolation\n    cases: [{within: [1900 mohm, 2.1 ohm], do: [settle: 1 s]}]\n"
    )
    done = conducted(tmp_path, asked)
    assert decided(done.folder) == [(1, "case 1", 2.0)]


def test_a_preparation_may_wait_for_a_reading(tmp_path: Path) -> None:
    """Its loop is over before the campaign begins, and what it leaves out is none of the campaign's time."""
    waits = (
        "prepare:\n  - chamber.set_temperature: {temperature: 40 degC, ramp: 5 degC/min}\n  - chamber.run\n"
        "  - settle: 10 s\n  - chamber.measure_air\n"
        "  - while: {reading: chamber.measure_air, below: 30 degC}\n    at_most: 50\n"
        "    do: [settle: 60 s, chamber.measure_air]\nsteps:\n  - settle: 100 s\n"
    )
    plan = deciding_plan(tmp_path, PLAIN.replace("steps:\n", waits))
    assert (plan.prepare_s, plan.duration_s) == (10.0 + 50 * 60.0, 100.0)
    done = rehearsed(tmp_path / "out", plan).run
    assert (done.outcome.error, done.outcome.slip_s) == (None, 0.0)
    turns = sum(outcome == "turn" for _, outcome, _ in decided(done.folder))
    assert 1 < turns < 10
    begun_ns = events_of(done.folder, "phase")[1]["t_start_ns"]
    assert begun_ns / NS == pytest.approx(10.0 + 60.0 * turns, abs=0.1)


def never(ending: str = "") -> str:
    return HEAD + WARM_UP.replace("at_most: 20", f"at_most: 2{ending}")


def test_a_loop_without_a_turn_left_ends_the_run_safely(tmp_path: Path, rehearse: Callable[..., Rehearsal]) -> None:
    done = rehearse(deciding_plan(tmp_path, never()))
    error = done.run.outcome.error
    assert (error.code, int(error.exit_status), list(done.run.outcome.unsafe)) == ("B-RUN-073", 3, [])
    assert "after the last turn, still below 35 degC" in error.message
    assert [one[1] for one in decided(done.run.folder)] == ["turn", "turn"]


def test_a_run_that_has_ended_so_decides_again_when_it_is_gone_on_with(
    tmp_path: Path, rehearse: Callable[..., Rehearsal]
) -> None:
    """What ended the run was no decision: the last record is taken again, and its reading counts."""
    folder = rehearse(deciding_plan(tmp_path, never())).run.folder
    assert go_on(folder, away_s=60.0).outcome.error.code == "B-RUN-073"
    assert len(events_of(folder, "record")) == 3


@pytest.mark.parametrize("ending", ["go_on", "hold"])
def test_a_loop_without_a_turn_left_goes_on_or_holds(tmp_path: Path, ending: str) -> None:
    """Held, it takes its last reading again, each time somebody lets it go on, until the air is warm enough."""
    meter = failing(0)
    done = conducted(tmp_path, never(f"\n    else: {ending}"), meter)
    assert done.outcome.error is None
    last = decided(done.folder)[-1]
    assert last[:2] == (10, "go_on" if ending == "go_on" else "done")
    assert (last[2] >= 35.0) == (ending == "hold")
    assert bool(meter.held) == (ending == "hold")
    assert [row.window.number for row in done.outcome.rows] == [1, 2]


RECORD = """\
          - record:
              seconds: 60 s
              readings: [meter.measure_resistance: {range: 1 kohm, cycles: 10}]
              conditions: {temperature: DEGC degC}
"""
WARM, HOT = RECORD.replace("DEGC", "40"), RECORD.replace("DEGC", "60")
SEQUENCE = f"""\
{HEAD}\
  - chamber.set_temperature: {{temperature: 40 degC, ramp: 1 degC/min}}
  - chamber.run
  - settle: 10 s
  - point
procedures:
  point:
    do:
      - chamber.measure_air
      - settle: 10 s
      - if: {{reading: chamber.measure_air, below: 30 degC}}
        then:
{WARM}\
          - settle: 10 s
{WARM}\
        else:
          - chamber.set_temperature: {{temperature: 60 degC, ramp: 1 degC/min}}
          - settle: 1 h
{HOT}"""
FIRST, DECISION, LAST = 3, 5, 8  # steps of the point: its first, its decision, the last record of 'then'
LEFT_OUT = (9, 12)
HELD_S = 100.0


def pause(context: RunContext) -> None:
    context.stop.holds.hold(OPERATOR, "coffee")


def again(context: RunContext) -> None:
    context.stop.holds.wish(Wish("retake", "interlock air", "too warm"))


@pytest.mark.parametrize("act", [pause, again])
def test_a_point_that_is_taken_again_keeps_its_decision(tmp_path: Path, act: Callable[[RunContext], None]) -> None:
    """Both records of the branch are taken again from the first step of the point, and decided is only once."""
    done = conducted(tmp_path, SEQUENCE, at_reading(2, act, HELD_S))
    assert done.outcome.error is None
    assert [(one["step"], one["outcome"]) for one in events_of(done.folder, "decision")] == [(DECISION, "then")]
    assert len(events_of(done.folder, "reading")) == 2 + 2 + 2
    assert [row.window.number for row in done.outcome.rows] == [1, 2]
    assert [row.window.step for row in replay_rows(done.folder).rows] == [6, LAST]
    assert [(one["first"], one["stop"]) for one in events_of(done.folder, "skip")] == [LEFT_OUT]


def test_a_point_that_is_skipped_does_not_jump_over_a_decision(tmp_path: Path) -> None:
    """Skipped in its first record; the rest of the branch is done, and the other branch is not."""
    skip = at_reading(1, lambda context: context.stop.holds.wish(Wish("skip", "interlock air", "too warm")), HELD_S)
    done = conducted(tmp_path, SEQUENCE, skip)
    assert done.outcome.error is None
    assert [row.window.step for row in done.outcome.rows] == [LAST]
    assert [(one["by"], one["first"], one["stop"]) for one in events_of(done.folder, "skip")] == [
        ("interlock air", FIRST, 7), ("decision", *LEFT_OUT),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def held_crashes(tmp_path_factory: pytest.TempPathFactory, probes: None) -> Crashes:
    folder = tmp_path_factory.mktemp("held")
    return crashed_at(deciding_plan(folder, SEQUENCE), folder, {LAST})


def test_a_decision_stands_though_the_reading_is_another_now(
    held_crashes: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The point is taken again from its reading on, which says 50 degC by now: 'then' is done all the same."""
    folder = Path(shutil.copytree(held_crashes.at(LAST), tmp_path / held_crashes.whole.name))
    assert [one["outcome"] for one in events_of(folder, "decision")] == ["then"]
    monkeypatch.setattr(Thermotron3800, "measure_air", lambda chamber: 50.0)
    assert go_on(folder).outcome.error is None
    assert [one["value"] for one in events_of(folder, "reading") if one["name"] == "measure_air"][-1] == 50.0
    assert [one["outcome"] for one in events_of(folder, "decision")] == ["then"]
    assert {one["target_degC"] for one in events_of(folder, "reentry")} == {40.0}  # not that of the branch left out
    assert [row.window.step for row in replay_rows(folder).rows] == [6, LAST]


def test_a_recording_is_followed_on_the_way_that_was_taken(held_crashes: Crashes) -> None:
    """Its page stands at a step of the branch that was done, and counts the records of this way."""
    state = RunState(held_crashes.plan.steps, {}, source="replay")
    stood: set[int] = set()
    for message in SessionReader(held_crashes.whole).messages():
        t_s = message.t_ns / NS
        if message.topic.endswith("event"):
            state.on_event(event_of(*message.event()), t_s)
        step = state.document(t_s)["step"]
        if step is not None:
            stood.add(step["number"] - 1)
    assert not stood & set(range(*LEFT_OUT))
    assert {6, 7, LAST} <= stood
