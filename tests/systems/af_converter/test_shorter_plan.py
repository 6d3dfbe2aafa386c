"""The shipped shorter campaign: what ``bench plan`` made of that of 38 hours, held against the truth.

Counts are those of the physics of ``fit_simulation`` at the planned times; one channel of each kind stands for all that
are alike.
"""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import doubt_scale_factor as wrong
import fit_simulation as sim
import pytest
from plan_sample import reworded
from rehearsal import ROOT
from scipy import stats
from trials import without_budgets

from bench.analysis import Analysis, Material
from bench.cli import main
from bench.commands import planning as command
from bench.commands.requests import PlanRequest
from bench.design import Design, Key, Target, default_targets, reached
from bench.design.shortest import misses
from bench.model.errors import InputError
from bench.plan import Plan, PlannedRecord, PlannedSoak, check_plan, compile_sequence
from bench.session.designed import Asked, Proposal, problem_of, proposed
from bench.session.predicted import predicted
from bench.systems.af_converter.scale_factor.analysis import analyse
from bench.systems.af_converter.scale_factor.design.campaign import Campaigns, Candidate
from bench.systems.af_converter.scale_factor.design.template import template_of

SEQUENCES = ROOT / "sequences"


@cache
def planned_points(name: str, channels: tuple[int, ...] = (1, 7)) -> list[sim.Point]:
    """Return the measuring records of some channels of a shipped sequence, each with the end of the soak before it."""
    records, arrived_s = [], 0.0
    for step in plan_of(name).phase("campaign"):
        if isinstance(step, PlannedSoak):
            arrived_s = step.at_s + step.duration_s
        elif isinstance(step, PlannedRecord) and step.conditions["channel"] in channels:
            records.append((step, arrived_s))
    length_s = records[-1][0].at_s + records[-1][0].seconds
    return [point_of(step, arrived_s, length_s) for step, arrived_s in records]


def point_of(step: PlannedRecord, arrived_s: float, length_s: float) -> sim.Point:
    """Return a record of a campaign of this length."""
    given: Any = step.conditions
    what = given["route"], abs(given["current_A"] or 0.0), given["polarity"], given["range_A"]
    place = sim.Place(step.at_s / length_s, given["channel"], given["temperature_degC"], given["repeat"], what)
    return sim.Point(place, step.at_s, arrived_s, dict(given), 0.0, step.seconds)


def simulate_plan(seed: int, points: list[sim.Point], world: sim.World | None = None) -> sim.SimulatedCampaign:
    """Return one campaign of the planned records, seeded."""
    kinds = {point.place.channel: point.conditions["kind"] for point in points}
    return sim.simulate_points(seed, points, kinds, sim.Switches(), world)


GIVEN, SHORTER = "scale_factor_38h", "scale_factor_26h"
LAG_s = 27.0 * 60.0


@cache
def plan_of(name: str) -> Plan:
    return compile_sequence(SEQUENCES / f"{name}.yaml", None, {})


@cache
def problem() -> Campaigns:
    return problem_of(plan_of(GIVEN), LAG_s)


@cache
def shipped() -> tuple[Candidate, float]:
    """Return the shipped plan as the search sees it."""
    template = template_of(plan_of(SHORTER))
    return Candidate(tuple(template.levels_A), template.stops, template.again, by_lag=True), template.dwell_s


@pytest.mark.validates(
    "campaign of 38 h in 26 h: random parts, asymmetry and temperature coefficients no worse",
    against="the prediction of the fit for both compiled sequences",
)
def test_the_shorter_plan_reaches_what_the_given_one_does(record_property: Any) -> None:
    plan = plan_of(SHORTER)
    assert check_plan(plan) == []
    record_property("obtained", f"{plan.duration_s / 3600.0:.2f} h")
    assert plan.duration_s <= 26.0 * 3600.0
    known, found = (reached(predicted(each).estimates) for each in (plan_of(GIVEN), plan))
    targets = default_targets(problem().wanted, known)
    assert len(targets) == 14
    print({target.key.name: f"{target.reached(found) / target.U:.3f}" for target in targets})
    assert misses(targets, found) == []


