"""Whole campaigns of single gyroscopes by the command, against the simulated truth; killed and gone on with."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from one_estimate import value
from rehearsal import Crashes, Inside, crashed_at, go_on, nobody, watch_worlds

from bench.plan import Plan, compile_sequence
from bench.session.service import read_view
from bench.session.view import analyse_view

pytestmark = pytest.mark.usefixtures("without_pictures")

TRUTH_SEED = 41
SHORT = ("record_time=4 s", "paths=28 cm", "clocks=100 MHz", "warm_up=4 s")


def by_place(document: dict[str, Any]) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Estimates by quantity and conditions."""
    return {(one["quantity"], *sorted(one["conditions"].items())): one for one in document["estimates"]}


def against_truth(results: dict[str, Any], truth: dict[str, Any]) -> dict[str, list[float]]:
    """By quantity: error of each estimate in its standard uncertainties."""
    true, found = by_place(truth), by_place(results)
    errors: dict[str, list[float]] = {}
    for place in true.keys() & found.keys():
        one = found[place]
        off = (one["value"] - true[place]["value"]) / one["std_uncertainty"]
        errors.setdefault(str(place[0]), []).append(off)
    return errors


@pytest.mark.slow
def test_a_short_campaign_and_the_same_without_its_truth(tmp_path: Path, inside: Inside) -> None:
    """One path, one clock, 4 s: the constants are those of the simulated laser; deleting the truth changes nothing."""
    words = ["--truth", "--seed", str(TRUTH_SEED), "--out", str(tmp_path)]
    done = inside("run", "rlg_lock_in", *words, *(word for one in SHORT for word in ("--set", one)))
    assert done.returncode == 0, done.stdout + done.stderr
    (path,), (truth,) = tmp_path.glob("*/results.json"), tmp_path.glob("*.truth.json")
    folder, results = path.parent, json.loads(path.read_text("utf-8"))
    errors = against_truth(results, json.loads(truth.read_text("utf-8")))
    assert {"lock_in_rate", "backscatter_phase", "angle_random_walk"} <= set(errors)
    assert all(abs(off) < 5.0 for found in errors.values() for off in found), errors
    assert value(results, "random_walk_ratio", method="global_constants") < 0.1
    truth.unlink()
    again = inside("fit", str(folder), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["estimates"] == results["estimates"]


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
