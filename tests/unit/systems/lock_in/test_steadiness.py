"""Checks of outputs and constants on numbers made by hand: fair chances where nothing is odd, small where it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench.systems.lock_in.estimators.random_walk import odd_steps
from bench.systems.lock_in.estimators.steadiness import change, constancy, line, parts_of, runs, wander

RUNS, PERIODS = 400, 800
TIME = np.arange(PERIODS)


def increments(seed: int, quantum: float = 0.5) -> Any:
    rng = np.random.default_rng(seed)
    found = rng.standard_normal(PERIODS) + np.diff(quantum * rng.standard_normal(PERIODS + 1))
    found[rng.choice(PERIODS, 5, replace=False)] = np.nan
    return found


def constants(seed: int, shift: Any = 0.0) -> Any:
    """Scores of a laser whose kc is off by ``shift`` at each turnaround."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((PERIODS, 2, 2))
    information = root @ root.transpose(0, 2, 1)
    score = np.einsum("upq,uq->up", root, rng.standard_normal((PERIODS, 2)))
    score += information[:, :, 0] * np.broadcast_to(shift, PERIODS)[:, None]
    change = np.linalg.solve(information.sum(axis=0), score.sum(axis=0))
    score -= information @ change  # the fit has taken off what is common
    return SimpleNamespace(score=score, information=information, kappa_rad_s=10.0, beta_rad=0.0)


def assert_fair(chances: Any) -> None:
    """No more small probabilities than chance brings, at three levels (99.9 % of a binomial count)."""
    for level, most in ((0.1, 62), (0.01, 13), (0.001, 5)):
        assert np.sum(np.asarray(chances) < level) <= most


def test_chances_are_fair_where_nothing_is_odd() -> None:
    records = [increments(seed) for seed in range(RUNS)]
    assert_fair([wander(record).probability for record in records])
    assert_fair([line(record).probability for record in records])
    assert_fair([change(record)[0] for record in records])
    fits = [constants(seed) for seed in range(RUNS)]
    assert_fair([constancy(fit, TIME * 4 // PERIODS).probability for fit in fits])
    assert_fair([constancy(fit, TIME % 2).probability for fit in fits])
    assert_fair([runs(fit)[0] for fit in fits])


@pytest.mark.parametrize(
    ("added", "check"),
    [
        (3e-3 * (TIME - 400.0), wander),
        (0.8 * (TIME > 500), wander),
        (1.0 * np.sin(2.0 * np.pi * 0.0313 * TIME), line),
    ],
    ids=["ramp", "step", "line"],
)
def test_what_is_odd_is_found_and_taken_off(added: Any, check: Any) -> None:
    right = increments(1)
    seen = check(right + added)
    assert seen.probability < 1e-9
    scatter = [np.nanstd(values[: PERIODS // 5 * 5].reshape(-1, 5).mean(axis=1)) for values in (right, right + added)]
    left = np.nanstd(seen.left[: PERIODS // 5 * 5].reshape(-1, 5).mean(axis=1))
    assert abs(left - scatter[0]) < 0.35 * abs(scatter[1] - scatter[0])


def test_a_walk_that_grows() -> None:
    grown = increments(2) * np.where(TIME > 400, 3.0, 1.0)
    probability, ratio = change(grown)
    assert probability < 1e-9
    assert 2.4 < ratio < 3.6


def test_constants_that_change_from_group_to_group() -> None:
    late = TIME >= 400
    seen = constancy(constants(3, 0.5 * late), TIME * 4 // PERIODS)
    assert seen.probability < 1e-9
    assert abs(seen.kappa_moves) < 0.01  # as many before as behind
    assert constancy(constants(3, 0.5 * late), TIME % 2).probability > 1e-3
    wave = np.sin(2.0 * np.pi * TIME / 40.0)
    probability, factor = runs(constants(4, wave))
    assert probability < 1e-9
    assert factor > 1.5


def test_groups_that_tell_nothing_say_nothing() -> None:
    assert constancy(constants(5), np.minimum(TIME, 1)).probability == 1.0


def test_parts_of_equal_size() -> None:
    assert parts_of(np.array([5.0, 1.0, 3.0, 2.0]), 2).tolist() == [1, 0, 1, 0]


def test_a_turn_that_is_lost_is_odd_and_a_late_pick_off_is_not() -> None:
    rng = np.random.default_rng(6)
    psi = np.concatenate(([0.0], np.cumsum(0.05 * rng.standard_normal(400))))
    rising = np.arange(401) % 2 == 0
    late = psi + 3.0 * rising
    assert odd_steps(late, rising, np.ones(400, bool)).tolist() == []
    late[201:] += 2.0 * np.pi
    assert odd_steps(late, rising, np.ones(400, bool)).tolist() == [200]
    assert odd_steps(late, rising, np.arange(400) != 200).tolist() == []


TICKS = 49962.8048  # of a 20 MHz clock in a period of 2.498 ms


def with_rounded_stamps(seed: int, vibration: float = 0.0) -> Any:
    """White noise and stamps that are rounded to ticks, of a steady dither whose comparator jitters by 0.1 ticks."""
    draw, when = np.random.default_rng(seed), np.arange(8001)
    stamp = when * TICKS + 0.3 + 0.1 * draw.standard_normal(when.size)
    moved = 0.3 * draw.standard_normal(8000) + vibration * np.sin(0.7 * when[1:])
    return moved + np.diff(np.rint(stamp) - stamp)


@pytest.mark.parametrize("seed", range(5))
def test_the_beat_of_clock_and_dither_is_no_line_of_the_rate(seed: int) -> None:
    assert line(with_rounded_stamps(seed)).probability < 1e-9
    assert line(with_rounded_stamps(seed), TICKS).probability > 1e-3


def test_a_vibration_beside_the_beat_is_seen() -> None:
    assert line(with_rounded_stamps(0, 0.1), TICKS).probability < 1e-9
