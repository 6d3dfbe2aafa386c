"""The parts of a shorter plan that belong to no system; and the search against designs published as the best."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from bench.analysis import Common, estimate, sharing
from bench.design import (
    Key,
    SequenceText,
    Target,
    best_within,
    default_targets,
    descended,
    designed,
    reached,
    read_target,
    refuse_below_floor,
    slot_s,
)
from bench.design.shortest import misses
from bench.model.errors import InputError

LAG_s, WITHIN_degC, FOR_s = 1620.0, 1.0, 600.0


@pytest.mark.validates("slot of a soak", against="the equation of a lag behind a ramp, stepped in time")
@pytest.mark.parametrize("step_degC", [3.0, 15.0, 30.0, 60.0])
def test_a_soak_ends_when_the_unit_was_in_the_band_long_enough(step_degC: float) -> None:
    slot = slot_s(step_degC, 0.5, WITHIN_degC, FOR_s, LAG_s)
    t_s = np.arange(0.0, slot + 1.0)
    air_degC = np.minimum(0.5 / 60.0 * t_s, step_degC)
    unit_degC = np.zeros_like(t_s)
    for second in range(1, t_s.size):
        unit_degC[second] = unit_degC[second - 1] + (air_degC[second - 1] - unit_degC[second - 1]) / LAG_s
    outside = np.flatnonzero(np.abs(unit_degC - step_degC) > WITHIN_degC)
    waited_s = t_s[-1] - t_s[outside[-1]]
    assert FOR_s - 2.0 <= waited_s <= FOR_s + 62.0
    assert slot % 60.0 == 0.0


def scale_factor(U_ppm: float, gain_ppm: float, kind: str = "gyro") -> Any:
    """Return an estimate with a random part of 0.3 ppm beside the gain of a standard."""
    entry = estimate("dsf_n", "ppm", 400.0, U_ppm / 1.959963984540054, {"kind": kind, "channel": 1}, n=1)
    return sharing(entry, Common(standards={"gain": gain_ppm}, campaign={}))


def test_targets_are_read_and_held_against_the_largest_uncertainty() -> None:
    estimates = [scale_factor(22.0, 10.0), scale_factor(21.0, 10.0, "accelerometer")]
    known = reached(estimates)
    target = read_target("dsf_n=21.5ppm", estimates)
    assert target == Target(Key("dsf_n", "", ""), 21.5)
    assert not target.holds(known)
    assert misses([target], known) == ["dsf_n is 22, not 21.5"]
    assert read_target("dsf_n.random = 0.6 ppm", estimates).key.part == "random"
    U_ppm = read_target("dsf_n=0.003%", estimates).U
    assert U_ppm == pytest.approx(30.0)
    of_bias = [estimate("bias", "A", 0.0, 1e-9, {}, n=1), estimate("white_noise", "A*s^0.5", 0.0, 1e-10, {}, n=1)]
    of_900pA = read_target("bias=900pA", of_bias).U
    assert of_900pA == pytest.approx(9e-10)
    assert read_target("white_noise=1.3e-10A*s^0.5", of_bias).U == 1.3e-10
    given = default_targets([("dsf_n", "")], known)
    assert {target.key.kind: target.U for target in given} == pytest.approx({"gyro": 22.022, "accelerometer": 21.021})
    assert all(target.holds(known) for target in given)
    std_ppm = math.sqrt((22.0 / 1.959963984540054) ** 2 - 10.0**2)
    assert known[Key("dsf_n", "random", "gyro")] == pytest.approx(1.959963984540054 * std_ppm)


def test_what_shares_nothing_is_random_in_full() -> None:
    """Ten degrees of freedom, k = 2.228 (JCGM 100, table G.2)."""
    known = reached([estimate("gain", "ppm", 0.0, 1.0, {}, n=1, dof=10.0)])
    assert known[Key("gain", "random", "")] == known[Key("gain", "", "")] == pytest.approx(2.228, abs=5e-4)


@pytest.mark.parametrize(
    "words", ["dsf_n", "dsf_n=", "dsf_n=-1ppm", "dsf_n=22 mA", "bias=1", "dsf_n=nan", "=3", "dsf_n=22", "dsf_n=0ppm"]
)
def test_what_is_no_target_is_refused(words: str) -> None:
    with pytest.raises(InputError, match="B-DES-001"):
        read_target(words, [scale_factor(22.0, 10.0)])


def test_a_target_below_the_standards_is_refused_with_the_floor_and_what_would_do() -> None:
    estimates = [scale_factor(22.0, 10.0)]
    refuse_below_floor([Target(Key("dsf_n", "", ""), 19.7), Target(Key("dsf_n", "random", ""), 0.1)], estimates)
    with pytest.raises(InputError, match=r"B-DES-002: .*19\.6 ppm.*Next: .*'gain' to 15 ppm"):
        refuse_below_floor([Target(Key("dsf_n", "", ""), 15.0)], estimates)


TEXT = """\
# head
sequence: demo          # its name
parameters:
  dwell: 100 s   # of a record
