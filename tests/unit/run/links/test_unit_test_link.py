"""The link of a session of unit tests is pulled out in the middle of it: the run waits, and nothing is done twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from test_run_link_campaign import Watched, unplug

from bench.frame import load_frame
from bench.model.clock import VirtualClock
from bench.model.shipped import find_shipped
from bench.plan import compile_sequence
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from sim_instruments.worlds import simulation

ERASE = 1


@pytest.mark.parametrize("pulled_s", [6.0, 12.0, 14.5])
def test_a_run_of_unit_tests_waits_for_its_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pulled_s: float
) -> None:
    plan = compile_sequence("gnc_unit_test", None, {"units": "GNC-01"})
    watched, plain = (
        Watched([(pulled_s, unplug("rs422", True)), (pulled_s + 5, unplug("rs422", False))]),
        simulation.open_world,
    )
    monkeypatch.setattr(simulation, "open_world", lambda *a, **k: watched.begin(plain(*a, **k)))
    done = conduct(
        plan, clock=VirtualClock(), seed=5, out=tmp_path, operator=SimulatedOperator(), listener=watched,
        keep_events=("exchange", "hold", "link"),
    )  # fmt: skip
    assert done.outcome.error is None
    events: dict[str, list[Any]] = {kind: [f for k, _, f in done.events if k == kind] for kind in ("exchange", "link")}
    assert [one["state"] for one in events["link"]] == ["lost", "back"]
    tests = [step.number for step in plan.steps if step.kind == "unit"]
    assert [one["step"] for one in events["exchange"]] == tests
    assert {one["status"] for one in events["exchange"]} == {0}
    memory = load_frame(find_shipped("frames", "gnc_422")).commands["memory"]
    erased = [
        memory.decode(bytes.fromhex(one["received"]))["erases"]
        for one in events["exchange"]
        if one["name"] == "memory" and one["conditions"]["operation"] == ERASE
    ]
    assert erased == [1, 1]