def test_what_the_search_sees_is_what_is_compiled() -> None:
    candidate, length_s = shipped()
    plan = plan_of(SHORTER)
    assert problem().duration_s(candidate, length_s) == pytest.approx(plan.duration_s, abs=1e-6)
    ours, theirs = reached(problem().estimates(candidate, length_s)), reached(predicted(plan).estimates)
    for key in (key for key in theirs if key[:2] in problem().wanted):
        assert ours[key] == pytest.approx(theirs[key], rel=1e-4), key


def test_the_rules_hold_and_break() -> None:
    candidate, length_s = shipped()
    assert problem().broken(candidate, length_s) == []
    levels_A = candidate.levels_A[0], (5e-4, 1e-3, 0.02)
    blind = {
        "one direction": replace(candidate, stops=tuple(sorted(candidate.stops))),
        "closing": replace(candidate, stops=candidate.stops[:-1]),
        "gain: level (accelerometer) that costs 1 U of dsf_n": replace(candidate, levels_A=levels_A),
        "gain: step (accelerometer) that costs 1 U of dsf_n_tc2": replace(candidate, again=((7,), (1,))),
    }
    for word, each in blind.items():
        assert any(word in sentence for sentence in problem().broken(each, length_s)), word


def test_no_record_is_so_long_that_a_channel_gets_warmer() -> None:
    candidate, length_s = shipped()
    longest_s = problem().lengths_s(candidate)[-1]
    assert length_s <= longest_s
    heat_A2 = [2.0 * math.fsum(level_A**2 for level_A in levels_A) for levels_A in candidate.levels_A]
    given_A2 = [2.0 * math.fsum(level_A**2 for level_A in levels_A) for levels_A in problem().today[0].levels_A]
    assert longest_s == math.floor(min(100.0 * given / now for given, now in zip(given_A2, heat_A2, strict=True)))


@pytest.mark.slow
@pytest.mark.validates(
    "campaign of 26 h: intervals hold the truth",
    against="40 campaigns, sweep 100",
)
@pytest.mark.parametrize("campaigns", [40, pytest.param(100, marks=pytest.mark.sweep)])
def test_stated_intervals_hold_the_truth(record_property: Any, campaigns: int) -> None:
    """Seeds from 0 on. The values of a campaign share errors, so that it counts once for each quantity and kind."""
    points = planned_points(SHORTER)
    inside: dict[tuple[str, str], list[bool]] = {}
    for seed in range(campaigns):
        campaign = simulate_plan(seed, points)
        entries = judged_entries(analysed(campaign).estimates)[::-1]
        first = {(entry.quantity, entry.conditions.get("kind", "")): entry for entry in entries}
        for place, entry in first.items():
            inside.setdefault(place, []).append(abs(entry.value - campaign.truth(entry)) <= entry.expanded_uncertainty)
    low, high = stats.binom.interval(0.999, campaigns, 0.95)
    counts = {place: sum(held) for place, held in inside.items()}
    print(f"of {campaigns} campaigns, {low:g} to {high:g} are due: {counts}")
    record_property("obtained", f"{min(counts.values())} to {max(counts.values())} of {campaigns}")
    assert len(counts) == 18
    assert all(low <= count <= high for count in counts.values())


def analysed(campaign: sim.SimulatedCampaign) -> Analysis:
    """Return the analysis without the budgets, which nothing here reads."""
    with without_budgets():
        return analyse(Material(campaign.rows, campaign.campaign, campaign.standards))


def judged_entries(estimates: Any) -> list[Any]:
    return [one for one in estimates if one.quantity in wrong.QUANTITIES and "repeat" not in one.conditions]


@pytest.mark.parametrize(
    ("world", "told"), [(wrong.CALIBRATOR_STEP(1e-5), True), (wrong.CALIBRATOR_DRIFT(1e-5), False)]
)
def test_a_step_of_the_calibrator_is_told_from_a_steady_drift(world: Any, told: bool) -> None:
    """Of 10 ppm, seed 0: the visits in the middle and at the end lie on a line, or they do not."""
    analysis = analysed(simulate_plan(0, planned_points(SHORTER), world=world))
    heard = [seen for seen in analysis.evidence if seen.code == "departs"]
    print([seen.sentence for seen in heard])
    assert bool(heard) == told
    assert any(one.quantity == "dsf_n_tc1" for seen in heard for one in seen.entries) == told


