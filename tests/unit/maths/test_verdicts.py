"""Verdicts and budgets: decision rules and their risk, limits on both sides, worked examples of the guides."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import fit_simulation as sim
import GTC
import numpy as np
import pytest
from plan_sample import changed, make_bench
from scipy import integrate, stats

from bench.analysis import Analysis, Material, analyse, build_results, estimate, judged, rule_of
from bench.maths.budget import Budget, Component, combine_all
from bench.maths.verdict import RULES, Rule, clopper_pearson, conformance_probability, coverage_factor, decide, verdict
from bench.model.errors import FitError
from bench.plan import compile_sequence
from bench.plan.language.sequence import Decision

SEED = 5
RESIDUALS = ("dsf_n_residual", "dsf_p_residual")
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "1"}
LIMITS_V = (4.9, 5.1)
U_ppm = 2.0 * math.sqrt(10.0**2 + 1.2**2 + 2.0**2)  # gain, fit and drift of the calibrator


def run(campaign: sim.SimulatedCampaign, **changes: Any) -> Analysis:
    return analyse(Material(campaign.rows, campaign.campaign | changes, campaign.standards))


def of(analysis: Analysis, *quantities: str) -> list[dict[str, Any]]:
    return [one for one in analysis.estimates if one.quantity in quantities]


def test_residual_is_what_an_independent_parabola_leaves_over() -> None:
    """Nearly equal weights: numpy's own polynomial through the same five values leaves nearly the same."""
    analysis = run(sim.simulate(SEED, sim.Switches(cubic_ppm_degC3=0.01)))
    for quantity in ("dsf_n", "dsf_p"):
        values = [one for one in of(analysis, quantity) if one.conditions["channel"] == 2]
        warmth = np.array([one.conditions["unit_temperature_degC"] for one in values]) - 20.0
        dsf_ppm = np.array([one.value for one in values])
        left_ppm = dsf_ppm - np.polynomial.polynomial.polyval(
            warmth, np.polynomial.polynomial.polyfit(warmth, dsf_ppm, 2)
        )
        found = [one.value for one in of(analysis, f"{quantity}_residual") if one.conditions["channel"] == 2]
        assert np.max(np.abs(left_ppm)) > 30.0
        np.testing.assert_allclose(found, left_ppm, atol=0.2)


@pytest.mark.parametrize(
    ("cubic", "verdict"),
    [(0.005, "pass"), (0.0123, "conditional_pass"), (0.01235, "conditional_fail"), (0.018, "fail")],
)
def test_what_compensation_leaves_over_is_judged(cubic: float, verdict: str) -> None:
    """The parabola through a cubic at five temperatures 15 degC apart leaves 2.4 * 15^3 = 8100 degC3 of it."""
    found = of(run(sim.simulate(SEED, sim.Switches(cubic_ppm_degC3=cubic), {1: "gyro"})), *RESIDUALS)
    worst = max(found, key=lambda one: abs(one.value))
    assert abs(worst.value) == pytest.approx(8100 * cubic, abs=3.0)
    assert worst.verdict == verdict


@pytest.mark.validates("conformance probability, two limits", against="JCGM 106:2012 clause 7, motor oil: 0.66")
def test_motor_oil() -> None:
    """JCGM 106:2012, clause 7: 13.6 mm2/s, u = 1.8 mm2/s, between 12.5 and 16.3: 0.66.

    A Zener diode of -5.47 V, u = 0.05 V, at most -5.40 V: 0.92.
    """
    assert conformance_probability(-5.47, 0.05, -math.inf, -5.40) == pytest.approx(0.92, abs=0.005)
    assert conformance_probability(13.6, 1.8, 12.5, 16.3) == pytest.approx(0.66, abs=0.005)


