"""A make-up sequence reads the values of the session under the same names, so that both are one."""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml
from plan_sample import ROOT

from bench.model.quantities import QUANTITY
from bench.plan import PlannedRecord, check_plan, compile_sequence
from bench.session.makeup import make_up_sequence
from bench.session.record_states import MISSING, RecordState

LAB = ROOT / "examples/own_checks"


def test_names_of_values_survive(tmp_path: Path) -> None:
    lab = shutil.copytree(LAB, tmp_path / "lab")
    plan = compile_sequence(lab / "sequences/linearity.yaml")
    records = [step for step in plan.steps if isinstance(step, PlannedRecord)]
    text, made_up, _ = make_up_sequence(plan, [RecordState(step, None, MISSING) for step in records])
    assert made_up == len(records)
    path = lab / "sequences/again.yaml"
    path.write_text(f"sequence: again\n{text}" if "sequence" not in yaml.safe_load(text) else text)
    again = compile_sequence(path)
    assert check_plan(again) == []
    names = {
        call.conditions[QUANTITY] for step in again.steps if isinstance(step, PlannedRecord) for call in step.calls
    }
    assert names == {"input", "output"}
    assert again.campaign["expected"] == plan.campaign["expected"]
