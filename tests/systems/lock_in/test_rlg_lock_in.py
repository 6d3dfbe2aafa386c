"""Whole campaigns of single gyroscopes by the command, against the simulated truth; killed and gone on with."""

import json
import math
import resource
import shutil
from pathlib import Path
from typing import Any

import pytest
from one_estimate import value
from rehearsal import Crashes, Inside, bench, crashed_at, go_on, nobody, watch_worlds

from bench.plan import Plan, compile_sequence
from bench.session.service import read_view
from bench.session.view import analyse_view

pytestmark = pytest.mark.usefixtures("without_pictures")

TRUTH_SEED = 41


def run(out: Path, sequence: str, *settings: str, command: Inside = bench) -> tuple[Path, dict[str, Any], Path]:
    """Folder, results and truth of one run."""
    words = [word for one in settings for word in ("--set", one)]
    done = command("run", sequence, "--truth", "--seed", str(TRUTH_SEED), "--out", str(out), *words)
    assert done.returncode == 0, done.stdout + done.stderr
    (results,) = out.glob(f"*{sequence}*/results.json")
    (truth,) = out.glob(f"*{sequence}*.truth.json")
    return results.parent, json.loads(results.read_text("utf-8")), truth


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


def ratio(results: dict[str, Any], method: str, **place: Any) -> float:
    """Random walk behind a compensator over that before it."""
    return value(results, "random_walk_ratio", method=method, **place)


@pytest.mark.slow
def test_a_short_campaign_and_the_same_without_its_truth(tmp_path: Path, inside: Inside) -> None:
    """One path, one clock, 4 s: the constants are those of the simulated laser; deleting the truth changes nothing."""
    folder, results, truth = run(
        tmp_path, "rlg_lock_in", "record_time=4 s", "paths=28 cm", "clocks=100 MHz", "warm_up=4 s", command=inside
    )
    errors = against_truth(results, json.loads(truth.read_text("utf-8")))
    assert {"lock_in_rate", "backscatter_phase", "angle_random_walk"} <= set(errors)
    assert all(abs(off) < 5.0 for found in errors.values() for off in found), errors
    assert ratio(results, "global_constants", path_length_m=0.28) < 0.1
    truth.unlink()
    again = inside("fit", str(folder), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["estimates"] == results["estimates"]


@pytest.mark.sweep
def test_the_whole_campaign(tmp_path: Path) -> None:
    """Three paths, two clocks, 20 s: theory, exponent and ratios of the paper at a backscatter phase of 90 deg."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _, results, truth = run(tmp_path, "rlg_lock_in")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{cpu_s:.0f} s of CPU, {after.ru_maxrss / 1e6:.2f} GB")
    assert cpu_s < 6 * 30.0
    assert after.ru_maxrss < 1e6 or after.ru_maxrss == before.ru_maxrss  # the most of any child so far
    true, found = by_place(json.loads(truth.read_text("utf-8"))), by_place(results)
    for place, one in found.items():
        if place[0] == "angle_random_walk" and dict(place[1:])["method"] == "raw":
            print(place, one["value"] / true[place]["value"])
            assert one["value"] == pytest.approx(true[place]["value"], rel=0.08)
        if place[0] == "path_length_exponent" and dict(place[1:])["method"] == "raw":
            print(place, one["value"])
            assert one["value"] == pytest.approx(-2.5, abs=0.15)
    for path_m in (0.15, 0.28, 0.34):
        for clock_Hz, low, high in ((100e6, 0.25, 0.40), (20e6, 0.28, 0.52)):
            joint = ratio(results, "dither_shape", path_length_m=path_m, clock_Hz=clock_Hz)
            print(path_m, clock_Hz, joint)
            assert low < joint < high
            quantum = true["quantum_random_walk", ("clock_Hz", clock_Hz), ("path_length_m", path_m)]["value"]
            lock_in = true["angle_random_walk", ("clock_Hz", clock_Hz), ("method", "raw"), ("path_length_m", path_m)]
            place = ("clock_Hz", clock_Hz), ("method", "global_constants"), ("path_length_m", path_m)
            left, expected = found["random_walk_ratio", *place], math.hypot(quantum / lock_in["value"], 0.005)
            print(left["value"] / expected, left["std_uncertainty"] / expected)
            # 0.06 to 0.12 of it is what 20 s leave unknown; at 34 cm and 20 MHz that alone is more than 20 % in 1 of 12
            assert abs(left["value"] - expected) < max(0.2 * expected, 3.0 * left["std_uncertainty"])
        assert ratio(results, "fresnel", path_length_m=path_m, clock_Hz=100e6) < 0.1  # 0.07 and the quantum noise
    assert not [one for one in results["notes"] if one.startswith("No result")]
    errors = against_truth(results, json.loads(truth.read_text("utf-8")))
    for quantity in ("lock_in_rate", "backscatter_phase"):
        rms = math.sqrt(sum(off**2 for off in errors[quantity]) / len(errors[quantity]))
        print(quantity, rms)
        assert rms < 2.5


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
