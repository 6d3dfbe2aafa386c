"""What is true of a simulated unit, its random walk included."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from bench.model.errors import InputError
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import CHANNELS, WALK_A_RTH
from sim_instruments.worlds.af_converter.unit_constants import BiasWalk, NguTruth

NUMBERS = np.arange(1, 11)
ALL = np.arange(CHANNELS)
BLOCK_s = 40_960.0  # 4,096 steps of 10 s
TIMES_s = np.array([0.0, 3.3, 10.0, 20_000.0, BLOCK_s - 10.0, BLOCK_s - 4.2, BLOCK_s, BLOCK_s + 5.0, 136_800.0])


def test_scale_factor_errors_spread_as_designed():
    drawn = np.array(
        [[NguTruth(seed).dsf_n_ppm(NUMBERS, 20.0), NguTruth(seed).dsf_p_ppm(NUMBERS, 20.0)] for seed in range(200)]
    )
    assert abs(drawn.mean()) < 4 * 400 / np.sqrt(drawn.size)
    assert drawn.std() == pytest.approx(400, rel=0.05)
    assert abs(np.corrcoef(drawn[:, 0].ravel(), drawn[:, 1].ravel())[0, 1]) < 0.1


def test_the_same_seed_is_the_same_unit_and_another_is_not():
    first, same, other = NguTruth(5), NguTruth(5), NguTruth(6)
    at = (NUMBERS, 31.5, 80_000.0)
    np.testing.assert_array_equal(first.bias_A(*at), same.bias_A(*at))
    assert (first.bias_A(*at) != other.bias_A(*at)).all()


def test_bias_never_comes_near_zero_so_reversals_stay_short():
    degC = np.linspace(-12, 52, 33)[:, None]
    for seed in range(100):
        bias_A = NguTruth(seed).bias_A(NUMBERS, degC, 70_000.0)
        assert (bias_A[:, :6] > 200e-9).all()
        assert (bias_A[:, 6:] < -180e-9).all()


def test_bias_walks_0_3_nA_per_root_hour():
    hours = 38.0
    walked_A = [
        NguTruth(s).bias_A(NUMBERS, 20.0, hours * 3600) - NguTruth(s).bias_A(NUMBERS, 20.0, 0.0) for s in range(60)
    ]
    assert np.std(walked_A) == pytest.approx(0.3e-9 * np.sqrt(hours), rel=0.1)


def test_bias_walk_is_the_same_in_any_order_of_asking():
    late_first, early_first = NguTruth(3), NguTruth(3)
    late = late_first.bias_A(NUMBERS, 20.0, 130_000.0)
    early_first.bias_A(NUMBERS, 20.0, 5.0)
    np.testing.assert_array_equal(late, early_first.bias_A(NUMBERS, 20.0, 130_000.0))
    grid = late_first.bias_A(NUMBERS, 20.0, np.array([5.0, 130_000.0])[:, None])
    np.testing.assert_array_equal(grid[1], late)


def test_coefficients_are_the_derivatives_of_the_error():
    truth = NguTruth(8)
    for polarity, error in (("n", truth.dsf_n_ppm), ("p", truth.dsf_p_ppm)):
        tc1, tc2 = truth.tc_ppm(4, polarity, 25.0)
        above, at, below = (float(error(4, t)) for t in (35.0, 25.0, 15.0))
        assert tc1 == pytest.approx((above - below) / 20.0)
        assert tc2 == pytest.approx((above - 2 * at + below) / 200.0)
        assert 5.0 < abs(truth.tc_ppm(4, polarity)[0]) < 11.0


def test_options_replace_the_clock_errors_and_switch_the_noise_off():
    truth = NguTruth(
        1, {"master_error_ppm": "-50", "af_clock_error_ppm": "50", "noise": "off", "calibrator_gain": "on"}
    )
    assert float(truth.master_error_ppm(20.0)) == -50.0
    assert truth.af_clock_error_ppm == 50.0
    assert truth.bias_A(1, 20.0, 0.0) == truth.bias_A(1, 20.0, 100_000.0)


def test_a_unit_comes_back_with_other_noise():
    first, second = NguTruth(1, {"unit_seed": "5"}), NguTruth(2, {"unit_seed": "5", "check_standard": "7:9"})
    channels = np.array([1, 2, 3, 4, 5, 6, 8, 9, 10])
    np.testing.assert_array_equal(first.dsf_n_ppm(channels, 40.0), second.dsf_n_ppm(channels, 40.0))
    assert first.master_ppm(40.0) == second.master_ppm(40.0) == NguTruth(5).master_ppm(40.0)
    assert first.bias_A(1, 40.0, 3600.0) != second.bias_A(1, 40.0, 3600.0)
    assert first.bias_tc_A(1, 0) == second.bias_tc_A(1, 0)
    assert second.dsf_p_ppm(7, 40.0) == NguTruth(9).dsf_p_ppm(7, 40.0) != first.dsf_p_ppm(7, 40.0)
    assert second.hysteresis_A[6] == NguTruth(9).hysteresis_A[6]


@pytest.mark.parametrize(
    "options",
    [{"noise": "maybe"}, {"master_error_ppm": "fast"}, {"af_clock_error_ppm": "1e9"}, {"master_error_ppm": "nan"},
     {"unit_seed": "-1"}, {"check_standard": "11:3"}, {"check_standard": "7"}],
)  # fmt: skip
def test_a_bad_option_is_refused(options):
    with pytest.raises(InputError) as caught:
        NguTruth(1, options)
    assert caught.value.code == "B-NGU-001"
    assert next(iter(options)) in str(caught.value)


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
