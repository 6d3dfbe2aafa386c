"""What ``bench plan`` writes: the plan that was found, from given sequences of other spelling, and never over them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from rehearsal import ROOT

from bench.commands.planning import plan as command
from bench.commands.requests import PlanRequest
from bench.design import Design, Key, Target, default_targets, reached
from bench.model.errors import InputError
from bench.plan import Plan, PlannedSoak, check_plan, compile_sequence
from bench.session.designed import Proposal, problem_of
from bench.systems.af_converter.scale_factor.design.campaign import Candidate
from bench.systems.af_converter.scale_factor.design.template import template_of

GIVEN, SHORTER = "scale_factor_38h", "scale_factor_26h"
LAG_s = 27.0 * 60.0
DECLARED = ("duration: 38 h\n", "records: 765\n")


def given_text() -> str:
    text = (ROOT / "sequences" / f"{GIVEN}.yaml").read_text(encoding="utf-8")
    for line in DECLARED:
        assert line in text
        text = text.replace(line, "")
    return text


def proposal_from(path: Path) -> Proposal:
    """Return the shipped shorter plan as if the search had found it in place of a given sequence."""
    plan = compile_sequence(path, None, {})
    problem: Any = problem_of(plan, LAG_s)
    template = template_of(compile_sequence(ROOT / "sequences" / f"{SHORTER}.yaml", None, {}))
    candidate = Candidate(tuple(template.levels_A), template.stops, template.again, by_lag=True)
    design = Design(candidate, template.dwell_s, problem.duration_s(candidate, template.dwell_s))
    known = reached(problem.estimates(*problem.today))
    found = reached(problem.estimates(candidate, design.length_s))
    return Proposal(plan, problem, default_targets(problem.wanted, known), design, known, found)


@cache
def shipped() -> Proposal:
    return proposal_from(ROOT / "sequences" / f"{GIVEN}.yaml")


def spelt(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """Return the given sequence, which declares no duration, in other words."""
    text = given_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / f"{GIVEN}.yaml"
    path.write_text(text, encoding="utf-8")
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
        assert plan.duration_s == pytest.approx(shipped().design.duration_s, abs=1e-6)


def test_what_the_slots_rest_on_stands_in_table_and_file(tmp_path: Path) -> None:
    """The chamber begins where ``finally`` leaves it, else at 23 degC; what is written has no margin for the lag."""
    last = "  - soak: {temperature: 25 degC, ramp: 0.5 degC/min, slot: 600 s, late: skip,\n"
    last += "           stable: {within: 2 degC, for: 1 min, sensor: air}}\n"
    left = ("  - function_generator.output_off\n\n", f"{last}  - function_generator.output_off\n\n")
    for found, degC in ((shipped(), 23), (proposal_from(spelt(tmp_path, left)), 25)):
        rests = f"for a lag of 27 min and no more, the chamber at {degC} degC before the first"
        assert any(rests in line for line in found.lines())
        assert f"  # The soak to a temperature, with slots {rests}.\n" in found.text("shorter")


def test_what_was_asked_stands_beside_the_factor_that_a_time_leaves() -> None:
    within = replace(shipped(), targets=[Target(Key("dsf_n", "", ""), 25.0)])
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
        with pytest.raises(InputError) as error:
            proposal_from(spelt(tmp_path, change)).text("shorter")
        assert error.value.code == "B-DES-005"


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"design": replace(shipped().design, duration_s=shipped().design.duration_s - 60.0)}, "duration"),
        ({"found": {key: 0.99 * U for key, U in shipped().found.items()}}, "dsf_n.random"),
        ({}, ""),
    ],
)
def test_what_would_not_be_what_was_found_is_not_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, changed: dict[str, Any], word: str
) -> None:
    """Nor beside a figure that cannot be drawn; what is as it was found is written as it was checked."""
    out = tmp_path / "shorter.yaml"
    monkeypatch.setattr(command, "proposed", lambda *_: replace(shipped(), **changed))
    monkeypatch.setattr(command, "curve", lambda *_: [(1.0, 25.9), (2.0, 19.2)])
    plot = None if word else tmp_path / "none" / "figure.svg"
    with pytest.raises(InputError) as error:
        command.plan(request(out, plot=plot))
    assert error.value.code == ("B-DES-007" if word else "B-CLI-007")
    assert word in error.value.message
    assert list(tmp_path.iterdir()) == []
    if not word:
        assert command.plan(request(out)) == 0
        assert out.read_text(encoding="utf-8") == shipped().text("shorter")
        assert list(tmp_path.iterdir()) == [out]


def request(out: Path, sequence: str | Path = GIVEN, plot: Path | None = None) -> PlanRequest:
    return PlanRequest(str(sequence), lag="27 min", out=out, plot=plot, json=True)


def test_the_given_sequence_is_never_replaced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    path = spelt(tmp_path, (f"sequence: {GIVEN}", "sequence: own")).rename(tmp_path / "own.yaml")
    before = path.read_bytes()
    monkeypatch.setattr(command, "proposed", lambda *_: shipped())
    with pytest.raises(InputError) as error:
        command.plan(request(Path("own.yaml"), path))
    assert error.value.code == "B-DES-001"
    assert path.read_bytes() == before
