"""Soaks that the lag of the unit may end: what a sequence may say of them, and what a plan has of them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from plan_sample import changed, make_bench, mistakes

from bench.commands import check as command
from bench.commands.requests import CheckRequest
from bench.plan import PlannedSoak, compile_sequence
from bench.plan.step_kinds import plan_json, steps_of
from bench.session.makeup import _written

SLOT = "slot: 570 s"
DONE = f"{SLOT}, done: {{residual: 0.1 degC, least: 400 s}}"


def soaks(path: Path) -> list[PlannedSoak]:
    return [step for step in compile_sequence(path).steps if isinstance(step, PlannedSoak)]


def test_a_plan_says_how_near_and_not_before_when(tmp_path: Path) -> None:
    path = make_bench(tmp_path, changed(SLOT, DONE))
    assert mistakes(path) == []
    (soak,) = soaks(path)
    assert (soak.residual_degC, soak.least_s, soak.duration_s) == (0.1, 400.0, 570.0)
    steps = compile_sequence(path).steps
    assert steps_of(plan_json(steps)) == steps
    (plain,) = soaks(make_bench(tmp_path))
    assert {"residual", "least"}.isdisjoint(plain.told()), "a plan without it keeps its hash"


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        (SLOT, DONE.replace("400 s", "571 s"), "least"),
        (SLOT, DONE.replace("0.1 degC", "0 degC"), "residual"),
        ("slot: 570 s, stable: {within: 1 degC, for: 5 min}",
         f"{DONE}, stable: {{within: 1 degC, for: 5 min, sensor: air}}", "the soak is judged by the air"),
        ("finally:\n", "finally:\n  - soak: {temperature: 23 degC, ramp: 0.5 degC/min, slot: 600 s, "
         "stable: {within: 1 degC, for: 5 min}, done: {residual: 0.1 degC, least: 400 s}}\n", "never shortened"),
    ],
)  # fmt: skip
def test_what_cannot_end_a_soak_is_one_mistake(tmp_path: Path, old: str, new: str, place: str) -> None:
    found = mistakes(make_bench(tmp_path, changed(old, new)))
    assert [error.code for error in found] == ["B-PLAN-156"]
    assert place in f"{found[0]}"


def test_the_check_says_that_its_times_are_the_longest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text, said in ((changed(SLOT, DONE), True), (changed(SLOT, SLOT), False)):
        path = make_bench(tmp_path, text)
        command.check(CheckRequest(str(path)))
        assert ("times are the longest" in capsys.readouterr().out) == said


def test_a_soak_that_is_made_up_for_is_written_as_it_was(tmp_path: Path) -> None:
    plan = compile_sequence(make_bench(tmp_path, changed(SLOT, DONE)))
    (soak,) = (step for step in plan.steps if isinstance(step, PlannedSoak))
    assert yaml.safe_load(_written(plan, soak))["soak"]["done"] == {"residual": "0.1 degC", "least": "400.0 s"}
