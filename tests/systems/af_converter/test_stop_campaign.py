"""A campaign whose points end early: run, killed in the middle of a point, gone on with, replayed, analysed."""

from __future__ import annotations

import math
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rehearsal import SEED, Crashes, contents, crashed_at, go_on, nobody, nobody_in
from stop_plan import BY_NOISE, BY_SCATTER, stopping_plan

from bench.maths.budget import combine_all
from bench.model.clock import VirtualClock
from bench.model.stopping import STAGE, UNTIL
from bench.plan import PlannedDecision, PlannedRecord, decisions_of
from bench.record import SessionReader
from bench.replay.parts import recorded_windows
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from bench.run.steps.first_stage import looked_at
from bench.run.steps.position import in_point, point_start, point_stop
from bench.session.service import read_view
from bench.session.view import analyse_view, material_of
from bench.systems.af_converter.scale_factor.budgets import components_of
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.web.recorded.past import Past

PLACES = ("first stage", "decision", "second stage", "behind the second stage")


def rules(crashes: Crashes) -> list[PlannedDecision]:
    return [decision for decision in decisions_of(crashes.plan.steps) if decision.word == UNTIL]


def decided(folder: Path) -> dict[int, dict[str, Any]]:
    return {fields["step"]: dict(fields) for _, _, fields in SessionReader(folder).events("decision")}


def steps_of(folder: Path) -> list[int]:
    """Return the steps of all records."""
    windows = recorded_windows(SessionReader(folder).select(frozenset({"/event"})))
    return list({item.window.number: item.window.step for item in windows}.values())


