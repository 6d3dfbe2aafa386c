"""Estimators of a 100 s record: against the three-state charge balance clock by clock, and their stated intervals."""

from collections.abc import Callable

import numpy as np
import pytest
from pulse_simulation import (
    K0_C,
    Counts,
    FRAME_s,
    MASTER_Hz,
    WHITE_A_rtHz,
    clock_by_clock,
    clocks,
    cut,
    frames_at_once,
    steady,
    white,
)

from bench.model.ports import RecordWindow
from bench.systems.af_converter.estimators.readings import PulseConverters, PulseRecords, stack_records
from bench.systems.af_converter.estimators.record_rate import GATED, OMEGA, RECIPROCAL, RecordRates, record_rates, slope
from bench.systems.af_converter.nominal import pulses_in

FRAMES = 10_000
GYRO = PulseConverters(K0_C, K0_C, WHITE_A_rtHz, 256_000.0)


def records(counts: Counts, frames: int = FRAMES) -> PulseRecords:
    return stack_records(*cut(counts, frames), MASTER_Hz)


def rms_nA(rates: RecordRates, current_A: float | np.ndarray) -> float:
    """Over the records in which the estimator can be used; NaN if in none."""
    error = (rates.current_A - current_A)[np.isfinite(rates.current_A)]
    return float(np.sqrt(np.mean(error**2)) * 1e9) if error.size else float("nan")


def coverage(rates: RecordRates, current_A: float | np.ndarray) -> float:
    return float(100.0 * np.mean(np.abs(rates.current_A - current_A) < 1.96 * rates.std_uncertainty_A))


@pytest.mark.parametrize("seed", range(4))
def test_the_closed_form_of_the_rig_is_the_loop_over_clocks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = clocks(20, 80, 51.203, rng)
    current = rng.uniform(0.0, 0.9, (20, 1)) * K0_C * 5120.3 + white((20, 80), rng)
    start = rng.uniform(0.0, K0_C, 20)
    slow = clock_by_clock(current, edges, start, q_n_C=K0_C, q_p_C=K0_C, clock_s=1 / 5120.3, threshold_C=K0_C)
    fast = frames_at_once(current, edges, start, q_n_C=K0_C, clock_s=1 / 5120.3, threshold_C=K0_C)
    assert slow.n.sum() > 0
    assert np.array_equal(slow.n, fast.n)
    assert not slow.p.any()


@pytest.mark.validates(
    "omega estimator from the sums of a record",
    against="numpy.polynomial.polyfit of the cumulative counts",
)
@pytest.mark.parametrize("n", [2, 7, 500])
def test_the_slope_is_that_of_a_line_fitted_to_the_cumulative_counts(
    record_property: Callable[[str, object], None], n: int
) -> None:
    x = np.random.default_rng(n).integers(0, 2400, (5, n))
    found = slope(records(Counts(x, 0 * x, 1 + 0 * x), n).n, np.array([n]))[0]
    cumulative = np.concatenate((np.zeros((5, 1)), np.cumsum(x, axis=1)), axis=1)
    expected = np.polynomial.polynomial.polyfit(np.arange(n + 1.0), cumulative.T, 1)[1]
    record_property("obtained", f"{n} frames: {np.max(np.abs(found / expected - 1)):.0e}")
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.validates(
    "best estimator of a 100 s record, gyro channel, rms error below 0.25 nA",
    against="currents of 600 records each, pulses of the charge balance at every clock edge",
)
@pytest.mark.parametrize(
    ("nominal_A", "gated_nA", "best"),
    [
        (24e-9, 3.7, RECIPROCAL),
        (500e-9, 5.1, RECIPROCAL),
        (30e-6, 5.1, OMEGA),
        (100.4e-6, 5.1, OMEGA),
        (1.0004e-3, 5.1, OMEGA),
        (100.012e-3, 5.1, OMEGA),
    ],
)
def test_table_of_the_estimators(
    record_property: Callable[[str, object], None], nominal_A: float, gated_nA: float, best: str
) -> None:
    """200 trials, spread over two pulses per record where there are many, so that none is locked to the gate."""
    rng = np.random.default_rng(2026)
    current = nominal_A + rng.uniform(-1, 1, (200, 1)) * K0_C / 100.0 * (nominal_A > 1e-7)
    rows = records(steady(current, 200, 3 * FRAMES, rng))
    rms_of_gated_nA = rms_nA(record_rates(rows, GYRO, GATED), current[:, 0])
    rates = record_rates(rows, GYRO)
    later = RecordRates(**{name: getattr(rates, name)[1:] for name in RecordRates.__dataclass_fields__})
    best_nA, covered = rms_nA(later, current[:, 0]), coverage(later, current[:, 0])
    assert set(later.estimator.ravel()) == {best}, "the pulse before these records is known"
    record_property("obtained", f"{nominal_A * 1e9:.0f} nA: {best_nA:.2f}")
    assert best_nA < 0.25
    assert rms_of_gated_nA == pytest.approx(gated_nA, abs=0.7)
    assert covered >= 93.0  # 400 records, the three of a trial have one rate


