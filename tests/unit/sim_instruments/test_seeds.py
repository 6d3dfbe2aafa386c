"""Draws of the simulated bench: named by seed and purpose, whatever size the numbers are."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from sim_instruments.seeds import generator


@pytest.mark.parametrize("numbers", [(0,), (1, 0, 7), (2**32 - 1, 3), (2**32, 3), (2**70, 2**33, 0)])
def test_draws_are_those_of_the_list_of_numbers(numbers):
    expected = np.random.default_rng([numbers[0], zlib.crc32(b"a purpose"), *numbers[1:]]).standard_normal(3)
    np.testing.assert_array_equal(generator(numbers[0], "a purpose", *numbers[1:]).standard_normal(3), expected)