@pytest.mark.validates("conformance probability, one limit", against="JCGM 106:2012 clause 7, table")
@pytest.mark.parametrize(("p", "distance"), [(0.80, 0.84), (0.90, 1.28), (0.95, 1.64), (0.99, 2.33), (0.999, 3.09)])
def test_table_of_one_sided_probabilities(p: float, distance: float) -> None:
    """JCGM 106:2012, clause 7, the table of one-sided limits."""
    assert conformance_probability(0.0, 1.0, -math.inf, distance) == pytest.approx(p, abs=0.002)


@pytest.mark.validates("conformance probability, normal and t", against="scipy.integrate.quad of the density")
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
    ("value", "U", "limits", "simple", "guard_band", "non_binary"),
    [
        (79.0, 20.0, 100.0, "pass", "pass", "pass"),
        (80.5, 20.0, 100.0, "pass", "fail", "conditional_pass"),
        (100.1, 20.0, 100.0, "fail", "fail", "conditional_fail"),
        (-120.5, 20.0, 100.0, "fail", "fail", "fail"),
        (math.nan, 20.0, 100.0, "fail", "fail", "fail"),
        (0.5, math.nan, 1.0, "fail", "fail", "fail"),
        (4.86, 0.03, LIMITS_V, "fail", "fail", "fail"),
        (4.88, 0.03, LIMITS_V, "fail", "fail", "conditional_fail"),
        (4.92, 0.03, LIMITS_V, "pass", "fail", "conditional_pass"),
        (4.94, 0.03, LIMITS_V, "pass", "pass", "pass"),
        (-1e9, 0.01, (-math.inf, 0.15), "pass", "pass", "pass"),
        (0.2, 0.01, (-math.inf, 0.15), "fail", "fail", "fail"),
        (1e9, 0.01, (2.0, math.inf), "pass", "pass", "pass"),
        (1.9, 0.01, (2.0, math.inf), "fail", "fail", "fail"),
        (math.nan, 0.1, (-math.inf, 5.0), "fail", "fail", "fail"),
        (math.inf, 0.1, (4.9, math.inf), "fail", "fail", "fail"),
    ],
)
def test_rules(
    value: float, U: float, limits: float | tuple[float, float], simple: str, guard_band: str, non_binary: str
) -> None:
    """ILAC-G8:09/2019 section 4.2: a limit of 100 and U = 20; limits that are not alike; one limit alone."""
    found = [decide(value, U / coverage_factor(), limits, rule) for rule in ("simple", "guard_band", "non_binary")]
    assert [one.verdict for one in found] == [simple, guard_band, non_binary]
    assert [verdict(value, U, limits, rule) for rule in RULES] == [
        decide(value, U / coverage_factor(), limits, rule).verdict for rule in RULES
    ]
    if math.isnan(U):
        assert {one.conformance_probability for one in found} == {0.0}


@pytest.mark.validates(
    "risk of a guard band w = U and of simple acceptance", against="ILAC-G8:09/2019: at most 2.5 % and up to 50 %"
)
def test_risk_at_the_edges_of_the_rules(record_property: Callable[[str, object], None]) -> None:
    """ILAC-G8:09/2019: accepted with w = U at most 2.5 % wrong, by simple acceptance up to 50 %."""
    std = 20.0 / coverage_factor()
    guarded = decide(80.0, std, 100.0, "guard_band")
    risk = 1.0 - guarded.conformance_probability
    assert risk == pytest.approx(0.025, abs=1e-9)
    assert decide(99.999, std, 100.0, "simple").conformance_probability == pytest.approx(0.5, abs=1e-3)
    record_property("obtained", f"guard band {100 * risk:.2f} %")
    refused = decide(120.001, std, 100.0, "non_binary")
    assert (refused.verdict, refused.conformance_probability) == ("fail", pytest.approx(0.025, abs=1e-4))