@pytest.fixture(scope="module")
def crashes(tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    """The run is copied wherever a step of the second point may begin."""
    folder = tmp_path_factory.mktemp("stopping")
    plan = stopping_plan(folder, BY_SCATTER, "1 s")
    decision = decisions_of(plan.steps)[1]
    return crashed_at(plan, folder, set(range(decision.arguments["first"][0], decision.branches[-1].stop + 1)))


def place(crashes: Crashes, name: str) -> int:
    """Number of a step of the second point; of the second stage that which was decided for."""
    decision = rules(crashes)[1]
    outcome = decided(crashes.whole)[decision.number]["outcome"]
    taken = next(branch for branch in decision.branches if branch.outcome == outcome)
    assert taken.first < taken.stop, "the second point has a second stage"
    numbers = decision.arguments["first"][4], decision.number, taken.first, decision.branches[-1].stop
    return int(dict(zip(PLACES, numbers, strict=True))[name])


def test_each_decision_is_an_event_that_its_records_bear_out(crashes: Crashes) -> None:
    """What was decided is decided again from what the session holds, and the records are those that it asks for."""
    rows, events = list(read_view(crashes.whole).rows), decided(crashes.whole)
    taken = {row.window.step for row in rows}
    assert [fields["word"] for fields in events.values()] == [UNTIL] * 4
    for decision in rules(crashes):
        first = [row for row in rows if row.window.step in decision.arguments["first"]]
        more, readings = looked_at(first, decision, crashes.plan.campaign)
        event = events[decision.number]
        assert (event["readings"], event["outcome"]) == (readings, decision.outcome(more))
        assert all(
            later.window.first_counter == row.window.first_counter + row.window.frames for row, later in pairwise(first)
        )
        for branch in decision.branches:
            asked = set(range(branch.first, branch.stop))
            assert (asked <= taken) if branch.outcome == event["outcome"] else not asked & taken


@pytest.mark.parametrize("name", PLACES)
def test_killed_in_the_middle_of_a_point_it_goes_on_to_the_same_bytes(
    crashes: Crashes, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The point is taken again from its beginning; what was decided stands; twice the same, and a replay too."""
    source = crashes.at(place(crashes, name))
    before = decided(source)
    folders = [Path(shutil.copytree(source, tmp_path / half / source.name)) for half in ("first", "second")]
    for folder in folders:
        assert go_on(folder, nobody_in(monkeypatch)).outcome.error is None
    first, second = folders
    after = decided(first)
    assert {step: after[step] for step in before} == before
    assert (rules(crashes)[1].number in before) == (name == PLACES[-1])  # before, it is in the second that is lost
    assert after.keys() == decided(crashes.whole).keys()
    assert contents(first) == contents(second)
    steps = steps_of(first)
    assert len(set(steps)) == len(steps), "a record twice"
    assert {step for rule in rules(crashes) for step in rule.arguments["first"]} <= set(steps)
    results = [analyse_view(read_view(folder))[0] for folder in (first, second, first)]
    assert results[0] == results[1] == results[2]


def test_one_record_is_counted_of_all_second_stages(crashes: Crashes) -> None:
    """Before the first decision, and at the end: those that were taken, and the page says the same."""
    points = 4 * (10 + 1) + 10  # levels; zeros, open inputs and the closing repeat
    assert crashes.plan.record_count == points
    taken = sum(step >= crashes.plan.phase("campaign")[0].number for step in steps_of(crashes.whole))
    records = Past().final(crashes.whole)["records"]
    assert (records["done"], records["planned"]) == (taken, taken)
    more = [fields["outcome"] for fields in decided(crashes.whole).values()]
    assert taken == points - more.count("0 more")


def test_a_point_in_stages_begins_and_ends_as_one(crashes: Crashes) -> None:
    """A hold goes back to where its route is set, a skip goes on behind its verification, wherever it is."""
    steps = crashes.plan.phase("campaign")
    decision, offset = rules(crashes)[1], steps[0].number
    begin = next(at for at in range(decision.number - offset, 0, -1) if steps[at].name == "standby")
    verify = next(at for at in range(decision.number - offset, len(steps)) if steps[at].kind == "verify")
    for at in range(decision.arguments["first"][0] - offset, verify + 1):
        assert point_start(steps, at) == begin
        assert point_stop(steps, at) == verify + 1
        assert in_point(steps, at) == (steps[at] is not decision)


def test_a_point_is_one_reading_with_the_freedom_of_its_first_stage(crashes: Crashes) -> None:
    results, _ = analyse_view(read_view(crashes.whole))
    entries = {entry["quantity"]: entry for entry in results["estimates"]}
    assert entries["dsf_n"]["n"] == 2 + 4  # zeros and levels
    known = determine(material_of(read_view(crashes.whole)), "gls")
    for index, quantity in enumerate(("dsf_n", "dsf_p")):
        parts = components_of(known.fitted.groups[0], index, known.fitted, known.constants, known.standards)
        budget = combine_all({"": parts}).budgets[""]
        assert budget.std_uncertainty == pytest.approx(entries[quantity]["std_uncertainty"], rel=1e-9)
        assert budget.dof == pytest.approx(entries[quantity]["dof"], rel=1e-6)
    asymmetry = entries["dsf_asymmetry"]
    assert 4 * 9 > asymmetry["dof"] > 9  # of four points with nine each
    assert asymmetry["coverage_factor"] > 2.0


def test_by_declared_noise_there_is_no_look(tmp_path: Path) -> None:
    """Lengths are fixed in advance: zeros and the closing repeat have the longest, and nothing is decided."""
    plan = stopping_plan(tmp_path, BY_NOISE, "5 s")
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
    assert not any(STAGE in record.conditions for record in records)
    driven = [record for record in records if record.conditions["route"] == "closed"]
    for record in driven:
        ends = record.conditions["current_A"] > 0 and not record.conditions["repeat"]
        assert (record.seconds, record.longest_s) == ((30.0, 100.0) if ends else (100.0, 0.0))
    done = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=tmp_path / "out", operator=SimulatedOperator(), listener=nobody()
    )
    assert done.outcome.error is None
    assert decided(done.folder) == {}
    entries = {entry["quantity"]: entry for entry in analyse_view(read_view(done.folder))[0]["estimates"]}
    assert entries["dsf_asymmetry"].get("dof", math.inf) == math.inf
