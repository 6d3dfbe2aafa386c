"""The bias ramp that ``bench plan`` makes of that of 25 hours, and ramps simulated by the rates and holds of a plan."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import Any

import bias_simulation
import numpy as np
import pytest

from bench.plan import Plan, PlannedCall, PlannedRecord, compile_sequence
from bench.session.designed import problem_of
from bench.systems.af_converter.bias_ramp.design.campaign import Candidate, Ramps

GIVEN = "bias_ramp_25h"
SHORTEST = Candidate((10, 12), (72, 42, 60))  # what 'bench plan bias_ramp_25h' finds, in 23.2 h


@cache
def given() -> Plan:
    return compile_sequence(GIVEN, None, {})


@cache
def problem() -> Ramps:
    found: Any = problem_of(given(), None)
    return found


@cache
def written(candidate: Candidate = SHORTEST) -> Plan:
    """Return a ramp as it is written and compiled again."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shorter.yaml"
        path.write_text(problem().written(candidate, problem().today[1], "shorter", ["Shorter."]), encoding="utf-8")
        return compile_sequence(path, None, {})


@contextmanager
def simulated_as(plan: Plan) -> Iterator[None]:
    """Give the ramps of ``bias_simulation`` the windows of a plan and the rates of its chamber."""
    steps = plan.phase("campaign")
    counted = Counter(str(step.conditions["branch"]) for step in steps if isinstance(step, PlannedRecord))
    points = [step.set_point for step in steps if isinstance(step, PlannedCall) and step.set_point is not None]
    up_h, down_h = (1.0 / point.ramp_degC_min for point in points)  # 60 degC
    counts = [counted[branch] for branch, _ in bias_simulation.BRANCHES]
    hours = [count * bias_simulation.GATE_s / 3600.0 for count in counts]
    begin_h, up, _, down, _, end_h = accumulate(hours, initial=bias_simulation.PREPARATION_h)
    corners_h = [*bias_simulation.CORNERS_h[:2], begin_h, up, up + up_h, down, down + down_h, end_h]
    branches = tuple((name, count) for (name, _), count in zip(bias_simulation.BRANCHES, counts, strict=True))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bias_simulation, "CORNERS_h", np.array(corners_h))
        patch.setattr(bias_simulation, "BRANCHES", branches)
        bias_simulation.heat.cache_clear()
        try:
            yield
        finally:
            bias_simulation.heat.cache_clear()