def test_few_degrees_of_freedom_make_a_wider_guard_band() -> None:
    """u = 10 with 5 degrees of freedom: U = 25.7 (table G.2: k = 2.57), so 76 is no longer a pass."""
    assert decide(76.0, 10.0, 100.0, "guard_band").verdict == "pass"
    assert decide(76.0, 10.0, 100.0, "guard_band", dof=5).verdict == "fail"
    entry = estimate("dsf_n_residual", "ppm", 76.0, 10.0, {}, n=6, limit=100.0, dof=5)
    assert (entry.dof, entry.verdict) == (5.0, "conditional_pass")
    assert entry.coverage_factor == pytest.approx(2.57, abs=0.002)
    expected = stats.t(5).cdf(2.4) - stats.t(5).cdf(-17.6)
    assert judged(entry, "simple").conformance_probability == pytest.approx(expected, abs=1e-12)


def test_no_limit_no_statement() -> None:
    none = decide(5.0, 1.0, None)
    assert (none.verdict, none.conformance_probability) == ("none", None)
    assert estimate("bias", "A", 1.0, 1.0, {}, n=1).conformance_probability is None


def test_rules_are_the_same_everywhere_and_another_is_refused() -> None:
    with pytest.raises(FitError, match=r"B-FIT-041: .*'strict'.*Next: .*guard_band"):
        rule_of({"rule": "strict"})
    assert (rule_of(None), rule_of({}), rule_of({"rule": "simple"})) == ("non_binary", "non_binary", "simple")
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


def test_results_are_judged_by_the_rule_of_the_campaign() -> None:
    """A cubic of 0.0123 ppm/degC3 leaves about 99.8 of 100 ppm: a pass, a conditional pass or a fail, by rule."""
    campaign = sim.simulate(5, sim.Switches(cubic_ppm_degC3=0.0123), {1: "gyro"})
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


