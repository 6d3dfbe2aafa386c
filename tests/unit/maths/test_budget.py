"""Budgets against the worked examples of the guide, closed forms and drawn numbers."""

import math
from collections.abc import Callable, Sequence

import GTC
import numpy as np
import pytest

from bench.maths.budget import Budget, Component, combine_all
from bench.model.errors import FitError


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


@pytest.mark.validates(
    "uncertainty budget, effective degrees of freedom",
    against="JCGM 100:2008 annex H.1, end gauge",
)
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


@pytest.mark.validates(
    "results that share a standard",
    against="JCGM 100:2008 5.2.2, ten resistors",
)
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
    "correlation between results",
    against="400,000 draws of the errors",
)
def test_correlation_is_that_of_drawn_errors(record_property: Callable[[str, object], None]) -> None:
    """Seed 11, 400,000 draws of one shared error with another weight in each result, and errors of their own."""
    generator = np.random.default_rng(11)
    gain, sensor = generator.normal(size=(2, 400_000))
    first = 10.0 * gain - 2.0 * sensor + 3.0 * generator.normal(size=gain.size)
    second = 9.0 * gain + 4.0 * sensor + 1.0 * generator.normal(size=gain.size)
    shared = {
        "first": [
            Component("gain", 10.0, common="gain"),
            Component("sensor", 2.0, sensitivity=-1.0, common="sensor"),
            Component("noise", 3.0),
        ],
        "second": [
            Component("gain", 9.0, common="gain"),
            Component("sensor", 2.0, sensitivity=2.0, common="sensor"),
            Component("noise", 1.0),
        ],
    }
    found = combine_all(shared)
    record_property("obtained", f"{found.correlation[0, 1]:.4f}, drawn {np.corrcoef(first, second)[0, 1]:.4f}")
    assert found.correlation[0, 1] == pytest.approx(np.corrcoef(first, second)[0, 1], abs=0.004)
    assert found.budgets["second"].std_uncertainty == pytest.approx(np.std(second), rel=0.005)


@pytest.mark.validates(
    "budgets and correlation of results that share errors",
    against="the package GTC, uncertain numbers",
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


def test_one_component_alone_keeps_its_degrees_of_freedom() -> None:
    """Table G.2: 10 degrees of freedom, k = 2.23; as a tenth of the variance they hardly count any more."""
    alone = combined([Component("noise", 1.0, dof=10, evaluation="A")])
    assert (alone.dof, round(alone.coverage_factor, 2)) == (pytest.approx(10.0), 2.23)
    within = combined([Component("noise", 1.0, dof=10, evaluation="A"), Component("gain", 3.0)])
    assert within.dof == pytest.approx(10.0 * 10.0**2, rel=1e-9)
    assert within.coverage_factor == pytest.approx(1.962, abs=0.001)


def test_stated_interval_of_a_mean_of_few_readings_covers() -> None:
    """Seed 12, 20,000 means of 6 readings with an exact component beside: 95 % only with the effective dof.

    The formula is an approximation: as the exact part grows to the size of the other, about 94 % are left.
    """
    generator = np.random.default_rng(12)
    readings = generator.normal(size=(20_000, 6))
    error = readings.mean(axis=1) + 0.1 * generator.normal(size=20_000)
    inside, careless = [], []
    for one, std in zip(error, readings.std(axis=1, ddof=1) / np.sqrt(6.0), strict=True):
        budget = combined([Component("readings", float(std), dof=5, evaluation="A"), Component("standard", 0.1)])
        inside.append(abs(one) <= budget.expanded_uncertainty)
        careless.append(abs(one) <= 1.96 * budget.std_uncertainty)
    print(f"covered {np.mean(inside):.4f}, with k = 1.96 {np.mean(careless):.4f}")
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)
    assert np.mean(careless) < 0.92


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
