"""Verdicts of the residual after compensation, decision rules and their risk, counted proportions."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import fit_simulation as sim
import numpy as np
import pytest
from plan_sample import changed, make_bench, mistakes
from scipy import integrate, stats

from bench.analysis import Analysis, Material, analyse, build_results, estimate, judged, rule_of, validate_results
from bench.maths.verdict import RULES, Rule, clopper_pearson, conformance_probability, coverage_factor, decide
from bench.model.errors import FitError
from bench.plan import compile_sequence
from bench.plan.language.sequence import Decision

SEED = 5
RESIDUALS = ("dsf_n_residual", "dsf_p_residual")
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "1"}
U_ppm = 2.0 * math.sqrt(10.0**2 + 1.2**2 + 2.0**2)  # gain, fit and drift of the calibrator


def run(campaign: sim.SimulatedCampaign, **changes: Any) -> Analysis:
    return analyse(Material(campaign.rows, campaign.campaign | changes, campaign.standards))


def of(analysis: Analysis, *quantities: str) -> list[dict[str, Any]]:
    return [one for one in analysis.estimates if one["quantity"] in quantities]


def test_a_unit_that_a_parabola_describes_passes() -> None:
    analysis = run(sim.simulate(SEED, sim.Switches()))
    found = of(analysis, *RESIDUALS)
    assert len(found) == 2 * 2 * 5
    assert {one["verdict"] for one in found} == {"pass"}
    assert {(one["conditions"]["kind"], one["limit"]) for one in found} == {("gyro", 100.0), ("accelerometer", 200.0)}
    assert max(abs(one["value"]) for one in found) < 3.0
    assert all(one["expanded_uncertainty"] == pytest.approx(20.0, abs=0.5) for one in found)


def test_residual_is_what_an_independent_parabola_leaves_over() -> None:
    """Nearly equal weights: numpy's own polynomial through the same five values leaves nearly the same."""
    analysis = run(sim.simulate(SEED, sim.Switches(cubic_ppm_degC3=0.01)))
    for quantity in ("dsf_n", "dsf_p"):
        values = [one for one in of(analysis, quantity) if one["conditions"]["channel"] == 2]
        warmth = np.array([one["conditions"]["unit_temperature_degC"] for one in values]) - 20.0
        dsf_ppm = np.array([one["value"] for one in values])
        left_ppm = dsf_ppm - np.polynomial.polynomial.polyval(
            warmth, np.polynomial.polynomial.polyfit(warmth, dsf_ppm, 2)
        )
        found = [one["value"] for one in of(analysis, f"{quantity}_residual") if one["conditions"]["channel"] == 2]
        assert np.max(np.abs(left_ppm)) > 30.0
        np.testing.assert_allclose(found, left_ppm, atol=0.2)


@pytest.mark.parametrize(
    ("cubic", "verdict"), [(0.005, "pass"), (0.0113, "conditional_pass"), (0.0136, "conditional_fail"), (0.018, "fail")]
)
def test_what_compensation_leaves_over_is_judged(cubic: float, verdict: str) -> None:
    """The parabola through a cubic at five temperatures 15 degC apart leaves 2.4 * 15^3 = 8100 degC3 of it."""
    found = of(run(sim.simulate(SEED, sim.Switches(cubic_ppm_degC3=cubic), {1: "gyro"})), *RESIDUALS)
    worst = max(found, key=lambda one: abs(one["value"]))
    assert abs(worst["value"]) == pytest.approx(8100 * cubic, abs=3.0)
    assert worst["verdict"] == verdict


def test_one_temperature_that_is_off_fails() -> None:
    campaign = sim.simulate(SEED, sim.Switches())
    for row in campaign.rows:
        if row.window.conditions["temperature_degC"] == 20.0:
            row.sums["npp"] = row.sums["npp"] * (1 - 600e-6)
    found = of(run(campaign), "dsf_n_residual")
    assert {one["verdict"] for one in found if one["conditions"]["temperature_degC"] == 20.0} == {"fail"}
    assert {one["verdict"] for one in of(run(campaign), "dsf_p_residual")} == {"pass"}


