"""Campaigns of single gyroscopes, killed and gone on with: every record is there once, a replay says the same."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from rehearsal import SEED, Crashes, Watched, crashed_at, go_on, nobody, watch_worlds

from bench.model.clock import VirtualClock
from bench.plan import Plan, compile_sequence
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from bench.session.service import read_view
from bench.session.view import analyse_view

CAMPAIGNS = {
    "fog_north": {
        "warm_up": "1 s", "time_constant": "300 ms", "settle": "6 s", "record_time": "1 s", "calibration": "1",
        "repeats": "1", "heads": "90 deg", "search": "1",
    },
    "rlg_lock_in": {"warm_up": "5 s", "record_time": "2 s", "paths": "15 cm", "clocks": "20 MHz,100 MHz"},
}  # fmt: skip
WHERE_SHOWN = ("quantisation_noise", "bias_instability", "bias_alignment_error")  # where they stand out of the walk
KILLED_AT = {"fog_north": (5,), "rlg_lock_in": (1,)}  # indexes of records


def places(plan: Plan, name: str) -> list[int]:
    """Step numbers: at the record, and at the first step behind the record before it."""
    records = [step.number for step in plan.phase("campaign") if step.kind == "record"]
    return [number for at in KILLED_AT[name] for number in (records[at], records[at - 1] + 1)]


@pytest.fixture(scope="module", params=CAMPAIGNS)
def killed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    plan = compile_sequence(request.param, None, CAMPAIGNS[request.param])
    return crashed_at(plan, tmp_path_factory.mktemp(request.param), set(places(plan, request.param)))


def names_of(folder: Path) -> dict[str, float]:
    results, _ = analyse_view(read_view(folder))
    return {
        f"{one['quantity']} {json.dumps(one['conditions'], sort_keys=True)}": one["value"]
        for one in results["estimates"]
        if one["quantity"] not in WHERE_SHOWN
    }


@pytest.mark.slow
def test_a_killed_campaign_is_gone_on_with_and_replays_identically(
    killed: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = killed.plan.name
    whole = names_of(killed.whole)
    for number in places(killed.plan, name):
        source = killed.at(number)
        folder = Path(shutil.copytree(source, tmp_path / str(number) / source.name))
        watch_worlds(monkeypatch, watched := nobody())
        run = go_on(folder, watched)
        assert run.outcome.error is None, number
        assert run.outcome.unsafe == ()
        assert [row.window.number for row in read_view(folder).rows] == list(range(1, killed.plan.record_count + 1))
        assert not any(row.lost for row in read_view(folder).rows), number
        found = names_of(folder)
        assert found.keys() == whole.keys(), number
        assert not watched.worlds[-1].instruments["supply"].on
    assert found == names_of(folder)


def test_same_seed_same_bytes(killed: Crashes, tmp_path: Path) -> None:
    """The run that was copied on its way, and another one."""
    run = conduct(
        killed.plan, clock=VirtualClock(), seed=SEED, out=tmp_path, operator=SimulatedOperator(),
        listener=Watched(lambda world, step: None, worlds=[None]),  # type: ignore[list-item]
    )  # fmt: skip
    assert run.outcome.error is None
    first, again = ((folder / "session.0001.mcap").read_bytes() for folder in (killed.whole, run.folder))
    assert first == again
