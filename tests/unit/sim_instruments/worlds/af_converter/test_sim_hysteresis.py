"""The hysteresis of the simulated bias: the play operator, what drives it, and that the past stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
from ngu_counts import count_windows
from sim_bench import station

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from sim_instruments.worlds.af_converter.block import BlockFactory
from sim_instruments.worlds.af_converter.constants import KINDS
from sim_instruments.worlds.af_converter.gates import Drive, GateMachine
from sim_instruments.worlds.af_converter.ngu import Ngu
from sim_instruments.worlds.af_converter.truth import estimates
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.thermal import Thermal, follow, play_after
from sim_instruments.worlds.simulation import open_world

NUMBERS = np.arange(1, 11)
K0_C = np.array([kind.k0_C for kind in KINDS])
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


def test_play_by_hand() -> None:
    """Up to 10, back: rests while 2 r are crossed; an inner loop smaller than 2 r leaves no trace."""
    assert play_after((0.0,), 2.0) == 0.0
    assert play_after((0.0, 1.5), 2.0) == 0.0
    assert play_after((0.0, 10.0), 2.0) == 8.0
    assert play_after((0.0, 10.0, 6.5), 2.0) == 8.0
    assert play_after((0.0, 10.0, 5.0), 2.0) == 7.0
    assert play_after((0.0, 10.0, 6.5, 9.0, 7.0), 2.0) == 8.0
    np.testing.assert_array_equal(follow([8.0, 8.0], 20.0, [2.0, 3.0]), [18.0, 17.0])


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


def test_what_is_commanded_later_leaves_the_past() -> None:
    thermal = ramped()
    now_ns = (RAMP_START_S + 48_000) * NS  # the unit has just turned at the top and will not again by itself
    t_ns = np.linspace(0, now_ns, 997).astype(np.int64)
    before = thermal.play_offset_degC(t_ns, 2.5)
    turns = thermal.turns_degC(now_ns)
    thermal.ramp(60.0, 1.0, now_ns)
    np.testing.assert_array_equal(thermal.play_offset_degC(t_ns, 2.5), before)
    assert thermal.turns_degC(now_ns)[: len(turns)] == turns
    assert thermal.turns_degC(now_ns + 7200 * NS) != turns


def test_the_rate_is_the_derivative() -> None:
    thermal = ramped()
    for t_s in (300, 2000, 9000, 40_000, 77_500, 90_000):
        slope = (thermal.unit_degC((t_s + 1) * NS) - thermal.unit_degC((t_s - 1) * NS)) / 2
        degC, rate_degC_s = thermal.unit_moment(t_s * NS)
        assert degC == pytest.approx(float(thermal.unit_degC(t_s * NS)), rel=1e-15)
        assert rate_degC_s == pytest.approx(slope, abs=1e-8)


def test_the_drawn_loops_are_as_designed() -> None:
    truths = [NguTruth(seed) for seed in range(100)]
    width_nA = np.abs([truth.hysteresis_A for truth in truths]) * 1e9
    half_width = np.array([truth.half_width_degC for truth in truths])
    for kind, nA, degC in ((slice(0, 6), 20.0, 2.5), (slice(6, 10), 18.0, 3.0)):
        assert 0.8 * nA <= width_nA[:, kind].min() < 0.85 * nA < 1.15 * nA < width_nA[:, kind].max() <= 1.2 * nA
        assert 0.8 * degC <= half_width[:, kind].min() < half_width[:, kind].max() <= 1.2 * degC
    assert 400 < sum((truth.hysteresis_A > 0).sum() for truth in truths) < 600


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


def test_all_channels_at_once_are_the_channels_one_by_one() -> None:
    truth, offset = NguTruth(5), np.linspace(-3.0, 3.0, 10)
    np.testing.assert_allclose(
        truth.all_bias_A(33.0, 777.0, offset), truth.bias_A(NUMBERS, 33.0, 777.0, offset), rtol=1e-14
    )


def test_the_curve_bends_by_a_few_nA_over_the_range() -> None:
    for seed in range(20):
        for number in NUMBERS.tolist():
            square, cube = (NguTruth(seed).bias_tc_A(number, order) * 1e9 for order in (2, 3))
            assert 0.5 < abs(square) * 30**2 < 6.0
            assert 0.5 < abs(cube) * 30**3 < 4.0


def test_hysteresis_can_be_switched_off() -> None:
    truth = NguTruth(4, {"hysteresis": "off"})
    assert not truth.hysteresis_A.any()
    assert truth.bias_A(1, 20.0, 0.0, 2.5) == truth.bias_A(1, 20.0, 0.0)
    options = {"hysteresis": "off"}
    world = open_world("af_converter", clock=VirtualClock(), seed=1, station=station(), options=options)
    world.close()
    assert not world.unit.truth.hysteresis_A.any()
    with pytest.raises(InputError, match="hysteresis") as caught:
        NguTruth(4, {"hysteresis": "no"})
    assert caught.value.code == "B-NGU-001"


# --- the unit in time ------------------------------------------------------------------------------------------------


def test_ten_seconds_at_once_are_ten_seconds_of_small_steps() -> None:
    """Mean bias of a block against the truth at its gates, on the ramp and where the play is crossed: < 0.005 nA."""
    truth, thermal = NguTruth(2), ramped()
    factory = BlockFactory(truth, thermal.unit, 0, 0)
    for t_s in (RAMP_START_S + 9000, RAMP_START_S + 20_000, RAMP_START_S + 48_000, RAMP_START_S + 60_000):
        (block,) = factory.make(t_s // 10, float(t_s), 0)
        t_ns = t_s * NS + np.arange(0, 10_000, 10) * NS // 1000 + NS // 200
        unit_degC = thermal.unit_degC(t_ns)
        for number in NUMBERS.tolist():
            offset = thermal.play_offset_degC(t_ns, truth.half_width_degC[number - 1])
            mean_A = truth.bias_A(number, unit_degC, t_ns / NS, offset).mean()
            assert abs(block.bias_A[number - 1] - mean_A) < 5e-12


def test_records_on_a_ramp_have_the_counts_of_their_frames() -> None:
    """Contiguous windows across the turn at the top, noise off: charge of the frames against the one-step counts."""
    truth, thermal = NguTruth(6, {"noise": "off", "master_error_ppm": "0"}), ramped()
    start_s, m = RAMP_START_S + 46_000, 50
    machine = GateMachine(BlockFactory(truth, thermal.unit, start_s * NS, 0), Drive())
    rows = machine.run((start_s + 100 * m) * NS + NS // 100)
    frames = {
        name: np.concatenate([getattr(part, name) for part in rows], axis=1)[:, : m * 10_000] for name in ("npp", "ppp")
    }
    middle_ns = (start_s + 50 + 100 * np.arange(m)) * NS
    offset = np.stack([thermal.play_offset_degC(middle_ns, r) for r in truth.half_width_degC], axis=1)
    counts = count_windows(
        truth,
        np.zeros((m, 10)),
        start_s + 100.0 * np.arange(m),
        thermal.unit_degC(middle_ns),
        play_offset_degC=offset,
        settle_s=0.0,
    )
    for name in ("npp", "ppp"):
        windows = frames[name].reshape(10, m, 10_000).sum(axis=2, dtype=np.int64).T
        # two pulses for the first charge and the clock edges, and 0.05 nA in the mean of 50 windows
        limit = 2 + 0.05e-9 * 100 * m / K0_C
        assert (np.abs(windows.sum(axis=0) - getattr(counts, name).sum(axis=0)) <= limit).all()


@pytest.mark.parametrize("pause_s", [0.7, 37.0, 400.0])
def test_bytes_do_not_depend_on_when_they_are_read(pause_s: float) -> None:
    """Chamber commands on the way; the unit works ahead through every pause."""

    def sent(pause_s: float) -> bytes:
        clock, thermal = VirtualClock(), Thermal()
        unit = Ngu(clock, 9, thermal.unit)
        unit.connect("port_a", 921_600)
        unit.set_power(True, clock.now_ns())
        found = bytearray()
        for target_degC, until_s in ((35.0, 400), (10.0, 800), (35.0, 1200)):
            thermal.ramp(target_degC, 20.0, clock.now_ns())
            while clock.now_ns() < until_s * NS:
                clock.sleep_until_ns(min(clock.now_ns() + round(pause_s * NS), until_s * NS))
                found += unit.read("port_a", 10**8)
        return bytes(found)

    assert sent(pause_s) == sent(5.0)


# --- the truth list --------------------------------------------------------------------------------------------------


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


def test_a_unit_without_hysteresis_has_no_half_width() -> None:
    found = estimates(NguTruth(3, {"hysteresis": "off"}), ramped(), bias_campaign_windows())
    assert {e["value"] for e in found if e["quantity"] == "hysteresis_width"} == {0.0}
    assert not [e for e in found if e["quantity"] == "play_half_width"]