def test_no_more_temperatures_than_coefficients_no_verdict() -> None:
    analysis = run(sim.simulate(SEED, sim.Switches(), temperatures=(-10.0, 20.0, 50.0)))
    assert of(analysis, "dsf_n_tc2") != []
    assert of(analysis, *RESIDUALS) == []
    assert {one["verdict"] for one in analysis.estimates} == {"none"}
    assert any(note.startswith("No verdict") for note in analysis.notes)


def test_without_a_limit_there_is_no_verdict() -> None:
    campaign = sim.simulate(SEED, sim.Switches())
    channels = copy.deepcopy(campaign.campaign["channels"])
    for channel in channels:
        del channel["stability_limit_ppm"]
    assert {one["verdict"] for one in of(run(campaign, channels=channels), *RESIDUALS)} == {"none"}


def test_zener_diode() -> None:
    """JCGM 106:2012, clause 7: -5.47 V, u = 0.05 V, at most -5.40 V: 0.92."""
    assert conformance_probability(-5.47, 0.05, -math.inf, -5.40) == pytest.approx(0.92, abs=0.005)


@pytest.mark.validates(
    "conformance probability, two limits",
    against="JCGM 106:2012 clause 7, motor oil: 0.66",
)
def test_motor_oil() -> None:
    """JCGM 106:2012, clause 7: 13.6 mm2/s, u = 1.8 mm2/s, between 12.5 and 16.3: 0.66."""
    assert conformance_probability(13.6, 1.8, 12.5, 16.3) == pytest.approx(0.66, abs=0.005)


@pytest.mark.validates(
    "conformance probability, one limit",
    against="JCGM 106:2012 clause 7, table",
)
@pytest.mark.parametrize(("p", "distance"), [(0.80, 0.84), (0.90, 1.28), (0.95, 1.64), (0.99, 2.33), (0.999, 3.09)])
def test_table_of_one_sided_probabilities(p: float, distance: float) -> None:
    """JCGM 106:2012, clause 7, the table of one-sided limits."""
    assert conformance_probability(0.0, 1.0, -math.inf, distance) == pytest.approx(p, abs=0.002)


@pytest.mark.validates(
    "conformance probability, normal and t",
    against="scipy.integrate.quad of the density",
)
@pytest.mark.parametrize("dof", [3.0, 10.5, math.inf])
@pytest.mark.parametrize("value", [0.0, 70.0, -99.0, 101.0, 250.0])
def test_probability_is_the_integral_of_the_density(value: float, dof: float) -> None:
    density = stats.norm.pdf if math.isinf(dof) else stats.t(dof).pdf
    area, _ = integrate.quad(lambda x: density((x - value) / 20.0) / 20.0, -100.0, 100.0, epsabs=1e-13)
    assert conformance_probability(value, 20.0, -100.0, 100.0, dof) == pytest.approx(area, abs=1e-10)


def test_probability_far_away_keeps_its_digits_and_is_no_less_than_zero() -> None:
    assert conformance_probability(200.0, 10.0, -100.0, 100.0) == pytest.approx(7.6198530e-24, rel=1e-6)
    assert conformance_probability(1e9, 1.0, -100.0, 100.0) == 0.0
    assert conformance_probability(100.0, 0.0, -100.0, 100.0) == 1.0
    assert conformance_probability(100.1, 0.0, -100.0, 100.0) == 0.0
    assert conformance_probability(math.nan, 1.0, -100.0, 100.0) == 0.0