steps:
  - one: 1
  # behind one
  - two:
      a: 1
procedures:
  p:
    do: []
"""


def test_a_sequence_is_changed_in_its_lines_only() -> None:
    text = SequenceText(TEXT, "demo.yaml")
    assert text.block(("steps", 1)) == ["  - two:", "      a: 1"]
    text.set_value(("parameters", "dwell"), "113 s", "100 s before")
    text.replace_below(("steps",), ["  - three: 3"])
    text.insert_below(("procedures",), ["  q:", "    do: []"])
    assert text.text(["made", "by hand"]) == (
        "# made\n# by hand\n#\n# head\nsequence: demo          # its name\nparameters:\n"
        "  dwell: 113 s  # 100 s before; of a record\nsteps:\n  - three: 3\n"
        "procedures:\n  q:\n    do: []\n  p:\n    do: []\n"
    )
    with pytest.raises(InputError, match="B-DES-005"):
        text.set_value(("steps",), "1", "")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  dwell: 100 s   # of a record", "  {serial: 1, dwell: 100 s}"),
        ("parameters:\n  dwell: 100 s   # of a record", "parameters: {dwell: 100 s, serial: 1}"),
    ],
)
def test_what_shares_a_line_is_not_changed(old: str, new: str) -> None:
    assert old in TEXT
    text = SequenceText(TEXT.replace(old, new), "demo.yaml")
    for change in (
        lambda: text.set_value(("parameters", "dwell"), "113 s", "100 s before"),
        lambda: text.remove(("parameters", "dwell")),
        lambda: text.replace_below(("procedures", "p", "do"), ["      - one: 1"]),
        lambda: text.insert_below(("procedures", "p", "do"), ["      - one: 1"]),
    ):
        with pytest.raises(InputError, match=r"B-DES-005: .*shares one"):
            change()


class Boxes:
    """Campaigns of n boxes: U = 10 / sqrt(n length), an hour a box and a second of record; an odd number is a rule."""

    today = (9, 4.0)
    starts = (9,)
    wanted = (("width", ""),)

    def moves(self, candidate: int) -> Iterator[int]:
        yield from (number for number in range(1, 20) if abs(number - candidate) <= 2)

    def lengths_s(self, candidate: int) -> Sequence[float]:
        return [1.0, 2.0, 3.0, 4.0, 5.0]

    def duration_s(self, candidate: int, length_s: float) -> float:
        return 3600.0 * candidate + length_s

    def estimates(self, candidate: int, length_s: float) -> Any:
        return [estimate("width", "m", 0.0, 10.0 / math.sqrt(candidate * length_s) / 1.959963984540054, {}, n=1)]

    def at_least(self, candidate: int, length_s: float) -> dict[Key, float]:
        return {}

    def broken(self, candidate: int, length_s: float) -> list[str]:
        return [] if candidate % 2 else ["even"]


def test_the_shortest_plan_reaches_its_target_under_the_rules() -> None:
    problem: Any = Boxes()
    targets = default_targets(problem.wanted, reached(problem.estimates(*problem.today)))
    found = designed(problem, targets)
    assert (found.candidate, found.length_s) == (9, 4.0)
    looser = designed(problem, targets, factor=2.0)
    assert (looser.candidate, looser.length_s) == (3, 3.0)
    assert designed(problem, targets, factor=0.1) is None
    within = best_within(problem, targets, 3.5 * 3600.0)
    assert (within.candidate, within.length_s) == (3, 5.0)
    least = math.sqrt(36.0 / 15.0)
    assert least <= within.factor <= 1.014 * least
    assert best_within(problem, targets, 1800.0) is None


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
