"""The random walk of the simulated biases: any time in any order, with little of it kept."""

import tracemalloc

import numpy as np
import pytest

from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import CHANNELS, WALK_A_RTH
from sim_instruments.worlds.af_converter.walk import BiasWalk

ALL = np.arange(CHANNELS)
BLOCK_s = 40_960.0  # 4,096 steps of 10 s
TIMES_s = np.array([0.0, 3.3, 10.0, 20_000.0, BLOCK_s - 10.0, BLOCK_s - 4.2, BLOCK_s, BLOCK_s + 5.0, 136_800.0])


def whole_walk_A(seed: int, blocks: int) -> np.ndarray:
    """All steps one after the other, kept."""
    steps = [generator(seed, "ngu bias walk", block).standard_normal((4096, CHANNELS)) for block in range(blocks)]
    walk = np.zeros((0, CHANNELS))
    for one in steps:
        start = walk[-1] if len(walk) else 0.0
        walk = np.concatenate((walk, np.cumsum(one * (WALK_A_RTH * np.sqrt(10.0 / 3600.0)), axis=0) + start))
    return walk


def test_it_is_the_walk_of_all_steps_bit_for_bit() -> None:
    steps, walk = whole_walk_A(7, 4), BiasWalk(7)
    for step in (0, 1, 4094, 4095, 4096, 8191, 8192, 13_000):
        assert np.array_equal(walk.at(ALL, step * 10.0), steps[step]), step
    half = walk.at(ALL, BLOCK_s - 5.0)
    assert half == pytest.approx((steps[4095] + steps[4096]) / 2, rel=1e-12)


def test_order_and_shape_of_the_questions_change_nothing() -> None:
    together = BiasWalk(3).at(ALL, TIMES_s[:, None])
    assert together.shape == (TIMES_s.size, CHANNELS)
    walk = BiasWalk(3)
    for place in (8, 0, 6, 5, 4, 7, 3, 2, 1, 8):
        assert np.array_equal(walk.at(ALL, TIMES_s[place]), together[place]), TIMES_s[place]
    assert np.array_equal(BiasWalk(3).at(np.array(4), TIMES_s), together[:, 4])


def test_memory_does_not_grow_with_the_campaign() -> None:
    walk = BiasWalk(1)
    walk.at(ALL, 0.0)
    tracemalloc.start()
    walk.at(ALL, 10.0 * BLOCK_s)
    walk.at(ALL, 0.0)
    held_KiB = tracemalloc.get_traced_memory()[0] / 1024
    tracemalloc.stop()
    assert held_KiB < 340  # one block of 4,097 steps is 320 KiB, the values between the blocks 2 KiB