@pytest.mark.parametrize(("limit_ppm", "accepted_ppm"), [(100.0, 79.5), (200.0, 179.5)])
def test_guard_band_of_the_design(limit_ppm: float, accepted_ppm: float) -> None:
    """U = 20.5 ppm (k = 2): a gyro channel is accepted up to 79.5 ppm, an accelerometer channel up to 179.5 ppm."""
    assert pytest.approx(20.5, abs=0.05) == U_ppm
    std = U_ppm / coverage_factor()
    for sign in (1.0, -1.0):
        assert decide(sign * (accepted_ppm - 0.05), std, limit_ppm, "guard_band").verdict == "pass"
        assert decide(sign * (accepted_ppm + 0.05), std, limit_ppm, "guard_band").verdict == "fail"


@pytest.mark.parametrize(
    ("value", "simple", "guard_band", "non_binary"),
    [
        (79.0, "pass", "pass", "pass"),
        (80.5, "pass", "fail", "conditional_pass"),
        (-99.9, "pass", "fail", "conditional_pass"),
        (100.1, "fail", "fail", "conditional_fail"),
        (119.9, "fail", "fail", "conditional_fail"),
        (-120.5, "fail", "fail", "fail"),
        (math.nan, "fail", "fail", "fail"),
    ],
)
def test_rules(value: float, simple: str, guard_band: str, non_binary: str) -> None:
    """ILAC-G8:09/2019 section 4.2 with a limit of 100 and U = 20."""
    std = 20.0 / coverage_factor()
    found = [decide(value, std, 100.0, rule).verdict for rule in ("simple", "guard_band", "non_binary")]
    assert found == [simple, guard_band, non_binary]


@pytest.mark.validates(
    "risk of a guard band w = U and of simple acceptance",
    against="ILAC-G8:09/2019: at most 2.5 % and up to 50 %",
)
def test_risk_at_the_edges_of_the_rules(record_property: Callable[[str, object], None]) -> None:
    """ILAC-G8:09/2019: accepted with w = U at most 2.5 % wrong, by simple acceptance up to 50 %."""
    std = 20.0 / coverage_factor()
    guarded = decide(80.0, std, 100.0, "guard_band")
    assert guarded.specific_risk == pytest.approx(0.025, abs=1e-9)
    assert decide(99.999, std, 100.0, "simple").specific_risk == pytest.approx(0.5, abs=1e-3)
    record_property("obtained", f"guard band {100 * guarded.specific_risk:.2f} %")
    refused = decide(120.001, std, 100.0, "non_binary")
    assert (refused.verdict, refused.specific_risk) == ("fail", pytest.approx(0.025, abs=1e-4))
    assert refused.specific_risk == refused.conformance_probability


def test_few_degrees_of_freedom_make_a_wider_guard_band() -> None:
    """u = 10 with 5 degrees of freedom: U = 25.7 (table G.2: k = 2.57), so 76 is no longer a pass."""
    assert decide(76.0, 10.0, 100.0, "guard_band").verdict == "pass"
    assert decide(76.0, 10.0, 100.0, "guard_band", dof=5).verdict == "fail"
    entry = estimate("dsf_n_residual", "ppm", 76.0, 10.0, {}, n=6, limit=100.0, dof=5)
    assert (entry["dof"], entry["verdict"]) == (5.0, "conditional_pass")
    assert entry["coverage_factor"] == pytest.approx(2.57, abs=0.002)
    expected = stats.t(5).cdf(2.4) - stats.t(5).cdf(-17.6)
    assert judged(entry, "simple")["conformance_probability"] == pytest.approx(expected, abs=1e-12)


def test_no_limit_no_statement() -> None:
    none = decide(5.0, 1.0, None)
    assert (none.verdict, none.conformance_probability, none.specific_risk) == ("none", None, None)
    assert estimate("bias", "A", 1.0, 1.0, {}, n=1)["conformance_probability"] is None


@pytest.mark.parametrize("rule", ["simple", "guard_band", "non_binary"])
def test_an_uncertainty_that_is_not_known_accepts_nothing(rule: str) -> None:
    found = decide(0.5, float("nan"), 1.0, rule)
    assert (found.verdict, found.conformance_probability, found.specific_risk) == ("fail", 0.0, 0.0)


