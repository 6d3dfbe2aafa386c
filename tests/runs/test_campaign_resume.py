"""Resume after a crash anywhere: nothing lost or taken twice, the splice is marked, another unit is refused."""

import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from plan_sample import reworded
from rehearsal import (
    ROOT,
    SEED,
    Crashes,
    Rehearsal,
    SOAK_s,
    Watched,
    assert_safe,
    copied,
    crashed_at,
    go_on,
    kinds,
    rehearsed,
    tiny_plan,
    writable_copy,
)

from bench.analysis import results_json
from bench.commands.fit import fit
from bench.commands.recover import recover
from bench.commands.resume import resume
from bench.commands.session import replay
from bench.model.clock import NS, VIRTUAL_START_UTC_NS, VirtualClock
from bench.model.errors import BenchError, ExitStatus, InputError
from bench.model.events import Late, Resume
from bench.plan import Step, compile_sequence
from bench.record import RecordRow, SessionReader, read_journal
from bench.replay.parts import recorded_windows
from bench.run import hold
from bench.run.context import RunContext
from bench.run.resume import read_stopped, resumption
from bench.run.session import Conducted
from bench.run.setpoints import expected_of
from bench.session.happenings import splice_tables
from bench.session.service import read_view
from bench.session.view import SessionView, analyse_view, report_of
from sim_instruments.worlds.af_converter import ngu as ngu_core
from sim_instruments.worlds.common.world import World

RECORDS = 15 + 2  # with the wiring check
FIRST = ("prompt", "wiring", "soak", "behind a record", "between points", "finally")
REST = ("power", "first point", "last record")
PLACES = (*FIRST, *(pytest.param(place, marks=pytest.mark.sweep) for place in REST))


def records_in(folder: Path) -> dict[int, int]:
    """Step by number of the records whose event is in the session."""
    windows = recorded_windows(SessionReader(folder).select(frozenset({"/event"})))
    return {item.window.number: item.window.step for item in windows}


def worst_sigma(first: dict[str, dict[str, Any]], second: dict[str, dict[str, Any]]) -> float:
    """Largest difference of the scale-factor errors in their combined standard uncertainty."""
    assert first.keys() == second.keys()
    return max(
        abs(entry["value"] - second[name]["value"]) / (2**0.5 * entry["std_uncertainty"])
        for name, entry in first.items()
    )


def dsf_of(view: SessionView) -> dict[str, dict[str, Any]]:
    results, _ = analyse_view(view)
    return {entry["quantity"]: entry for entry in results["estimates"] if entry["quantity"].startswith("dsf_")}


def event_in(folder: Path, kind: str) -> Any:
    """Return the fields of the only event of a kind."""
    ((_, _, fields),) = SessionReader(folder).events(kind)
    return fields


def in_order(view: SessionView) -> bool:
    starts = [row.window.t_start_ns for row in view.rows]
    return starts == sorted(starts)


@dataclass(frozen=True)
class GoneOn:
    """A killed run that was gone on with: what was there before, who watched, how it ended."""

    folder: Path
    acknowledged: dict[int, int]
    before: Sequence[RecordRow]
    watched: Watched
    run: Conducted


@pytest.fixture(scope="module")
def gone_on(crashes: Crashes, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], GoneOn]:
    """Go on with the run that was killed at a place, once for all tests; for reading only."""

    def go(place: str) -> GoneOn:
        folder, watched = copied(crashes, place, tmp_path_factory.mktemp("gone_on")), Watched()
        return GoneOn(folder, records_in(folder), read_view(folder).rows, watched, go_on(folder, watched))

    return cache(go)


@pytest.fixture(scope="module")
def undisturbed(crashes: Crashes) -> dict[str, dict[str, Any]]:
    """Return the scale-factor errors of the run that nobody killed."""
    return dsf_of(read_view(crashes.whole))