@pytest.mark.parametrize(
    "rate_per_frame",
    [1e-4, 2e-4, 1.6e-4, 0.0032, 0.01, 0.0125, 0.02, 0.04, 0.1, 0.100007, 1 / 3, 0.5, 0.50005, 0.8, 1.0, 1.00006,
     1.0003, 8.0, 8.00007],
)  # fmt: skip
def test_stated_intervals_are_honest_where_pulses_lock_to_frames_or_gates(rate_per_frame: float) -> None:
    """400 nA are 32 pulses in a record, 12.5 nA one; other rates are a pulse in every k-th frame, or all but that."""
    rng = np.random.default_rng(round(rate_per_frame * 1e7))
    current = rate_per_frame * K0_C / FRAME_s
    rates = record_rates(records(steady(current, 400, FRAMES, rng)), GYRO)
    covered = coverage(rates, current)
    assert covered >= 92.0  # 95 % and 2.7 of its standard deviations


@pytest.mark.validates(
    "95 % intervals of the best estimator, 30 nA to 100 mA",
    against="currents of 1,500 records, pulses of the charge balance at every clock edge",
)
@pytest.mark.parametrize("noise", [True, False])
def test_stated_intervals_over_random_rates(record_property: Callable[[str, object], None], noise: bool) -> None:
    rng = np.random.default_rng(5)
    current = 10.0 ** rng.uniform(-7.5, -1.0, (1500, 1))
    counts = [steady(current[part], 100, FRAMES, rng, noise=noise) for part in np.split(np.arange(1500), 15)]
    found = [record_rates(records(one), GYRO) for one in counts]
    hit = np.concatenate([
        np.abs(one.current_A[0] - current[part, 0]) < 1.96 * one.std_uncertainty_A[0]
        for one, part in zip(found, np.split(np.arange(1500), 15), strict=True)
    ])  # fmt: skip
    used = np.concatenate([one.estimator[0] for one in found])
    record_property("obtained", f"{'with' if noise else 'without'} noise {100 * hit.mean():.1f} %, at least 94")
    assert {OMEGA, RECIPROCAL} <= set(used)
    assert 100 * hit.mean() >= 94.0


def loop(current_A, q_n_C: float, q_p_C: float, rng) -> PulseRecords:
    """Records of 1000 frames from the loop over clocks; a slow AF clock keeps it short."""
    edges = clocks(current_A.shape[0], current_A.shape[1], 6.37, rng)
    start = rng.uniform(-q_p_C, q_n_C, current_A.shape[0])
    threshold = max(q_n_C, q_p_C)
    return records(
        clock_by_clock(
            current_A, edges, start, q_n_C=q_n_C, q_p_C=q_p_C, clock_s=FRAME_s / 6.37, threshold_C=threshold
        ),
        1000,
    )


SLOW_CLOCK = PulseConverters(1.25e-6, 1.1e-6, WHITE_A_rtHz, 637.0)


@pytest.mark.parametrize("current_A", [-41.3e-6, -2.137e-6, 3.071e-6, 45.3e-6])
def test_each_polarity_has_its_own_charge(current_A: float) -> None:
    """Clock by clock, K_N and K_P 12 % apart: the sign and the size are those of the current that flowed."""
    rng = np.random.default_rng(8)
    flowed = current_A + white((60, 3000), rng)
    rows = loop(flowed, 1.25e-6, 1.1e-6, rng)
    for only in (None, GATED):
        rates = record_rates(rows, SLOW_CLOCK, only)
        error = rates.current_A[1:] - current_A
        assert np.mean(np.abs(error) < 1.96 * rates.std_uncertainty_A[1:]) >= 0.9
        assert abs(np.mean(error)) < 4 * np.std(error) / np.sqrt(60)


