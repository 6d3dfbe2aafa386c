"""What is true of a simulated unit: its random walk, and the hysteresis of its bias, what drives it, its past."""

import tracemalloc

import numpy as np
import pytest

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.block import BlockFactory
from sim_instruments.worlds.af_converter.constants import CHANNELS, WALK_A_RTH
from sim_instruments.worlds.af_converter.unit_constants import BiasWalk, NguTruth
from sim_instruments.worlds.af_converter.world import estimates
from sim_instruments.worlds.common.thermal import Thermal

NUMBERS = np.arange(1, 11)
BRANCHES = (("hold_start", 2), ("up", 10), ("hold_top", 1), ("down", 10), ("hold_end", 2))  # hours
RAMP_START_S = 30_000


def ramped() -> Thermal:
    """Down to -10 degC, then the bias ramp of 25 h from 30,000 s on."""
    thermal = Thermal()
    thermal.ramp(-10.0, 0.5, 600 * NS)
    thermal.ramp(50.0, 0.1, (RAMP_START_S + 7200) * NS)
    thermal.ramp(-10.0, 0.1, (RAMP_START_S + 46_800) * NS)
    return thermal


def literal_play(degC: np.ndarray, half_width: float) -> np.ndarray:
    """The definition: a rod with slack +-r that is pushed from one end or the other, sample after sample."""
    state, found = float(degC[0]), []
    for value in degC.tolist():
        if value - state > half_width:
            state = value - half_width
        elif state - value > half_width:
            state = value + half_width
        found.append(state)
    return np.array(found)


@pytest.mark.validates(
    "hysteresis of the simulated unit, exact in time",
    against="the definition of the play operator, sample by sample each second",
)
def test_offset_against_the_definition_on_a_fine_grid() -> None:
    """Commands in the middle of ramps, so that the unit turns inside segments as well."""
    thermal = ramped()
    thermal.hold(80_000 * NS)
    thermal.ramp(41.0, 1.0, 80_700 * NS)
    thermal.ramp(20.0, 0.5, 81_300 * NS)
    thermal.stop(83_000 * NS)
    t_ns = np.arange(0, 95_000 * NS, NS)
    unit_degC = thermal.unit_degC(t_ns)
    for half_width in (0.4, 2.1, 3.5, 40.0):
        exact = thermal.play_offset_degC(t_ns, half_width) + unit_degC
        assert np.abs(exact - literal_play(unit_degC, half_width)).max() < 1e-6
    at_degC = [float(thermal.unit_degC(t)) for t in thermal._turns[0]]
    sampled = unit_degC[1:-1][np.diff(np.sign(np.diff(unit_degC))) != 0]
    turning = sampled[np.abs(np.diff(sampled, prepend=0.0)) > 1e-3]
    assert len(turning) >= 3
    assert all(np.abs(np.array(at_degC) - degC).min() < 1e-6 for degC in turning)


def test_commands_leave_the_past_and_rates_are_derivatives() -> None:
    thermal = ramped()
    now_ns = (RAMP_START_S + 48_000) * NS  # the unit has just turned at the top and will not again by itself
    t_ns = np.linspace(0, now_ns, 997).astype(np.int64)
    before = thermal.play_offset_degC(t_ns, 2.5)
    turns = thermal.turns_degC(now_ns)
    thermal.ramp(60.0, 1.0, now_ns)
    np.testing.assert_array_equal(thermal.play_offset_degC(t_ns, 2.5), before)
    assert thermal.turns_degC(now_ns)[: len(turns)] == turns
    assert thermal.turns_degC(now_ns + 7200 * NS) != turns
    thermal = ramped()
    for t_s in (300, 2000, 9000, 40_000, 77_500, 90_000):
        slope = (thermal.unit_degC((t_s + 1) * NS) - thermal.unit_degC((t_s - 1) * NS)) / 2
        degC, rate_degC_s = thermal.unit_moment(t_s * NS)
        assert degC == pytest.approx(float(thermal.unit_degC(t_s * NS)), rel=1e-15)
        assert rate_degC_s == pytest.approx(slope, abs=1e-8)


def test_loops_and_curves_are_drawn_as_designed() -> None:
    truths = [NguTruth(seed) for seed in range(100)]
    width_nA = np.abs([truth.hysteresis_A for truth in truths]) * 1e9
    half_width = np.array([truth.half_width_degC for truth in truths])
    for kind, nA, degC in ((slice(0, 6), 20.0, 2.5), (slice(6, 10), 18.0, 3.0)):
        assert 0.8 * nA <= width_nA[:, kind].min() < 0.85 * nA < 1.15 * nA < width_nA[:, kind].max() <= 1.2 * nA
        assert 0.8 * degC <= half_width[:, kind].min() < half_width[:, kind].max() <= 1.2 * degC
    assert 400 < sum((truth.hysteresis_A > 0).sum() for truth in truths) < 600
    for seed in range(20):
        for number in NUMBERS.tolist():
            square, cube = (NguTruth(seed).bias_tc_A(number, order) * 1e9 for order in (2, 3))
            assert 0.5 < abs(square) * 30**2 < 6.0
            assert 0.5 < abs(cube) * 30**3 < 4.0