@pytest.mark.parametrize("place", PLACES)
def test_a_killed_run_goes_on_and_gives_the_same_results(
    crashes: Crashes, undisturbed: dict[str, dict[str, Any]], gone_on: Callable[[str], GoneOn], place: str
) -> None:
    done = gone_on(place)
    assert done.run.outcome.error is None
    assert done.run.outcome.unsafe == ()
    after = records_in(done.folder)
    expected = {step.number for step in crashes.plan.steps if step.kind == "record"}
    assert sorted(after.values()) == sorted(expected), "each record once"
    assert sorted(after) == list(range(1, RECORDS + 1))
    assert done.acknowledged.items() <= after.items(), "an acknowledged record is lost"
    view = read_view(done.folder)
    assert len(view.splices) == 1
    assert not view.incomplete
    sigma = worst_sigma(dsf_of(view), undisturbed)
    print(f"seed {SEED}, killed at {place}: worst difference {sigma:.2f} standard uncertainties")
    assert sigma < 3.0
    assert_safe(done.watched.worlds[-1])
    assert not (done.folder / "journal.jsonl").exists()
    assert not (done.folder / "session.open").exists()


def test_a_record_of_the_flat_form_is_taken_again_under_its_stimulus(tmp_path: Path) -> None:
    """No procedure sets the level again: without it the record would be of an open input, and nothing would say so."""
    text = (ROOT / "sequences" / "timeline_example.yaml").read_text(encoding="utf-8")
    flat = tmp_path / "flat.yaml"
    flat.write_text(reworded(text, ('  - {at: "00:02:20", verify: calibrator.operating}\n', "")), encoding="utf-8")
    plan = compile_sequence(flat, None, {})
    (record,) = (step.number for step in plan.steps if step.kind == "record")
    crashes = crashed_at(plan, tmp_path, {record})
    gone_on = writable_copy(crashes.at(record), tmp_path / "again" / crashes.whole.name)
    assert go_on(gone_on).outcome.error is None
    before, after = (read_view(folder).rows[0].sums["npp"][2] for folder in (crashes.whole, gone_on))
    assert before > 80_000
    assert after == pytest.approx(before, abs=2)


def test_acknowledged_records_are_not_taken_again(gone_on: Callable[[str], GoneOn]) -> None:
    done = gone_on("between points")
    after = {row.window.number: row for row in read_view(done.folder).rows}
    assert done.before
    for row in done.before:
        assert after[row.window.number].window == row.window
        assert after[row.window.number].sums["npp"].tolist() == row.sums["npp"].tolist()
    taken_again = [step.number for step in done.watched.steps if step.kind == "record"]
    assert set(taken_again).isdisjoint({row.window.step for row in done.before})


def test_the_unit_is_soaked_again_only_if_it_has_left_its_band(
    gone_on: Callable[[str], GoneOn], tmp_path: Path
) -> None:
    """A bench begun anew has its unit at 23 degC: out of the band of 1 degC about 25 degC, inside one of 3 degC."""
    fields = event_in(gone_on("between points").folder, "reentry")
    assert fields["soaked"]
    assert abs(fields["unit_degC"] - 23.0) < 0.2
    assert fields["seconds"] >= SOAK_s
    wide = tiny_plan(tmp_path, ("within: 1 degC  ", "within: 3 degC  "))
    number = kinds(wide)["between points"]
    quick = crashed_at(wide, tmp_path, {number}).at(number)
    go_on(quick)
    fields = event_in(quick, "reentry")
    assert not fields["soaked"]
    assert fields["seconds"] < 60.0