def by_hand(n_frames: list[int], p_frames: list[int]) -> RecordRates:
    """Reciprocal of two contiguous records of ten frames with single pulses in the frames named (from 0)."""
    n, p = np.zeros((1, 20), int), np.zeros((1, 20), int)
    n[0, n_frames], p[0, p_frames] = 1, 1
    return record_rates(records(Counts(n, p, np.full((1, 20), 2560)), 10), GYRO, RECIPROCAL)


@pytest.mark.parametrize(
    ("n_frames", "p_frames", "pulses", "first", "last"),
    [
        ([3, 7, 12, 14], [], 2, 7, 14),  # the pulse before the record serves
        ([3, 12, 16], [7], 1, 12, 16),  # but not if the other polarity came after it
        ([7, 15, 19], [11], 1, 15, 19),  # or comes before the first own one
        ([7, 11], [14, 18], 1, 7, 11),  # a change of polarity ends the count
        ([7], [13, 19], -1, 13, 19),
    ],
)
def test_which_pulses_the_reciprocal_takes(n_frames, p_frames, pulses: int, first: int, last: int) -> None:
    found = by_hand(n_frames, p_frames)
    assert found.current_A[1, 0] == pytest.approx(pulses * K0_C / ((last - first) * FRAME_s), rel=1e-12)
    assert found.start_s[1, 0] == pytest.approx((first - 10 + 0.5) * FRAME_s)
    assert found.end_s[1, 0] == pytest.approx((last - 10 + 0.5) * FRAME_s)
    assert found.joined[1, 0] == (first == 7 and n_frames[0] == 3)
    assert np.isnan(by_hand([7, 12, 18], [15]).current_A[1, 0]), "both polarities in turn"


def test_reciprocal_never_counts_across_a_change_of_polarity() -> None:
    """From -3 uA to 3 uA: the charge between the thresholds, two pulses, belongs to neither rate."""
    rng = np.random.default_rng(9)
    flowed = np.repeat([[-3e-6, 3e-6]], 1500, axis=1).reshape(1, 2, 1500).reshape(1, 3000)
    rows = loop(flowed.repeat(50, axis=0), 1.25e-6, 1.1e-6, rng)
    rates = record_rates(rows, SLOW_CLOCK)
    found = record_rates(rows, SLOW_CLOCK, RECIPROCAL)
    assert ((rows.n.count[1] > 0) & (rows.p.count[1] > 0)).all()
    before = found.current_A[1] < 0
    assert np.abs(np.where(before, -3e-6, 3e-6) - found.current_A[1]).max() < 4 * found.std_uncertainty_A[1].max()
    assert np.abs(rates.current_A[2] - 3e-6).max() < 4 * rates.std_uncertainty_A[2].max()
    assert (found.start_s[2] < 0).all(), "the pulse before the record is of the same polarity"


def test_current_that_crosses_zero_leaves_the_gated_count() -> None:
    rng = np.random.default_rng(10)
    flowed = 3e-6 * np.sin(np.arange(1000) * 2 * np.pi / 370) * np.ones((30, 1))
    rates = record_rates(loop(flowed, 1.25e-6, 1.1e-6, rng), SLOW_CLOCK)
    gated = rates.estimator[0] == GATED
    true = flowed.mean()
    assert gated.any()
    assert (np.abs(rates.current_A[0] - true)[gated] < 1.96 * rates.std_uncertainty_A[0][gated]).all()


def test_the_gated_count_serves_without_timing_and_where_frames_were_lost() -> None:
    """Nothing serves without a clock or a gate."""
    windows, sums, timing = cut(steady(400e-9, 3, 3 * FRAMES, np.random.default_rng(11)), FRAMES)
    timing[1] = {}
    windows[2] = (windows[2][0], FRAMES - 30, 30)
    sums[2]["master_count"] = round((FRAMES - 30) * FRAME_s * MASTER_Hz)
    rates = record_rates(stack_records(windows, sums, timing, MASTER_Hz), GYRO)
    assert rates.estimator[:, 0].tolist() == [RECIPROCAL, GATED, GATED]
    assert rates.std_uncertainty_A[2] == pytest.approx(np.sqrt(31) * rates.std_uncertainty_A[1], rel=0.01)
    assert not rates.joined[2].any()
    assert (rates.end_s[:, 0] <= 100.0).all()
    sums[0]["af_clock"], sums[1]["master_count"] = 0, 0
    assert np.isnan(record_rates(stack_records(windows, sums, timing, MASTER_Hz), GYRO).current_A[:2]).all()


