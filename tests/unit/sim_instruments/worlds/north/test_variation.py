"""Parameters that vary: within their limits, and integrals that are integrals."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from sim_instruments.worlds.north.variation import Constant, Linear, Sine, drawn_slow, drawn_steps

FINE_S = np.linspace(0.0, 50.0, 500_001)


def all_of_them():
    rng = np.random.default_rng(11)
    return {
        "constant": Constant(),
        "slow": drawn_slow(rng),
        "double": Sine(2.0, 0.3),
        "linear": Linear(20.0),
        "steps": drawn_steps(rng, (17,), 1.0),
    }


@pytest.mark.parametrize("name", ["constant", "slow", "double", "linear", "steps"])
def test_the_integral_is_that_of_the_values(name):
    one = all_of_them()[name]
    middle_s = (FINE_S[1:] + FINE_S[:-1]) / 2.0
    summed = np.concatenate(([0.0], np.cumsum(one.at(middle_s)) * (FINE_S[1] - FINE_S[0])))
    np.testing.assert_allclose(one.integral_s(FINE_S), summed, atol=1e-6)
    if name != "steps":
        np.testing.assert_allclose(
            one.integral_s(FINE_S), cumulative_trapezoid(one.at(FINE_S), FINE_S, initial=0.0), atol=1e-6
        )


@pytest.mark.parametrize("name", ["slow", "double", "linear", "steps"])
def test_nothing_leaves_20_percent_and_most_of_it_is_used(name):
    found = all_of_them()[name].at(FINE_S)
    assert np.abs(found).max() <= 0.2 + 1e-12
    assert np.ptp(found) > 0.25


def test_a_linear_one_goes_up_and_comes_back():
    assert Linear(10.0).at(np.array([0.0, 5.0, 10.0, 15.0, 20.0])) == pytest.approx([-0.2, 0.0, 0.2, 0.0, -0.2])


def test_steps_stay_for_their_time_and_repeat_behind_the_table():
    steps = drawn_steps(np.random.default_rng(3), (4,), 0.5)
    found = steps.at(np.arange(0.05, 4.0, 0.1)).reshape(8, 5)
    assert np.ptp(found, axis=1).max() == 0.0
    assert np.unique(found[:4, 0]).size == 4
    np.testing.assert_array_equal(found[:4], found[4:])


def test_each_run_varies_by_itself():
    rng = np.random.default_rng(5)
    for one in (drawn_slow(rng, (3, 1)), drawn_steps(rng, (3, 20), 1.0)):
        found = one.at(np.arange(0.5, 20.0))
        assert found.shape == (3, 20) == one.integral_s(np.arange(0.5, 20.0)).shape
        assert np.abs(np.diff(found, axis=0)).max(axis=1).min() > 0.01