def test_a_session_that_was_gone_on_with_replays_identically_and_says_so(
    crashes: Crashes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copied(crashes, "behind a record", tmp_path)
    assert resume(folder, None, None, as_json=False) == ExitStatus.PASS
    assert "going on at step" in capsys.readouterr().err
    assert replay(folder, as_json=False) == ExitStatus.PASS
    assert "every number is identical" in capsys.readouterr().out
    view = read_view(folder)
    results, analysis = analyse_view(view)
    assert results["quality"]["splices"] == 1
    assert results_json(results) == (folder / "results.json").read_text()
    (splice,) = results["splices"]
    assert splice["reason"] == "crash or power cut"
    assert splice["soaked"]
    assert splice["stopped"] <= splice["started"]
    assert abs(splice["drift_degC"] + 1.35) < 0.2  # 24.35 degC before, 23 degC in the bench that was begun anew
    assert "Splices" in report_of(view, results, analysis).html()
    assert splice_tables(view.splices)[0].rows[0][3] == str(splice["step"])
    with pytest.raises(InputError, match="B-RES-001"):
        resume(folder, None, None, as_json=False)


def test_behind_a_clock_that_went_back_records_stay_in_order_and_the_time_away_is_unknown(
    crashes: Crashes, tmp_path: Path
) -> None:
    folder = copied(crashes, "between points", tmp_path)
    assert go_on(folder, utc_back_s=3600.0).outcome.error is None
    view = read_view(folder)
    assert in_order(view)
    (event,) = (event for _, event in view.events if isinstance(event, Resume))
    assert (event.away_s, event.utc_back_s) == (None, pytest.approx(3600.0))
    results, analysis = analyse_view(view)
    assert results["splices"][0]["away_s"] is None
    assert any("Nobody knows how long the run was away" in note for note in results["notes"])
    assert {entry["quality"] for entry in results["estimates"]} == {"sound"}, "the channel was closed by a repeat"
    assert splice_tables(view.splices)[0].rows[0][2] == "unknown"
    assert "go on right behind those before" in report_of(view, results, analysis).html()


def test_a_resumption_says_that_the_time_away_is_unknown(
    crashes: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copied(crashes, "last record", tmp_path)
    behind = VirtualClock(VIRTUAL_START_UTC_NS - 3600 * NS)
    behind.sleep_until_ns(read_stopped(folder).last_ns)
    monkeypatch.setattr("bench.commands.resume._clock", lambda stopped: behind)
    resume(folder, None, None, as_json=False)
    told = " ".join(capsys.readouterr().err.split())
    assert "stopped an unknown time ago (crash or power cut)" in told
    assert "UTC is 3600 s behind what was recorded" in told


def test_a_run_that_was_stopped_twice_goes_on_twice(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "behind a record", tmp_path)
    target = kinds(crashes.plan)["last record"]

    def copy(world: World, step: Step) -> None:
        if step.number == target:
            shutil.copytree(folder, tmp_path / "again" / folder.name)

    go_on(folder, Watched(copy))
    again = tmp_path / "again" / folder.name
    assert go_on(again).outcome.error is None
    view = read_view(again)
    assert [splice.step for splice in view.splices] == sorted(splice.step for splice in view.splices)
    assert (len(view.splices), len(view.rows)) == (2, 15)
    assert in_order(view)


def test_a_run_that_ended_by_a_fault_goes_on(
    tmp_path: Path, rehearse: Callable[..., Rehearsal], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hold, "AWAY_LIMIT_S", 60.0)
    plan = tiny_plan(tmp_path)
    target = kinds(plan)["between points"]

    def mute(world: World, step: Step) -> None:
        world.faults.instrument("calibrator").mute = step.number == target

    found = rehearse(plan, act=mute).run
    assert found.outcome.error is not None
    assert fit(found.folder, None, as_json=True) == ExitStatus.PASS
    assert read_view(found.folder).incomplete
    assert go_on(found.folder).outcome.error is None
    view = read_view(found.folder)
    assert [splice.reason for splice in view.splices] == [found.outcome.error.code]
    assert len(view.rows) == 15


def test_a_fit_during_the_run_reads_what_is_there_and_judges_nothing(
    crashes: Crashes, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = crashes.at(kinds(crashes.plan)["last record"])
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert fit(folder, None, as_json=False) == ExitStatus.PASS
    assert "Incomplete: the run has not ended" in capsys.readouterr().out
    view = read_view(folder)
    results, analysis = analyse_view(view)
    assert "Incomplete: the run has not ended" in report_of(view, results, analysis).html()
    assert results["incomplete"] is True
    assert results["notes"][0].startswith("Incomplete")
    assert {one["verdict"] for one in results["estimates"]} == {"none"}
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    whole, _ = analyse_view(read_view(crashes.whole))
    assert not {"incomplete", "splices"} & whole.keys()


def test_what_the_instruments_confirmed_is_in_the_journal_and_held_against_what_is_found(
    crashes: Crashes, gone_on: Callable[[str], GoneOn]
) -> None:
    state = expected_of(read_journal(crashes.at(kinds(crashes.plan)["behind a record"])).entries)
    assert state["supply"]["configure"] == {"voltage": 18.0, "current_limit": 2.0, "over_voltage": 21.0}
    assert state["chamber"]["set_temperature"]["temperature"] == 25.0
    assert state["function_generator"]["square"]["frequency"] == 10e6
    for role, call in (("supply", "output_on"), ("calibrator", "operate"), ("switch", "route")):
        assert call in state[role]
    said = "\n".join(event_in(gone_on("behind a record").folder, "resume")["differences"])
    assert "calibrator: output was on, is off" in said
    assert "supply: was at 18 V, is at " in said
    assert "switch: a route was closed" in said


def test_recover_lists_the_records_and_why(crashes: Crashes, capsys: pytest.CaptureFixture[str]) -> None:
    assert recover(crashes.at(kinds(crashes.plan)["between points"]), None, as_json=False) == ExitStatus.PASS
    said = capsys.readouterr().out
    assert "7 valid, 8 missing, 0 invalid of 15 records" in said  # the event of the eighth was not on the disk yet
    assert "8 missing: the run stopped before" in said


def test_what_a_stopped_run_knew_is_known_again(crashes: Crashes, tmp_path: Path) -> None:
    """Who the unit is; and that a soak was left unstable, so that the records behind it still say so."""
    folder = copied(crashes, "behind a record", tmp_path)
    stopped = read_stopped(folder)
    plain = resumption(stopped, 0)
    soak = [step for step in stopped.plan.steps[: plain.start] if step.kind == "soak"][-1].number

    def after(policy: str, number: int) -> Any:
        late = Late(step=number, policy=policy, last_degC=20.0, slope_degC_min=0.1)
        return resumption(replace(stopped, events=[*stopped.events, late]), 0)

    assert plain.settled
    assert after("hold", soak).settled
    assert after("skip", soak + 1).settled
    seen = []

    def look(context: RunContext) -> AbstractContextManager[object]:
        seen.append((context.settled, context.unit_answer))
        raise BenchError("B-RUN-090", "that is enough")

    rehearsed(tmp_path, stopped.plan, beside=[look], resumed=after("skip", soak))
    assert seen == [(False, b"NGU SIM-1 1.0")]


def test_another_unit_is_not_gone_on_with(crashes: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Records of two units do not belong in one session, as little as those of two standards."""
    folder = copied(crashes, "behind a record", tmp_path)
    before = records_in(folder)
    monkeypatch.setattr(ngu_core, "IDENTITY", b"NGU SIM-2 1.0")
    error = go_on(folder).outcome.error
    assert (error.code, error.exit_status) == ("B-RUN-025", ExitStatus.SAFE_AFTER_FAULT)
    assert "expected 'NGU SIM-1 1.0'" in error.message
    assert len(records_in(folder)) <= len(before)
    monkeypatch.undo()
    assert go_on(folder).outcome.error is None
    assert sorted(records_in(folder)) == list(range(1, RECORDS + 1))