def test_unknown_rule() -> None:
    with pytest.raises(FitError, match="'strict'") as caught:
        rule_of({"rule": "strict"})
    assert caught.value.code == "B-FIT-041"
    assert "guard_band" in caught.value.next_step
    assert (rule_of(None), rule_of({}), rule_of({"rule": "simple"})) == ("non_binary", "non_binary", "simple")


def test_the_rules_of_the_fit_the_plan_and_the_document_are_the_same() -> None:
    assert get_args(Rule) == RULES
    assert get_args(Decision.model_fields["rule"].annotation) == RULES


@pytest.mark.parametrize(
    ("line", "rule"),
    [("records: 3", "non_binary"), ("records: 3\ndecision: {rule: guard_band}", "guard_band"),
     ("records: 3\ndecision: {rule: simple}", "simple")],
)  # fmt: skip
def test_the_sequence_names_the_rule(tmp_path: Path, line: str, rule: str) -> None:
    path = make_bench(tmp_path, changed("records: 3", line))
    assert compile_sequence(path).campaign["decision"] == {"rule": rule}


def test_a_rule_that_is_none_is_refused_in_its_place(tmp_path: Path) -> None:
    text = changed("records: 3", "records: 3\ndecision: {rule: strict}")
    (mistake,) = mistakes(make_bench(tmp_path, text))
    assert mistake.code.startswith("B-YAML")
    assert "sample.yaml:9:" in mistake.where


def test_results_are_judged_by_the_rule_of_the_campaign() -> None:
    """A cubic of 0.0113 ppm/degC3 leaves about 91 ppm: a pass, a conditional pass or a fail, by rule."""
    campaign = sim.simulate(5, sim.Switches(cubic_ppm_degC3=0.0113), {1: "gyro"})
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    worst = {}
    for rule in (None, *RULES):
        document = build_results("s", analysis, {}, PROVENANCE, None if rule is None else {"rule": rule})
        judged_ones = [one for one in document["estimates"] if one["limit"] is not None]
        assert all(0.0 <= one["conformance_probability"] <= 1.0 for one in judged_ones)
        near = max(judged_ones, key=lambda one: abs(one["value"]))
        worst[rule] = (near["verdict"], document["decision_rule"])
        expected = stats.norm.cdf((100.0 - abs(near["value"])) / near["std_uncertainty"])
        assert near["conformance_probability"] == pytest.approx(expected, abs=1e-9)
    assert worst == {
        None: ("conditional_pass", "non_binary"),
        "simple": ("pass", "simple"),
        "guard_band": ("fail", "guard_band"),
        "non_binary": ("conditional_pass", "non_binary"),
    }


def test_results_of_version_0_1_stay_readable() -> None:
    campaign = sim.simulate(5, sim.Switches(), {1: "gyro"})
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    document = build_results("s", analysis, {}, PROVENANCE)
    del document["decision_rule"]
    for one in document["estimates"]:
        del one["conformance_probability"]
    validate_results(document)


@pytest.mark.parametrize("trials", [1, 2, 7, 20, 200])
def test_as_scipy_finds_it(trials: int) -> None:
    for successes in sorted({0, 1, trials // 2, trials - 1, trials}):
        for probability in (0.90, 0.95):
            due = stats.binomtest(successes, trials).proportion_ci(probability, "exact")
            assert clopper_pearson(successes, trials, probability) == pytest.approx((due.low, due.high), abs=1e-9)


def test_beyond_each_limit_the_count_has_the_remaining_probability() -> None:
    low, high = clopper_pearson(193, 200)
    assert stats.binom.sf(192, 200, low) == pytest.approx(0.025, abs=1e-9)
    assert stats.binom.cdf(193, 200, high) == pytest.approx(0.025, abs=1e-9)


def test_nothing_and_everything() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert clopper_pearson(200, 200)[1] == 1.0
    assert clopper_pearson(200, 200)[0] == pytest.approx(0.025 ** (1 / 200))
    with pytest.raises(ValueError, match="no proportion"):
        clopper_pearson(3, 2)
