"""The calibration of a GNC module that ``bench plan`` makes of the given one, and the lengths of a plan's records."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from doubt_gnc import Form
from rehearsal import ROOT

from bench.plan import Plan, PlannedCall, PlannedRecord, compile_sequence
from bench.session.designed import problem_of
from bench.systems.gnc.calibration.design import Calibrations, Candidate

GIVEN = "gnc_imu_calibration"
SHORTEST = Candidate(check_s=20.0, turn_s=20.3, turns=3), 300.0  # what 'bench plan gnc_imu_calibration' finds


@cache
def given() -> Plan:
    return compile_sequence(ROOT / "sequences" / f"{GIVEN}.yaml", None, {})


@cache
def written() -> Plan:
    """Return the shortest calibration as it is written and compiled again."""
    problem: Calibrations | Any = problem_of(given(), None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shorter.yaml"
        path.write_text(problem.written(*SHORTEST, "shorter", ["Shorter."]), encoding="utf-8")
        return compile_sequence(path, None, {})


def form_of(plan: Plan) -> Form:
    """Return the lengths of the records of a plan, and how its table turns."""
    steps = plan.phase("campaign")
    records = [step for step in steps if isinstance(step, PlannedRecord)]
    first_s, *_, last_s = (step.seconds for step in records if step.conditions["item"] == "position")
    before_s, after_s, *_ = (step.seconds for step in records if step.conditions["item"] == "rotation")
    turn = next(step.arguments for step in steps if isinstance(step, PlannedCall) and step.name == "turn")
    moving_s = turn["angle"] / turn["rate"] + turn["rate"] / turn["acceleration"]
    return Form((first_s, last_s), before_s + after_s, moving_s, turn["angle"], magnetic=False, of_a_plan=True)
