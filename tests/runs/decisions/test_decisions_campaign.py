"""A campaign that decides by what it reads: run, killed at any place and gone on with, replayed, held, ended."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from probe_bench import NAME, AtMeter, command
from probe_decisions import HEAD, WARM_UP, deciding_plan, events_of, sequence_file
from rehearsal import SEED, Crashes, Rehearsal, contents, crashed_at, go_on, rehearsed

from bench.model.clock import NS
from bench.model.errors import InputError, InstrumentError
from bench.model.events import event_of
from bench.record import SessionReader
from bench.run.context import RunContext
from bench.run.session import Conducted
from bench.session.service import read_view
from bench.session.view import analyse_view
from bench.web.recorded.past import Past

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


# --- undisturbed -----------------------------------------------------------------------------------------------------


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
    with pytest.raises(InputError, match="decides by what it reads") as caught:
        command("recover", folder, "--make-up", tmp_path / "rest.yaml")
    assert caught.value.code == "B-RES-008"


# --- killed and gone on with -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [9, 13, 14, 28, IF, 66, CHOOSE, 72])
def test_a_killed_run_goes_on_with_what_was_decided(crashes: Crashes, number: int, tmp_path: Path) -> None:
    """Nothing is decided twice, the ways taken are those of the undisturbed run, and a replay gives the same bytes."""
    source = crashes.at(number)
    before = decided(source)
    folders = [Path(shutil.copytree(source, tmp_path / name / NAME)) for name in ("first", "second")]
    for folder in folders:
        assert go_on(folder).outcome.error is None
    first, second = folders
    steps = [step for step, _, _ in decided(first)]
    assert steps == sorted(set(steps))
    assert decided(first)[: len(before)] == before
    assert [one[:2] for one in decided(first)] == [one[:2] for one in decided(crashes.whole)]
    assert contents(first) == contents(second)
    results = [analyse_view(read_view(folder))[0] for folder in (first, second, first)]
    assert results[0] == results[1] == results[2]
    whole = analyse_view(read_view(crashes.whole))[0]
    assert [one["conditions"] for one in results[0]["estimates"]] == [one["conditions"] for one in whole["estimates"]]


def test_the_commands_go_on_and_replay_to_the_same_bytes(crashes: Crashes, tmp_path: Path) -> None:
    """Killed in the middle of the loop, the last second lost: resumed twice, replayed, every byte is the same."""
    folders = [Path(shutil.copytree(crashes.at(14), tmp_path / name / NAME)) for name in ("first", "second")]
    for folder in folders:
        assert "going on at step 12 of" in command("resume", folder)
        assert "every number is identical" in command("replay", folder)
    first, second = ((folder / "results.json").read_bytes() for folder in folders)
    assert first == second


# --- nothing to decide by, and no turn left --------------------------------------------------------------------------


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
    assert (done.outcome.error, done.outcome.slip_s, done.outcome.steps_done) == (None, 0.0, len(plan.steps))
    turns = sum(outcome == "turn" for _, outcome, _ in decided(done.folder))
    assert 1 < turns < 10
    begun_ns = events_of(done.folder, "phase")[1]["t_start_ns"]
    assert begun_ns / NS == pytest.approx(10.0 + 60.0 * turns, abs=0.1)


def never(ending: str = "") -> str:
    return HEAD + WARM_UP.replace("at_most: 20", f"at_most: 2{ending}")


def test_a_loop_without_a_turn_left_ends_the_run_safely(tmp_path: Path, rehearse: Callable[..., Rehearsal]) -> None:
    done = rehearse(deciding_plan(tmp_path, never()))
    error = done.run.outcome.error
    assert error is not None
    assert (error.code, int(error.exit_status), list(done.run.outcome.unsafe)) == ("B-RUN-073", 3, [])
    assert "after the last turn, still below 35 degC" in error.message
    assert [one[1] for one in decided(done.run.folder)] == ["turn", "turn"]


def test_a_run_that_has_ended_so_decides_again_when_it_is_gone_on_with(
    tmp_path: Path, rehearse: Callable[..., Rehearsal]
) -> None:
    """What ended the run was no decision: the last record is taken again, and its reading counts."""
    folder = rehearse(deciding_plan(tmp_path, never())).run.folder
    again = go_on(folder, away_s=60.0)
    assert again.outcome.error is not None
    assert again.outcome.error.code == "B-RUN-073"
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
