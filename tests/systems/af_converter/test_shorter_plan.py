"""The shipped shorter campaign: what ``bench plan`` made of that of 38 hours, held against truth and wrong worlds.

Counts are those of the physics of ``fit_simulation`` at the planned times; one channel of each kind stands for all that
are alike.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import doubt_scale_factor as wrong
import fit_simulation as sim
import numpy as np
import pytest
from doubt_classes import Seen, sorted_classes
from scipy import stats
from trials import without_budgets

from bench.analysis import Analysis, Material, build_results
from bench.cli import main
from bench.design import default_targets, reached
from bench.design.shortest import misses
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.plan import Plan, PlannedRecord, PlannedSoak, check_plan, compile_sequence
from bench.session.designed import Asked, problem_of, proposed
from bench.session.predicted import predicted
from bench.systems.af_converter.scale_factor.analysis import analyse
from bench.systems.af_converter.scale_factor.design.campaign import Campaigns, Candidate
from bench.systems.af_converter.scale_factor.design.template import template_of

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
_UNIT_LAG_s, _LEFT_degC = 1500.0, 0.43  # what is left of a soak when its slot ends


def planned_records(name: str, channels: tuple[int, ...] = (1, 7)) -> list[tuple[PlannedRecord, float]]:
    """Return the measuring records of some channels of a shipped sequence, each with the end of the soak before it."""
    plan = compile_sequence(SEQUENCES / f"{name}.yaml", None, {})
    records, arrived_s = [], 0.0
    for step in plan.phase("campaign"):
        if isinstance(step, PlannedSoak):
            arrived_s = step.at_s + step.duration_s
        elif isinstance(step, PlannedRecord) and step.conditions["channel"] in channels:
            records.append((step, arrived_s))
    return records


def simulate_plan(
    seed: int,
    records: list[tuple[PlannedRecord, float]],
    world: sim.World | None = None,
) -> sim.SimulatedCampaign:
    """Return one campaign of the planned records, seeded."""
    world, switches, rng = world or sim.World(), sim.Switches(), np.random.default_rng(seed)
    bench = sim._Bench(rng, switches)
    kinds = {step.conditions["channel"]: step.conditions["kind"] for step, _ in records}
    units = {channel: sim._unit(rng, kind, switches) for channel, kind in kinds.items()}
    leak = rng.uniform(-1e-10, 1e-10, 2) * bench.on
    walk = sim._Walk(rng, switches.noise)
    rows: list[sim.Row] = []
    biases_A: dict[tuple[int, float], float] = {}
    length_s = records[-1][0].at_s + records[-1][0].seconds
    for step, arrived_s in records:
        at = place_of(step, length_s)
        left = _LEFT_degC * float(np.exp(-(step.at_s - arrived_s) / _UNIT_LAG_s))
        unit_degC, unit = at.nominal_degC - left, units[at.channel]
        bias_A = unit.bias(unit_degC) + walk.at(step.at_s, at.channel)
        biases_A.setdefault((at.channel, at.nominal_degC), bias_A)
        bench.drift = world.gain(at)
        net_A = world.input_A(bench.input_A(at.step, leak), at) - bias_A
        net_A += rng.normal(0, switches.white_A_rtHz / np.sqrt(2.0 * step.seconds))
        counts = world.counted(bench.counts(net_A, unit, unit_degC, step.seconds), at)
        rows.append(row_of(len(rows) + 1, step, at, counts, world.sensed_degC(unit_degC)))
    campaign, standards = sim.manifest(kinds)
    clocks = bench.af_error, bench.master_error
    return sim.SimulatedCampaign(rows, units, bench.gain, *clocks, campaign, standards, biases_A, drift=0.0)


def place_of(step: PlannedRecord, length_s: float) -> sim.Place:
    """Return where a campaign of this length is in a record."""
    given: Any = step.conditions
    what = given["route"], abs(given["current_A"] or 0.0), given["polarity"], given["range_A"]
    return sim.Place(step.at_s / length_s, given["channel"], given["temperature_degC"], given["repeat"], what)


def row_of(number: int, step: PlannedRecord, at: sim.Place, counts: dict[str, float], unit_degC: float) -> sim.Row:
    npp, ppp = np.zeros(10), np.zeros(10)
    npp[at.channel - 1], ppp[at.channel - 1] = counts["n"], counts["p"]
    begin_ns = round(step.at_s * NS)
    sums = {
        "npp": npp,
        "ppp": ppp,
        "af_clock": np.float64(counts["af"]),
        "fg_count": np.float64(counts["fg"]),
        "master_count": np.int64(round(step.seconds * sim.MASTER_Hz)),
    }
    window = sim.Window(number, dict(step.conditions), begin_ns, begin_ns + round(step.seconds * NS))
    return sim.Row(window, sums, {"unit_temperature_degC": unit_degC})


GIVEN, SHORTER = "scale_factor_38h", "scale_factor_26h"
LAG_s = 27.0 * 60.0
CAMPAIGNS = 100


@cache
def plan_of(name: str) -> Plan:
    return compile_sequence(SEQUENCES / f"{name}.yaml", None, {})


@cache
def problem() -> Campaigns:
    found: Any = problem_of(plan_of(GIVEN), LAG_s)
    return found


@cache
def shipped() -> tuple[Candidate, float]:
    """Return the shipped plan as the search sees it."""
    template = template_of(plan_of(SHORTER))
    return Candidate(tuple(template.levels_A), template.stops, template.again, by_lag=True), template.dwell_s


@pytest.mark.validates(
    "campaign of 38 h in 26 h: random parts, asymmetry and temperature coefficients no worse",
    against="the prediction of the fit for both compiled sequences",
)
def test_the_shorter_plan_reaches_what_the_given_one_does(record_property: Any) -> None:
    plan = plan_of(SHORTER)
    assert check_plan(plan) == []
    record_property("obtained", f"{plan.duration_s / 3600.0:.2f} h")
    assert plan.duration_s <= 26.0 * 3600.0
    known, found = (reached(predicted(each).estimates) for each in (plan_of(GIVEN), plan))
    targets = default_targets(problem().wanted, known)
    assert len(targets) == 14
    print({target.key.name: f"{target.reached(found) / target.U:.3f}" for target in targets})
    assert misses(targets, found) == []


def test_what_the_search_sees_is_what_is_compiled() -> None:
    candidate, length_s = shipped()
    plan = plan_of(SHORTER)
    assert problem().duration_s(candidate, length_s) == pytest.approx(plan.duration_s, abs=1e-6)
    ours, theirs = reached(problem().estimates(candidate, length_s)), reached(predicted(plan).estimates)
    for key in (key for key in theirs if key[:2] in problem().wanted):
        assert ours[key] == pytest.approx(theirs[key], rel=1e-4), key
    for key, U in problem().at_least(candidate, length_s).items():
        assert 0.9 * theirs[key] <= U <= theirs[key], key


def test_the_rules_hold_and_break() -> None:
    candidate, length_s = shipped()
    assert problem().broken(candidate, length_s) == []
    levels_A = (3e-5, 1e-3, 0.2), candidate.levels_A[1]
    blind = {
        "one direction": replace(candidate, stops=tuple(sorted(candidate.stops))),
        "closing": replace(candidate, stops=candidate.stops[:-1]),
        "soft end": replace(candidate, levels_A=levels_A),
        "one step of the calibrator": replace(candidate, again=((1,), (1,))),
    }
    for word, each in blind.items():
        assert any(word in sentence for sentence in problem().broken(each, length_s)), word


def test_no_record_is_so_long_that_a_channel_gets_warmer() -> None:
    candidate, length_s = shipped()
    longest_s = problem().lengths_s(candidate)[-1]
    assert length_s <= longest_s
    heat_A2 = [2.0 * math.fsum(level_A**2 for level_A in levels_A) for levels_A in candidate.levels_A]
    given_A2 = [2.0 * math.fsum(level_A**2 for level_A in levels_A) for levels_A in problem().today[0].levels_A]
    assert longest_s == math.floor(min(100.0 * given / now for given, now in zip(given_A2, heat_A2, strict=True)))


@pytest.mark.slow
@pytest.mark.validates(
    "campaign of 26 h: stated intervals hold the truth", against="100 simulated campaigns with physics of their own"
)
def test_stated_intervals_hold_the_truth(record_property: Any) -> None:
    """Seeds 0 to 99. The values of a campaign share errors, so that it counts once for each quantity and kind."""
    records = planned_records(SHORTER)
    inside: dict[tuple[str, str], list[bool]] = {}
    for seed in range(CAMPAIGNS):
        campaign = simulate_plan(seed, records)
        first: set[tuple[str, str]] = set()
        for entry in judged_entries(analysed(campaign).estimates):
            place = (entry["quantity"], entry["conditions"].get("kind", ""))
            if place not in first:
                first.add(place)
                error = abs(entry["value"] - campaign.truth(entry))
                inside.setdefault(place, []).append(error <= entry["expanded_uncertainty"])
    low, high = stats.binom.interval(0.999, CAMPAIGNS, 0.95)
    counts = {place: sum(held) for place, held in inside.items()}
    print(f"of {CAMPAIGNS} campaigns, {low:g} to {high:g} are due: {counts}")
    record_property("obtained", f"{min(counts.values())} to {max(counts.values())} of {CAMPAIGNS}")
    assert len(counts) == 18
    assert all(low <= count <= high for count in counts.values())


def analysed(campaign: sim.SimulatedCampaign) -> Analysis:
    """Return the analysis without the budgets, which nothing here reads."""
    with without_budgets():
        return analyse(Material(campaign.rows, campaign.campaign, campaign.standards))


def judged_entries(estimates: Any) -> list[Any]:
    return [one for one in estimates if one["quantity"] in wrong.QUANTITIES and "repeat" not in one["conditions"]]


def seen(records: Any, seed: int, world: Any) -> Seen:
    """Return what a campaign states in a world, and its truth."""
    campaign = simulate_plan(seed, records, world=world)
    document = build_results("doubt", analysed(campaign), {"records": len(campaign.rows)}, wrong.PROVENANCE)
    entries = judged_entries(document["estimates"])
    return Seen(entries, [campaign.truth(entry) for entry in entries], 0.0, 1, wrong._promised(campaign))


@pytest.mark.parametrize(("world", "told"), [(wrong.CalibratorStep(1e-5), True), (wrong.CalibratorDrift(1e-5), False)])
def test_a_step_of_the_calibrator_is_told_from_a_steady_drift(world: Any, told: bool) -> None:
    """Of 10 ppm, seed 0: the visits in the middle and at the end lie on a line, or they do not."""
    analysis = analysed(simulate_plan(0, planned_records(SHORTER), world=world))
    (heard,) = (seen for seen in analysis.evidence if seen.code == "unsteady_drift")
    print(heard.sentence, heard.probability)
    assert (heard.probability < 1e-9) == told
    assert (heard.move > 1.0) == told
    assert "dsf_n_tc1" in heard.quantities


class FirstOfRange(wrong.DielectricTail):
    """The tail at the smallest level of each range that a plan uses, whichever that is."""

    def __init__(self, size: float, levels_A: list[float]) -> None:
        super().__init__(size)
        firsts = {min(level for level in levels_A if (level > 2.2e-3) == large) for large in (False, True)}
        object.__setattr__(self, "firsts", firsts)  # of a frozen class

    def input_A(self, current_A: float, at: Any) -> float:
        hit = self.of_channel(at) and at.step[2] == 1 and at.step[1] in self.firsts  # type: ignore[attr-defined]
        return current_A * (1.0 - self.size) if hit else current_A


@pytest.mark.slow
@pytest.mark.parametrize("switch", wrong.SWITCHES, ids=lambda switch: switch.name)
def test_no_wrong_world_is_believed_that_the_given_plan_tells(monkeypatch: pytest.MonkeyPatch, switch: Any) -> None:
    """Seeds 0 and 1 of each size. What no data can show, an assumption names: it may put more values off where it puts
    off some already, since the uncertainties are smaller now; nothing else may.
    """
    monkeypatch.setattr(wrong, "WRONG", 7)
    for size in switch.sizes:
        counted = {}
        for name in (GIVEN, SHORTER):
            records = planned_records(name)
            levels_A = [step.conditions["current_A"] for step, _ in records if step.conditions["channel"] == 7]
            first = switch.name == "first_of_a_range"
            world = FirstOfRange(size, [level for level in levels_A if level]) if first else switch.world(size)
            pairs = ((seen(records, seed, world), seen(records, seed, None)) for seed in (0, 1))
            counted[name] = sum((sorted_classes(*pair) for pair in pairs), Counter())
        print(f"{switch.name} {size:g}: {dict(counted[GIVEN])} before, {dict(counted[SHORTER])} now")
        before, now = (counted[name]["confidently_wrong"] for name in (GIVEN, SHORTER))
        assert now <= before or (switch.assumption and before)


def test_what_cannot_be_planned_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    cases = {
        ("plan", "rlg_lock_in"): "B-DES-003",
        ("plan", "scale_factor_short"): "B-DES-004",
        ("plan", GIVEN, "--target", "dsf_n=15ppm"): "B-DES-002",
        ("plan", GIVEN, "--target", "dsf_n"): "B-DES-001",
        ("plan", GIVEN, "--within", "26"): "'26 h'",
        ("plan", GIVEN, "--lag", "0 min"): "'27 min'",
        ("plan", "gnc_imu_calibration", "--lag", "27 min"): "nothing in gnc_imu_calibration waits for a lag",
    }
    for words, code in cases.items():
        monkeypatch.setattr("sys.argv", ["bench", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert code in capsys.readouterr().err, words


def test_targets_that_no_plan_reaches_and_plans_of_another_form_are_refused(tmp_path: Path) -> None:
    for lag_s in (LAG_s, None):
        with pytest.raises(InputError) as error:
            proposed(plan_of(GIVEN), Asked(["dsf_n.random=1e-6ppm"], None, lag_s))
        assert error.value.code == "B-DES-006"
        assert ("--lag" in error.value.next_step) == (lag_s is None)
    text = (SEQUENCES / f"{GIVEN}.yaml").read_text(encoding="utf-8").replace('seconds: "{dwell}"', "seconds: 100 s")
    path = tmp_path / "other.yaml"
    text = text.replace(f"sequence: {GIVEN}", "sequence: other").replace("  dwell: 100 s\n", "")
    path.write_text(text, encoding="utf-8")
    other: Any = problem_of(compile_sequence(path, None, {}), LAG_s)
    with pytest.raises(InputError) as error:
        other.written(*shipped(), "shorter", [])
    assert error.value.code == "B-DES-005"
