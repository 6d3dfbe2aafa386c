"""The search against designs that are published as the best, without the rules that keep a campaign from blindness."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from bench.design import descended

Design = tuple[Any, ...]


def best(
    starts: Sequence[Design], moves: Callable[[Design], Iterator[Design]], loss: Callable[[Design], float]
) -> tuple[Design, float]:
    """Return what the search makes of the starts, and what is left of the loss."""

    def rank(design: Design, least: tuple[float, ...] | None) -> tuple[float, ...] | None:
        here = (loss(design),)
        return here if least is None or here[0] < least[0] - 1e-12 else None

    found = [descent for start in starts if (descent := descended([start], moves, rank))]
    return min(((design, left[0]) for design, left in found), key=lambda pair: pair[1])


def one_changed(points: Sequence[Any]) -> Callable[[Design], Iterator[Design]]:
    """Return the moves that put another point in the place of one."""
    return lambda design: ((*design[:n], point, *design[n + 1 :]) for n in range(len(design)) for point in points)


def two_swapped(order: Design) -> Iterator[Design]:
    for one, other in combinations(range(len(order)), 2):
        there = list(order)
        there[one], there[other] = order[other], order[one]
        yield tuple(there)


def d_loss(rows: np.ndarray) -> float:
    """Minus the logarithm of the determinant of the information: large where little is determined."""
    sign, logarithm = np.linalg.slogdet(rows.T @ rows / len(rows))
    return -logarithm if sign > 0 else 1e3 - np.linalg.matrix_rank(rows)


def shuffled(order: Design) -> list[Design]:
    """Return an order in other orders, by seeds 0 to 19."""
    return [tuple(order[n] for n in np.random.default_rng(seed).permutation(len(order))) for seed in range(20)]


SUPPORT = {  # Guest, Annals of Mathematical Statistics 29 (1958): the ends and the roots of P'_degree, equal weights
    1: (-1.0, 1.0),
    2: (-1.0, 0.0, 1.0),
    3: (-1.0, -1.0 / math.sqrt(5.0), 1.0 / math.sqrt(5.0), 1.0),
    4: (-1.0, -math.sqrt(3.0 / 7.0), 0.0, math.sqrt(3.0 / 7.0), 1.0),
}


@pytest.mark.validates(
    "D-optimal points of polynomials of degree 1 to 4", against="Guest (1958): ends and roots of a Legendre polynomial"
)
@pytest.mark.parametrize("degree", SUPPORT)
@pytest.mark.parametrize("each", [1, 2])
def test_polynomials(degree: int, each: int) -> None:
    grid = sorted({*np.linspace(-1.0, 1.0, 41).round(3).tolist(), *SUPPORT[degree]})
    runs = each * (degree + 1)
    start = tuple(np.linspace(-0.9, 0.9, runs).round(3).tolist())

    def loss(points: Design) -> float:
        return d_loss(np.vander(np.array(points), degree + 1))

    found, left = best([start], one_changed(grid), loss)
    assert sorted(found) == pytest.approx(sorted(SUPPORT[degree] * each), abs=1e-9)
    assert left <= loss(SUPPORT[degree] * each) + 1e-9


def time_count(signs: np.ndarray) -> float:
    """How far contrasts of runs, (n,) or (n, k), follow a steady drift: 0 for an order that eliminates it."""
    times = np.arange(len(signs)) - (len(signs) - 1) / 2.0
    return float(np.sum(np.abs(times @ signs)))


@pytest.mark.validates("orders that eliminate a steady drift", against="ABBA; Daniel and Wilcoxon (1966), 2^3 and 2^4")
def test_two_things_are_compared_as_abba() -> None:
    found, left = best([(1, 1, -1, -1)], two_swapped, lambda order: time_count(np.array(order)))
    assert left == 0.0
    assert found in {(1, -1, -1, 1), (-1, 1, 1, -1)}


@pytest.mark.parametrize("factors", [3, 4])
def test_factorials_are_run_so_that_no_main_effect_follows_a_drift(factors: int) -> None:
    """Daniel and Wilcoxon, Technometrics 8 (1966) 259: such orders exist from three factors on."""
    standard = tuple(product((-1, 1), repeat=factors))
    assert time_count(np.array(standard)) > 0.0
    _, left = best(shuffled(standard), two_swapped, lambda order: time_count(np.array(order)))
    assert left == 0.0


FACES_AND_EDGES = [
    tuple((np.array(way) / np.linalg.norm(way)).tolist())
    for way in product((-1, 0, 1), repeat=3)
    if 0 < np.dot(way, way) < 3
]  # poses that a turntable reaches in steps of 45 degrees
SIX = [tuple(float(sign * (axis == other)) for other in range(3)) for axis in range(3) for sign in (1, -1)]


def poses(design: Design) -> float:
    """Loss of poses in the model of one sensor of a triad: bias, scale factor and two misalignments."""
    return d_loss(np.column_stack([np.ones(len(design)), np.array(design)]))


@pytest.mark.validates(
    "six positions and any number of poses",
    against="the bound of Kiefer and Wolfowitz (1960): det = 3^-3 on the sphere",
)
@pytest.mark.parametrize("count", [6, 12])
def test_poses_are_as_good_as_six_positions_and_no_better(count: int) -> None:
    """No measure on the sphere has more information in the linear model than the six positions of IEEE Std 1293."""
    bound = 3.0 * math.log(3.0)
    assert poses(tuple(SIX)) == pytest.approx(bound, abs=1e-12)
    starts = [
        tuple(FACES_AND_EDGES[n] for n in np.random.default_rng(seed).integers(0, len(FACES_AND_EDGES), count))
        for seed in range(20)
    ]
    found, left = best(starts, one_changed(FACES_AND_EDGES), poses)
    print(f"{count} poses: {left - bound:.2e} above the bound; {len(set(found))} different ones; seeds 0 to 19")
    assert left == pytest.approx(bound, abs=1e-9)
