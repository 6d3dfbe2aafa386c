"""Where a prompt is answered: at the bench unless the sequence says anywhere."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import changed, make_bench, mistakes

from bench.plan import PlannedPrompt, compile_sequence, plan_json, steps_of

ASKED = "prompt: {text: earth, value: {unit: ohm, high: 0.5 ohm}}"
ROOT = Path(__file__).resolve().parents[3]


def prompt_of(folder: Path, text: str) -> PlannedPrompt:
    plan = compile_sequence(make_bench(folder, changed(ASKED, f"prompt: {text}")))
    read = steps_of(plan_json(plan.steps))
    assert list(read) == list(plan.steps)
    return next(step for step in read if isinstance(step, PlannedPrompt))


@pytest.mark.parametrize(
    ("text", "presence", "told"),
    [
        ("earth", "bench", {}),
        ("{text: earth, presence: bench}", "bench", {}),
        ("{text: earth, presence: anywhere}", "anywhere", {"presence": "anywhere"}),
    ],
)
def test_the_bench_is_the_default_and_not_written(tmp_path: Path, text: str, presence: str, told: object) -> None:
    """A plan without the word has the same bytes, and so the same hash, as before there was one."""
    step = prompt_of(tmp_path, text)
    assert step.presence == presence
    assert step.told() == {"text": "earth", "confirm": "operator", **told}  # type: ignore[dict-item]


@pytest.mark.parametrize("text", ["{text: earth, presence: phone}", "{text: e, sets: {unit: A}, presence: anywhere}"])
def test_what_cannot_be_is_refused(tmp_path: Path, text: str) -> None:
    (found,) = mistakes(make_bench(tmp_path, changed(ASKED, f"prompt: {text}")))
    assert found.code in ("B-YAML-013", "B-YAML-012")
    assert "presence" in str(found)


def test_every_shipped_prompt_is_answered_at_the_bench() -> None:
    """They concern wiring, mounting, doors and switches."""
    for path in sorted((ROOT / "sequences").glob("*.yaml")):
        assert "presence:" not in path.read_text(encoding="utf-8"), path.name