def test_falling_minus_rising_is_the_width_and_the_centre_is_the_cubic() -> None:
    truth, thermal = NguTruth(4, {"noise": "off"}), ramped()
    up_ns, down_ns = (RAMP_START_S + 25_000) * NS, (RAMP_START_S + 65_000) * NS
    for number in NUMBERS.tolist():
        offset = thermal.play_offset_degC(np.array([up_ns, down_ns]), truth.half_width_degC[number - 1])
        np.testing.assert_allclose(offset, np.array([-1.0, 1.0]) * truth.half_width_degC[number - 1])
        rising_A, falling_A = truth.bias_A(number, 23.0, 0.0, offset)
        assert falling_A - rising_A == pytest.approx(truth.hysteresis_A[number - 1], rel=1e-9)
        curve = [truth.bias_tc_A(number, order) for order in range(4)]
        assert (falling_A + rising_A) / 2 == pytest.approx(np.polynomial.polynomial.polyval(3.0, curve), rel=1e-12)


def test_ten_seconds_at_once_are_ten_seconds_of_small_steps() -> None:
    """Mean bias of a block against the truth at its gates, on the ramp and where the play is crossed: < 0.005 nA."""
    truth, thermal = NguTruth(2), ramped()
    factory = BlockFactory(truth, thermal, 0, 0)
    for t_s in (RAMP_START_S + 9000, RAMP_START_S + 20_000, RAMP_START_S + 48_000, RAMP_START_S + 60_000):
        (block,) = factory.make(t_s // 10, float(t_s), 0)
        t_ns = t_s * NS + np.arange(0, 10_000, 10) * NS // 1000 + NS // 200
        unit_degC = thermal.unit_degC(t_ns)
        for number in NUMBERS.tolist():
            offset = thermal.play_offset_degC(t_ns, truth.half_width_degC[number - 1])
            mean_A = truth.bias_A(number, unit_degC, t_ns / NS, offset).mean()
            assert abs(block.bias_A[number - 1] - mean_A) < 5e-12


def bias_campaign_windows() -> list[RecordWindow]:
    branches = [name for name, hours in BRANCHES for _ in range(hours * 36)]
    return [
        RecordWindow(
            number, "port_a", 0, 10_000, (RAMP_START_S + 100 * number) * NS, (RAMP_START_S + 100 * number + 100) * NS,
            {"route": "open", "branch": branch, "window_index": number, "purpose": "measurement"},
        )
        for number, branch in enumerate(branches)
    ]  # fmt: skip


def test_truth_of_a_bias_campaign() -> None:
    truth = NguTruth(3)
    windows = bias_campaign_windows()
    found = estimates(truth, ramped(), windows)
    assert len(windows) == 900
    by_key = {
        (e["quantity"], e["conditions"].get("channel"), e["conditions"].get("temperature_degC")): e for e in found
    }
    assert len(by_key) == len(found) == 10 * (5 + 3 + 3) + 5 + 4
    walk_A = truth.bias_A(7, 20.0, RAMP_START_S + np.arange(0, 90_000, 100.0)).mean() - truth.bias_tc_A(7, 0)
    for degC in (-10.0, 5.0, 20.0, 35.0, 50.0):
        curve = sum(truth.bias_tc_A(7, order) * (degC - 20.0) ** order for order in range(4))
        one = by_key["bias", 7, degC]
        assert one["value"] == pytest.approx(curve + walk_A, abs=2e-12)
        assert one["conditions"] == {"channel": 7, "kind": "accelerometer", "temperature_degC": degC}
        master = by_key["master_clock_error", None, degC]["value"]
        terms = [by_key[f"master_clock_error_tc{order}", None, None]["value"] for order in range(4)]
        assert master == pytest.approx(np.polynomial.polynomial.polyval(degC - 20.0, terms), rel=1e-12)
    assert by_key["hysteresis_width", 2, None]["value"] == truth.hysteresis_A[1]
    assert by_key["play_half_width", 2, None]["value"] == truth.half_width_degC[1]
    assert by_key["thermal_lag", 2, None]["value"] == 25.0
    units = {e["quantity"]: e["unit"] for e in found}
    assert (units["bias_tc1"], units["bias_tc3"]) == ("A/degC", "A/degC3")
    assert units["master_clock_error_tc2"] == "ppm/degC2"
    truth = NguTruth(3, {"hysteresis": "off"})
    assert truth.bias_A(1, 20.0, 0.0, 2.5) == truth.bias_A(1, 20.0, 0.0)
    found = estimates(truth, ramped(), bias_campaign_windows())
    assert {e["value"] for e in found if e["quantity"] == "hysteresis_width"} == {0.0}
    assert not [e for e in found if e["quantity"] == "play_half_width"]


ALL = np.arange(CHANNELS)
BLOCK_s = 40_960.0  # 4,096 steps of 10 s
TIMES_s = np.array([0.0, 3.3, 10.0, 20_000.0, BLOCK_s - 10.0, BLOCK_s - 4.2, BLOCK_s, BLOCK_s + 5.0, 136_800.0])


def test_errors_spread_as_designed():
    drawn = np.array([NguTruth(seed).dsf_ppm(NUMBERS, 20.0) for seed in range(200)])
    assert abs(drawn.mean()) < 4 * 400 / np.sqrt(drawn.size)
    assert drawn.std() == pytest.approx(400, rel=0.05)
    assert abs(np.corrcoef(drawn[:, 0].ravel(), drawn[:, 1].ravel())[0, 1]) < 0.1
    degC = np.linspace(-12, 52, 33)[:, None]
    for seed in range(100):
        bias_A = NguTruth(seed).bias_A(NUMBERS, degC, 70_000.0)
        assert (bias_A[:, :6] > 200e-9).all()
        assert (bias_A[:, 6:] < -180e-9).all()
    hours = 38.0
    walked_A = [
        NguTruth(s).bias_A(NUMBERS, 20.0, hours * 3600) - NguTruth(s).bias_A(NUMBERS, 20.0, 0.0) for s in range(60)
    ]
    assert np.std(walked_A) == pytest.approx(0.3e-9 * np.sqrt(hours), rel=0.1)


def test_a_unit_is_a_function_of_its_seed_and_comes_back_with_other_noise():
    first, same, other = NguTruth(5), NguTruth(5), NguTruth(6)
    at = (NUMBERS, 31.5, 80_000.0)
    np.testing.assert_array_equal(first.bias_A(*at), same.bias_A(*at))
    assert (first.bias_A(*at) != other.bias_A(*at)).all()
    first, second = NguTruth(1, {"unit_seed": "5"}), NguTruth(2, {"unit_seed": "5", "check_standard": "7:9"})
    channels = np.array([1, 2, 3, 4, 5, 6, 8, 9, 10])
    np.testing.assert_array_equal(first.dsf_ppm(channels, 40.0), second.dsf_ppm(channels, 40.0))
    assert first.master_error_ppm(40.0) == second.master_error_ppm(40.0) == NguTruth(5).master_error_ppm(40.0)
    assert first.bias_A(1, 40.0, 3600.0) != second.bias_A(1, 40.0, 3600.0)
    assert first.bias_tc_A(1, 0) == second.bias_tc_A(1, 0)
    own, other = (unit.dsf_ppm(7, 40.0) for unit in (first, NguTruth(9)))
    assert (second.dsf_ppm(7, 40.0) == other).all()
    assert (own != other).all()
    assert second.hysteresis_A[6] == NguTruth(9).hysteresis_A[6]


def test_coefficients_are_the_derivatives_of_the_error():
    truth = NguTruth(8)
    for polarity, (above, at, below) in zip("np", truth.dsf_ppm(4, [30.0, 20.0, 10.0]), strict=True):
        tc1, tc2 = truth.tc_ppm(4, polarity)
        assert tc1 == pytest.approx((above - below) / 20.0)
        assert tc2 == pytest.approx((above - 2 * at + below) / 200.0)
        assert 5.0 < abs(tc1) < 11.0


def test_options_replace_the_clock_errors_and_switch_the_noise_off():
    truth = NguTruth(
        1, {"master_error_ppm": "-50", "af_clock_error_ppm": "50", "noise": "off", "calibrator_gain": "on"}
    )
    assert float(truth.master_error_ppm(20.0)) == -50.0
    assert truth.af_clock_error_ppm == 50.0
    assert truth.bias_A(1, 20.0, 0.0) == truth.bias_A(1, 20.0, 100_000.0)


@pytest.mark.parametrize(
    "options",
    [{"noise": "maybe"}, {"hysteresis": "no"}, {"master_error_ppm": "fast"}, {"af_clock_error_ppm": "1e9"},
     {"master_error_ppm": "nan"}, {"unit_seed": "-1"}, {"check_standard": "11:3"}, {"check_standard": "7"}],
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


def test_it_is_the_walk_of_all_steps_bit_for_bit_in_any_order() -> None:
    steps, walk = whole_walk_A(7, 4), BiasWalk(7)
    for step in (0, 1, 4094, 4095, 4096, 8191, 8192, 13_000):
        assert np.array_equal(walk.at(ALL, step * 10.0), steps[step]), step
    half = walk.at(ALL, BLOCK_s - 5.0)
    assert half == pytest.approx((steps[4095] + steps[4096]) / 2, rel=1e-12)
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
