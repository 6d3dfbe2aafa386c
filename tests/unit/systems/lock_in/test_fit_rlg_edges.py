"""Levels of the edges of a ring laser's beat: counted through all that a tagger and a comparator may do to them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rlg_second_opinion import Gyro, simulate, ticks

from bench.model.errors import FitError
from bench.systems.lock_in.estimators.edges import EdgeLevels, edge_levels

Int64 = NDArray[np.int64]


def edges_of(cells: Int64) -> tuple[Int64, NDArray[np.bool_], NDArray[np.bool_]]:
    """True levels, rising and cosine of the edges on a way through cells floor(psi / pi), one step at a time."""
    up = np.diff(cells) > 0
    level = np.maximum(cells[1:], cells[:-1])
    even = level % 2 == 0
    return level, up == even, even


def swing(top: int, turns: int = 6) -> Int64:
    """Cells of a phase that goes up to ``top`` and down again, ``turns`` times."""
    once = np.concatenate((np.arange(top), np.arange(top, 0, -1)))
    return np.concatenate((np.tile(once, turns), [0]))


def counted(rising: NDArray[np.bool_], cosine: NDArray[np.bool_]) -> EdgeLevels:
    return edge_levels(np.arange(rising.size), rising, cosine)


@pytest.mark.parametrize("seed", range(20))
def test_any_way_is_counted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.cumsum(np.concatenate(([rng.integers(-9, 9)], rng.choice([-1, 1], 300))))
    level, rising, cosine = edges_of(cells)
    found = counted(rising, cosine)
    assert np.unique(found.level - level).size == 1
    assert (found.level - level)[0] % 2 == 0  # an even number of levels: a sine and a cosine tell no more
    assert np.array_equal(found.direction, np.diff(cells))
    assert not found.suspect.any()
    assert found.breaks.size == 0
    assert found.repaired == 0


def test_an_edge_lost_in_a_run_is_bridged() -> None:
    level, rising, cosine = edges_of(swing(12))
    kept = np.delete(np.arange(level.size), [5, 17, 30])
    found = counted(rising[kept], cosine[kept])
    assert found.repaired == 3
    assert np.array_equal(found.level, level[kept])


def test_an_edge_lost_at_a_turnaround_breaks_the_count() -> None:
    level, rising, cosine = edges_of(swing(12))
    kept = np.delete(np.arange(level.size), 12)  # the first one down from the top
    found = counted(rising[kept], cosine[kept])
    assert found.breaks.tolist() == [12]
    assert np.array_equal(found.level[:12], level[:12])
    off = found.level[12:] - level[kept][12:]
    assert np.unique(off).size == 1
    assert abs(int(off[0])) in (0, 2)  # its parity is right, whichever of the two it was
    assert np.array_equal(found.level % 2 == 0, cosine[kept])


def test_a_pair_that_changed_places_is_marked_and_nothing_else() -> None:
    level, rising, cosine = edges_of(swing(12))
    order = np.arange(level.size)
    order[[11, 12]] = 12, 11
    found = counted(rising[order], cosine[order])
    assert np.flatnonzero(found.suspect).tolist() == [11, 12]
    assert found.breaks.size == 0
    assert np.array_equal(found.level, level[order])


def test_all_at_once() -> None:
    level, rising, cosine = edges_of(swing(20, 40))
    order = np.arange(level.size)
    order[[19, 20]], order[[99, 100]] = (20, 19), (100, 99)
    kept = np.delete(order, [45, 260])
    found = counted(rising[kept], cosine[kept])
    assert (found.repaired, int(found.suspect.sum()), found.breaks.size) == (1, 4, 1)
    assert np.array_equal(found.level[:250], level[kept][:250])
    assert np.array_equal(found.level % 2 == 0, cosine[kept])


@pytest.mark.parametrize("noise_rad", [0.0, 0.05])
def test_levels_of_a_simulated_beat(noise_rad: float) -> None:
    beat = simulate(Gyro(path_m=0.15, beat_noise_rad=noise_rad), 0.2, seed=4)
    found = edge_levels(ticks(beat.time_s, 100e6), beat.rising, beat.cosine)
    assert np.unique(found.level - beat.level).size == 1
    assert found.breaks.size == 0


@pytest.mark.parametrize("tick", [[3], [5, 4, 6]])
def test_no_stretch(tick: list[int]) -> None:
    ones = np.ones(len(tick), bool)
    with pytest.raises(FitError, match="no stretch") as caught:
        edge_levels(np.array(tick), ones, ones)
    assert caught.value.code == "B-FIT-095"