@pytest.mark.parametrize("trials", [1, 2, 7, 20, 200])
def test_as_scipy_finds_it(trials: int) -> None:
    for successes in sorted({0, 1, trials // 2, trials - 1, trials}):
        for probability in (0.90, 0.95):
            due = stats.binomtest(successes, trials).proportion_ci(probability, "exact")
            assert clopper_pearson(successes, trials, probability) == pytest.approx((due.low, due.high), abs=1e-9)


def test_nothing_and_everything() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert clopper_pearson(200, 200)[1] == 1.0
    assert clopper_pearson(200, 200)[0] == pytest.approx(0.025 ** (1 / 200))
    with pytest.raises(ValueError, match="no proportion"):
        clopper_pearson(3, 2)


def combined(components: Sequence[Component]) -> Budget:
    """Return the budget of one result alone."""
    return combine_all({"": components}).budgets[""]


# JCGM 100:2008 annex H.1, calibration of an end gauge, table H.1: contributions in nm and degrees of freedom
END_GAUGE = [
    Component("calibration of the standard end gauge", 25.0, "nm", dof=18),
    Component("repeated observations", 5.8, "nm", dof=24, evaluation="A"),
    Component("random effects of the comparator", 3.9, "nm", dof=5),
    Component("systematic effects of the comparator", 6.7, "nm", dof=8),
    Component("difference of the expansion coefficients", 0.58e-6, "1/degC", sensitivity=-50e6 * -0.1, dof=50),
    Component("difference of the temperatures", 0.029, "degC", sensitivity=-50e6 * 11.5e-6, dof=2),
]


@pytest.mark.validates("uncertainty budget, effective degrees of freedom", against="JCGM 100:2008 annex H.1, end gauge")
def test_end_gauge_of_the_guide(record_property: Callable[[str, object], None]) -> None:
    """Published: u = 32 nm, 16 effective degrees of freedom (16.7 before rounding), U = 93 nm for 99 %."""
    budget = combined(END_GAUGE)
    record_property("obtained", f"u = {budget.std_uncertainty:.1f} nm (32), dof {budget.dof:.1f} (16.7)")
    assert budget.std_uncertainty == pytest.approx(31.7, abs=0.05)
    assert budget.dof == pytest.approx(16.7, abs=0.1)
    assert budget.coverage_factor == pytest.approx(2.11, abs=0.01)  # table G.2: 2.12 for 16, 2.11 for 17
    assert sum(budget.share(one) for one in END_GAUGE) == pytest.approx(1.0, rel=1e-12)


def test_contribution_keeps_the_sign_of_the_sensitivity() -> None:
    assert END_GAUGE[5].contribution == pytest.approx(-16.7, abs=0.05)


@pytest.mark.validates("results that share a standard", against="JCGM 100:2008 5.2.2, ten resistors")
def test_ten_resistors_compared_with_one_standard() -> None:
    """JCGM 100:2008 5.2.2: each is known to 100 mohm through the same standard; in series they are known to 1 ohm."""
    found = combine_all({str(n): [Component("standard", 0.1, "ohm", common="standard")] for n in range(10)})
    np.testing.assert_allclose(found.correlation, np.ones((10, 10)), atol=1e-12)
    std = np.array([one.std_uncertainty for one in found.budgets.values()])
    assert math.sqrt(std @ found.correlation @ std) == pytest.approx(1.0, rel=1e-12)
    apart = combine_all({str(n): [Component("own standard", 0.1, "ohm")] for n in range(10)})
    np.testing.assert_array_equal(apart.correlation, np.eye(10))
    assert math.sqrt(std @ apart.correlation @ std) == pytest.approx(0.32, abs=0.005)


@pytest.mark.validates(
    "budgets and correlation of results that share errors", against="the package GTC, uncertain numbers"
)
def test_budgets_are_those_of_gtc() -> None:
    """Seed 13: five results, each of some common errors and two of its own, with few, many and infinite dof."""
    generator = np.random.default_rng(13)
    dof = {f"common {n}": float(generator.choice([math.inf, 3.0, 20.0])) for n in range(4)}
    shared = {name: GTC.ureal(0.0, 1.0, df=dof[name]) for name in dof}
    results, totals = {}, []
    for number in range(5):
        own = [Component(f"own {n}", generator.exponential(), dof=4.0 + n) for n in range(2)]
        weights = {name: float(generator.normal()) for name in dof if generator.random() < 0.8}
        both = [Component(name, 1.0, sensitivity=at, dof=dof[name], common=name) for name, at in weights.items()]
        results[str(number)] = [*own, *both]
        errors = [part.contribution * GTC.ureal(0.0, 1.0, df=part.dof) for part in own]
        totals.append(sum((at * shared[name] for name, at in weights.items()), sum(errors, GTC.constant(0.0))))
    found = combine_all(results)
    for total, budget in zip(totals, found.budgets.values(), strict=True):
        assert (budget.std_uncertainty, budget.dof) == pytest.approx((total.u, total.df), rel=1e-12)
    expected = [[GTC.get_correlation(first, second) for second in totals] for first in totals]
    np.testing.assert_allclose(found.correlation, expected, rtol=1e-12, atol=1e-14)


def test_nothing_uncertain() -> None:
    budget = combined([Component("not stated", 0.0, "ppm")])
    assert (budget.std_uncertainty, budget.dof, budget.expanded_uncertainty) == (0.0, math.inf, 0.0)
    assert budget.share(budget.components[0]) == 0.0
    found = combine_all({"a": [], "b": [Component("gain", 1.0, common="gain")]})
    np.testing.assert_array_equal(found.correlation, np.eye(2))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ([Component("gain", -1.0)], "u = -1"),
        ([Component("gain", math.nan)], "u = nan"),
        ([Component("gain", 1.0, sensitivity=math.inf)], "sensitivity = inf"),
        ([Component("gain", 1.0, dof=0.0)], "0 degrees of freedom"),
        ([Component("gain", 1.0, common="g"), Component("gain", 1.0, common="g", dof=5)], "other degrees of freedom"),
        ([Component("gain", 1.0, common="g"), Component("gain", 1.0, common="g")], "twice"),
    ],
)
def test_a_component_that_cannot_be_used_is_refused(wrong: list[Component], says: str) -> None:
    with pytest.raises(FitError, match=says) as caught:
        combine_all({"dsf_n channel 3": wrong})
    assert (caught.value.code, caught.value.where) == ("B-FIT-040", "dsf_n channel 3")