def test_what_cannot_be_planned_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    cases = {
        ("plan", "rlg_lock_in"): "B-DES-003",
        ("plan", "scale_factor_short"): "B-DES-004",
        ("plan", GIVEN, "--target", "dsf_n=15ppm"): "B-DES-002",
        ("plan", GIVEN, "--target", "dsf_n"): "B-DES-001",
        ("plan", GIVEN, "--within", "26"): "'26 h'",
        ("plan", GIVEN, "--lag", "0 min"): "'27 min'",
        ("plan", "gnc_imu_calibration", "--lag", "27 min"): "nothing in gnc_imu_calibration waits for a lag",
    }
    for words, code in cases.items():
        monkeypatch.setattr("sys.argv", ["bench", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert code in capsys.readouterr().err, words


def test_targets_that_no_plan_reaches_and_plans_of_another_form_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Campaigns, "starts", [problem().today[0]])
    for lag_s in (LAG_s, None):
        with pytest.raises(InputError) as error:
            proposed(plan_of(GIVEN), Asked(["dsf_n.random=1e-6ppm"], None, lag_s))
        assert error.value.code == "B-DES-006"
        assert ("--lag" in error.value.next_step) == (lag_s is None)
    text = (SEQUENCES / f"{GIVEN}.yaml").read_text(encoding="utf-8").replace('seconds: "{dwell}"', "seconds: 100 s")
    path = tmp_path / "other.yaml"
    text = text.replace(f"sequence: {GIVEN}", "sequence: other").replace("  dwell: 100 s\n", "")
    path.write_text(text, encoding="utf-8")
    other: Any = problem_of(compile_sequence(path, None, {}), LAG_s)
    with pytest.raises(InputError) as error:
        other.written(*shipped(), "shorter", [])
    assert error.value.code == "B-DES-005"


DECLARED = ("duration: 38 h\n", "records: 765\n")


def given_text() -> str:
    text = (SEQUENCES / f"{GIVEN}.yaml").read_text(encoding="utf-8")
    for line in DECLARED:
        assert line in text
        text = text.replace(line, "")
    return text


def proposal_from(path: Path) -> Proposal:
    """Return the shipped shorter plan as if the search had found it in place of a given sequence."""
    plan = compile_sequence(path, None, {})
    problem: Any = problem_of(plan, LAG_s)
    template = template_of(compile_sequence(SEQUENCES / f"{SHORTER}.yaml", None, {}))
    candidate = Candidate(tuple(template.levels_A), template.stops, template.again, by_lag=True)
    design = Design(candidate, template.dwell_s, problem.duration_s(candidate, template.dwell_s))
    known = reached(problem.estimates(*problem.today))
    found = reached(problem.estimates(candidate, design.length_s))
    return Proposal(plan, problem, default_targets(problem.wanted, known), design, known, found)


@cache
def shipped_proposal() -> Proposal:
    return proposal_from(SEQUENCES / f"{GIVEN}.yaml")


def spelt(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """Return the given sequence, which declares no duration, in other words."""
    path = tmp_path / f"{GIVEN}.yaml"
    path.write_text(reworded(given_text(), *changes), encoding="utf-8")
    return path


def written(found: Proposal, folder: Path) -> Plan:
    path = folder / "shorter.yaml"
    path.write_text(found.text("shorter"), encoding="utf-8")
    plan = compile_sequence(path, None, {})
    assert check_plan(plan) == []
    return plan


DONE = "          done: {residual: 0.2 degC, least: 100 min}\n          late: hold\n"


@pytest.mark.parametrize(
    ("changes", "least_s"),
    [
        ([('slot: "{slot}"', "slot: '{slot}'")], 5400.0),
        ([("  slot: 9000 s\n", ""), ('slot: "{slot}"', "slot:   '9000 s'")], 5400.0),
        ([("  slot: 9000 s\n", ""), ('slot: "{slot}"', "slot: 9000 s  # by hand")], 5400.0),
        ([("          late: hold\n", DONE)], 6000.0),
    ],
    ids=["other quotes", "a value", "a comment", "a least time of a soak"],
)
def test_each_soak_has_its_slot_however_the_given_one_is_spelt(
    tmp_path: Path, changes: list[tuple[str, str]], least_s: float
) -> None:
    plan = written(proposal_from(spelt(tmp_path, *changes)), tmp_path)
    slots_s = [step.slot_s for step in plan.phase("campaign") if isinstance(step, PlannedSoak)]
    assert slots_s == [least_s, 6000.0, 6000.0, 6000.0, 8280.0, 10200.0]
    if least_s == 5400.0:
        assert plan.duration_s == pytest.approx(shipped_proposal().design.duration_s, abs=1e-6)


def test_what_the_slots_rest_on_stands_in_table_and_file(tmp_path: Path) -> None:
    """The chamber begins where ``finally`` leaves it, else at 23 degC; what is written has no margin for the lag."""
    last = "  - soak: {temperature: 25 degC, ramp: 0.5 degC/min, slot: 600 s, late: skip,\n"
    last += "           stable: {within: 2 degC, for: 1 min, sensor: air}}\n"
    left = ("  - function_generator.output_off\n\n", f"{last}  - function_generator.output_off\n\n")
    for found, degC in ((shipped_proposal(), 23), (proposal_from(spelt(tmp_path, left)), 25)):
        rests = f"for a lag of 27 min and no more, the chamber at {degC} degC before the first"
        assert any(rests in line for line in found.lines())
        assert f"  # The soak to a temperature, with slots {rests}.\n" in found.text("shorter")


def test_what_was_asked_stands_beside_the_factor_that_a_time_leaves() -> None:
    within = replace(shipped_proposal(), targets=[Target(Key("dsf_n", "", ""), 25.0)])
    assert next(within.target_lines()).startswith("dsf_n: 25 asked, ")
    within = replace(within, design=replace(within.design, factor=0.8687))
    assert next(within.target_lines()).startswith("dsf_n: 25 asked times 0.87, ")
    document = within.document()
    assert (document["factor"], document["targets"][0]["U"]) == (0.8687, 25.0)


def test_what_stands_on_one_line_is_refused(tmp_path: Path) -> None:
    """Parameters, or the points."""
    flow = "parameters: {serial: SIM-1, dwell: 100 s, settle: 20 s, ramp: 0.5 degC/min, slot: 9000 s, "
    text = given_text()
    begin, end = text.index("parameters:"), text.index("tables:")
    for change in (
        (text[begin:end], f"{flow}within: 1 degC, stable_for: 10 min}}\n\n"),
        ("        do:\n          - all_points\n", "        do: [all_points]\n"),
    ):
        with pytest.raises(InputError, match="B-DES-005: "):
            proposal_from(spelt(tmp_path, change)).text("shorter")


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        (
            {"design": replace(shipped_proposal().design, duration_s=shipped_proposal().design.duration_s - 60.0)},
            "duration",
        ),
        ({"found": {key: 0.99 * U for key, U in shipped_proposal().found.items()}}, "dsf_n.random"),
        ({}, ""),
    ],
)
def test_what_would_not_be_what_was_found_is_not_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, changed: dict[str, Any], word: str
) -> None:
    """Nor beside a figure that cannot be drawn; what is as it was found is written as it was checked."""
    out = tmp_path / "shorter.yaml"
    monkeypatch.setattr(command, "proposed", lambda *_: replace(shipped_proposal(), **changed))
    monkeypatch.setattr(command, "curve", lambda *_: [(1.0, 25.9), (2.0, 19.2)])
    plot = None if word else tmp_path / "none" / "figure.svg"
    with pytest.raises(InputError) as error:
        command.plan(request(out, plot=plot))
    assert error.value.code == ("B-DES-007" if word else "B-CLI-007")
    assert word in error.value.message
    assert list(tmp_path.iterdir()) == []
    if not word:
        command.plan(request(out))
        assert out.read_text(encoding="utf-8") == shipped_proposal().text("shorter")
        assert list(tmp_path.iterdir()) == [out]


def request(out: Path, sequence: str | Path = GIVEN, plot: Path | None = None) -> PlanRequest:
    return PlanRequest(str(sequence), lag="27 min", out=out, plot=plot, json=True)


def test_the_given_sequence_is_never_replaced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    path = spelt(tmp_path, (f"sequence: {GIVEN}", "sequence: own")).rename(tmp_path / "own.yaml")
    before = path.read_bytes()
    monkeypatch.setattr(command, "proposed", lambda *_: shipped_proposal())
    with pytest.raises(InputError, match="B-DES-001: "):
        command.plan(request(Path("own.yaml"), path))
    assert path.read_bytes() == before