def test_neighbours_are_joined_where_they_share_a_cut() -> None:
    rows = records(steady(400e-9, 4, 3 * FRAMES, np.random.default_rng(12)))
    best, gated, omega = (record_rates(rows, GYRO, only) for only in (None, GATED, OMEGA))
    assert best.joined.tolist() == [[False] * 4, [True] * 4, [True] * 4]
    assert best.start_s[1:] + 100.0 == pytest.approx(best.end_s[:-1], abs=1e-9)
    assert gated.joined.tolist() == [[False] * 4, [True] * 4, [True] * 4]
    assert not omega.joined.any()
    assert gated.quantum_C == pytest.approx(K0_C)


def test_a_clock_off_by_50_ppm_changes_nothing() -> None:
    """Pulses get smaller with a fast AF clock; the counted clock says so."""
    for only in (OMEGA, None):
        found = [
            record_rates(
                records(steady(30.04e-6, 50, FRAMES, np.random.default_rng(14), clock_error=error)), GYRO, only
            )
            for error in (-50e-6, 50e-6)
        ]
        assert abs(np.mean(found[0].current_A - found[1].current_A)) < 0.15e-9  # 100 ppm would be 3 nA


def test_gated_count_covers_over_random_rates() -> None:
    rng = np.random.default_rng(6)
    current = rng.uniform(50e-9, 5e-6, (2000, 1))
    rates = record_rates(records(steady(current, 2000, 2000, rng), 2000), GYRO, GATED)
    covered = coverage(rates, current[:, 0])
    assert covered == pytest.approx(96.0, abs=1.5)  # triangular: 96.0 %


WINDOW_FRAMES = 2000


def window(number: int) -> RecordWindow:
    return RecordWindow(
        number, "port_a", 500 + number * WINDOW_FRAMES, WINDOW_FRAMES, number * 20 * 10**9, (number + 1) * 20 * 10**9
    )


def test_many_pulses_take_no_room() -> None:
    """A bias of the wrong unit gives more pulses than fit in any memory; each frame has the same number of them."""
    found = pulses_in(0.25, 5e12, window(0))
    assert found["count"] == 5_000_000_000_000
    assert found["moment1"] == pytest.approx(5e12 * (WINDOW_FRAMES + 1) / 2)
    assert (found["first"], found["at_first"], found["at_last"]) == (500, 2_500_000_000, 2_500_000_000)


@pytest.mark.parametrize("per_window", [0.0, 0.3, 6.4, 51.0, 3500.7])
def test_each_pulse_is_in_its_frame(per_window: float) -> None:
    """The k-th pulse comes when the charge is k quanta; frames are sorted and counted by hand."""
    total, frames_of = 0, []
    for number in range(5):
        begin = 0.25 + number * per_window
        found = pulses_in(begin, per_window, window(number))
        frames = [
            int((k - begin) / per_window * WINDOW_FRAMES) + 1
            for k in range(1, 30_000)
            if begin < k <= begin + per_window
        ]
        frames = [min(frame, WINDOW_FRAMES) for frame in frames]
        assert found["count"] == len(frames)
        assert found["moment1"] == sum(frames)
        assert found["moment2"] == sum(frame**2 for frame in frames)
        if frames:
            first, last = window(number).first_counter + frames[0] - 1, window(number).first_counter + frames[-1] - 1
            assert (found["first"], found["last"]) == (first, last)
            assert (found["at_first"], found["at_last"]) == (frames.count(frames[0]), frames.count(frames[-1]))
        else:
            assert (found["first"], found["last"], found["at_first"], found["at_last"]) == (-1, -1, 0, 0)
        total += found["count"]
        frames_of += frames
    assert total == int(np.floor(0.25 + 5 * per_window)) == len(frames_of)
