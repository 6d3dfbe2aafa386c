"""Whole campaigns of ring lasers by the command, against the simulated truth; the analysis reads the records alone."""

from __future__ import annotations

import json
import math
import resource
from pathlib import Path
from typing import Any

import pytest
from one_estimate import value
from rehearsal import Inside, bench

SEED = 41


def run(out: Path, sequence: str, *settings: str, command: Inside = bench) -> tuple[Path, dict[str, Any], Path]:
    """Folder, results and truth of one run."""
    words = [word for one in settings for word in ("--set", one)]
    done = command("run", sequence, "--truth", "--seed", str(SEED), "--out", str(out), *words)
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


@pytest.mark.sweep
def test_the_claim_is_conditional_on_the_backscatter_phase(tmp_path: Path) -> None:
    """Parabolas help at 90 deg and do harm at 0 and 20 deg; the global fit does not care."""
    _, results, _ = run(tmp_path, "rlg_backscatter")
    for phase_deg in (0.0, 20.0):
        assert ratio(results, "parabolas", phase_setting_deg=phase_deg) > 1.2
    assert ratio(results, "parabolas", phase_setting_deg=90.0) < 0.8
    assert ratio(results, "dither_shape", phase_setting_deg=90.0) < ratio(
        results, "dither_shape", phase_setting_deg=20.0
    )
    for phase_deg in (0.0, 20.0, 40.0, 60.0, 75.0, 90.0):
        assert ratio(results, "global_constants", phase_setting_deg=phase_deg) < 0.1
    assert any("WORSE" in one for one in results["notes"])
