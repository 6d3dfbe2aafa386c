"""What ``until`` makes of records: lengths against the formula of quantisation and noise, branches, mistakes."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from rehearsal import compiled
from stop_plan import stopping_plan, stopping_text

from bench.model.errors import InputErrors
from bench.model.stopping import STAGE, UNTIL
from bench.plan import Plan, PlannedRecord, decisions_of, summarise

QUANTUM_C, AF_Hz, WHITE_A_rtHz = 1.25e-6, 256e3, 2e-9


def refused(folder: Path, until: str, seconds: str = "5 s", levels: str = "10 mA", more: str = "") -> tuple[str, str]:
    """Return code and message of the one mistake of a campaign."""
    path = folder / "stopping.yaml"
    text = stopping_text(until, seconds, levels)
    path.write_text(text.replace(f"until: {until}\n", f"until: {until}\n{more}"))
    with pytest.raises(InputErrors) as caught:
        compiled(path)
    codes = {error.code for error in caught.value.errors}
    assert len(codes) == 1, caught.value.errors
    assert "stopping.yaml:" in caught.value.errors[0].where
    return caught.value.errors[0].code, caught.value.errors[0].message


def ending(plan: Plan) -> list[PlannedRecord]:
    return [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord) and step.longest_s]


def random_A(level_A: float, seconds: float) -> float:
    """Standard uncertainty of a mean over one record, by hand."""
    residue = math.sqrt(1.0 / 12.0 + 1.0 / 12.0)
    counts, clock = residue * QUANTUM_C / seconds, residue * level_A / (AF_Hz * seconds)
    return math.sqrt(counts**2 + clock**2 + WHITE_A_rtHz**2 / (2.0 * seconds))


@pytest.mark.validates("lengths that declared noise asks for", against="quantisation and white noise, by hand")
@pytest.mark.parametrize(("until", "share"), [("{random: 2 ppm, most: 100}", 2e-6), ("{random: 30 nA, most: 100}", 0)])
def test_a_record_is_no_longer_than_declared_noise_asks_for(tmp_path: Path, until: str, share: float) -> None:
    plan = stopping_plan(tmp_path, until, "1 s", "10 mA, 100 mA, 200 mA")
    records = ending(plan)
    assert len(records) == 6
    for record in records:
        level_A = record.conditions["current_A"]
        target_A = share * level_A or 30e-9
        assert random_A(level_A, record.seconds) <= target_A * (1 + 1e-9)
        assert random_A(level_A, record.seconds - 1.0) > target_A if record.seconds > 1.0 else True
        assert record.longest_s == 100.0
    assert decisions_of(plan.steps) == []
    (told,) = summarise(plan).stops
    assert told.startswith("6 points last ")


def test_least_is_never_undercut(tmp_path: Path) -> None:
    plan = stopping_plan(tmp_path, "{random: 1000 ppm, least: 4, most: 100}", "1 s")
    assert {record.seconds for record in ending(plan)} == {4.0}


def test_a_second_stage_has_a_branch_for_each_length(tmp_path: Path) -> None:
    plan = stopping_plan(tmp_path, "{random: 10 ppm, least: 12, most: 40, by: scatter}", "1 s", "100 mA")
    decision = decisions_of(plan.steps)[0]
    assert (decision.word, decision.unit, decision.missing) == (UNTIL, "1", "28 more")
    first = [plan.steps[number] for number in decision.arguments["first"]]
    assert [step.number for step in first] == list(range(decision.number - 12, decision.number))
    assert all(isinstance(step, PlannedRecord) and step.follows == bool(at) for at, step in enumerate(first))
    assert {step.conditions[STAGE] for step in first} == {1}
    lengths = [sum(plan.steps[at].duration_s for at in range(b.first, b.stop)) for b in decision.branches]
    assert lengths == [0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 28]
    outcomes = {need: decision.outcome(float(need)) for need in (0, 1, 5, 17, 28, 400)}
    assert outcomes == {0: "0 more", 1: "1 more", 5: "6 more", 17: "24 more", 28: "28 more", 400: "28 more"}
    behind = next(step for step in plan.steps if step.number == decision.branches[-1].stop)
    assert behind.at_s == first[0].at_s + 40.0, "the longest counts"


@pytest.mark.parametrize(
    ("until", "says"),
    [
        ("{random: 0.5 ppm, most: 5}", "after 25 s declared noise and quantisation leave 20.4 nA (2.04 ppm)"),
        ("{random: 0.5 ppm, most: 15, by: scatter}", "after 75 s quantisation alone leaves 9.63 nA (0.963 ppm)"),
    ],
)
def test_a_target_below_the_bound_is_refused_with_the_bound(tmp_path: Path, until: str, says: str) -> None:
    code, message = refused(tmp_path, until)
    assert code == "B-PLAN-161"
    assert says in message


@pytest.mark.parametrize(
    ("until", "more", "says"),
    [
        ("{random: 2 ppm, least: 9, most: 30, by: scatter}", "", "a first stage has 10 records or more"),
        ("{random: 2 ppm, most: 10, by: scatter}", "", "and fewer than 'most': 10"),
        ("{random: 2 ppm, least: 9, most: 8}", "", "at least 9 records and at most 8"),
        (
            "{random: 2 ppm, most: 30}",
            "          pulse_timing: true\n",
            "a record with 'pulse_timing' cannot end early",
        ),
        ("{random: 2 ppm, most: 30}", "          purpose: wiring\n", "purpose wiring cannot end early"),
    ],
)
def test_a_record_that_cannot_end_early_is_refused(tmp_path: Path, until: str, more: str, says: str) -> None:
    code, message = refused(tmp_path, until, more=more)
    assert code == "B-PLAN-160"
    assert says in message


def test_a_target_is_a_ratio_or_a_current(tmp_path: Path) -> None:
    code, message = refused(tmp_path, "{random: 2 s, most: 30}")
    assert (code, message) == ("B-PLAN-031", "2 s is no ratio and no quantity in A above zero")


def test_an_analysis_that_does_not_know_its_points_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "stopping.yaml"
    text = stopping_text("{random: 2 ppm, most: 30}", "1 s")
    path.write_text(text.replace("analysis: scale_factor", "analysis: none"))
    with pytest.raises(InputErrors) as caught:
        compiled(path)
    assert [error.code for error in caught.value.errors] == ["B-PLAN-160"]
