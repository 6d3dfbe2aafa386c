"""Tail probabilities against the tables of critical values, not against the library that computes them."""

import math

import numpy as np
import pytest

from bench.maths.tests import SMALLEST, chi2_both, chi2_tail, f_tail, of_many, t_both


@pytest.mark.parametrize(
    ("probability", "due"),
    [  # NIST/SEMATECH e-Handbook of Statistical Methods, sections 1.3.6.7.1 to 1.3.6.7.4
        (chi2_tail(3.841, 1), 0.05),
        (chi2_tail(18.307, 10), 0.05),
        (chi2_both(20.483, 10), 0.05),
        (chi2_both(3.247, 10), 0.05),
        (f_tail(4.965, 1, 10), 0.05),
        (f_tail(10.044, 1, 10), 0.01),
        (f_tail(18.307 / 10, 10, math.inf), 0.05),
        (t_both(2.228, 10), 0.05),
        (t_both(-2.228, 10), 0.05),
        (t_both(1.95996), 0.05),
    ],
)
def test_critical_values_of_the_tables(probability: float, due: float) -> None:
    assert probability == pytest.approx(due, rel=1e-3)


def test_a_probability_is_never_a_certainty_and_never_above_one() -> None:
    assert chi2_tail(1e6, 3) == f_tail(1e300, 900, 900) == t_both(1e6) == SMALLEST
    assert chi2_tail(0.0, 0) == chi2_tail(5.0, 0) == 1.0
    assert of_many(0.3, 4) == 1.0
    assert of_many(0.1, 4) == pytest.approx(0.4)


def test_arrays_are_judged_element_by_element() -> None:
    assert np.allclose(t_both(np.array([1.95996, 2.228]), np.array([math.inf, 10.0])), 0.05, rtol=1e-3)
    assert np.allclose(f_tail(np.array([4.965, 1.8307]), np.array([1, 10]), np.array([10, math.inf])), 0.05, rtol=1e-3)
