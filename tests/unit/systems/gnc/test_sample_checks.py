"""Samples that are wrong, each fault put in by hand, none where there is none; the clock of the unit."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from imu_material import IMU, POSES, RATE_Hz, Rig
from scipy import stats

from bench.maths import samples as faults
from bench.maths import stamps as stamp_checks
from bench.systems.gnc.estimators import clocks
from bench.systems.gnc.rows import SampledRow, check_notes, finding_text
from bench.systems.gnc.rows import checked as checked_rows

COUNT, INTERVAL_s = 4000, 0.005
LIMITS = {"gyro": 80_000.0, "accel": 50_000.0}
CLOCK_SEED = 17


def record(seed: int = 121) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    gyro = np.round(rng.normal(0.0, 14.0, (COUNT, 3))).astype(np.int64)
    accel = np.round(np.array([0, 0, 1000]) + rng.normal(0.0, 1.4, (COUNT, 3))).astype(np.int64)
    return {"gyro": gyro, "accel": accel}


def ticks_s(seed: int = 122) -> np.ndarray:
    return np.asarray(np.arange(COUNT) * INTERVAL_s + np.random.default_rng(seed).normal(0, 2e-6, COUNT))


def checked(
    columns: dict[str, np.ndarray], counter: np.ndarray | None = None, tick_s: np.ndarray | None = None
) -> list[faults.Finding]:
    number = np.arange(COUNT) if counter is None else counter
    findings = [*faults.check_samples(columns, number, LIMITS).findings]
    return findings if tick_s is None else [*findings, *stamp_checks.check_ticks(tick_s, number, INTERVAL_s).faults]


def kinds(findings: Sequence[faults.Finding]) -> set[str]:
    return {finding.kind for finding in findings}


def clipped(gyro: np.ndarray, _: np.ndarray) -> None:
    gyro[:, 0] = np.minimum(gyro[:, 0], 15)


def at_the_end(gyro: np.ndarray, _: np.ndarray) -> None:
    gyro[500:520, 1], gyro[600, 1] = 80_000, -80_000


def hangs(_: np.ndarray, accel: np.ndarray) -> None:
    accel[1000:1040, 2] = accel[1000, 2]


def repeats(*both: np.ndarray) -> None:
    for values in both:
        values[301], values[900:903] = values[300], values[899]


@pytest.mark.parametrize(
    ("wrong", "kind", "channel", "counts", "first", "said"),
    [
        (at_the_end, faults.SATURATED, "gyro y", (21,), (500,), "at the end of the range"),
        # as by an amplifier
        (clipped, faults.HELD, "gyro x", range(1, COUNT), range(COUNT), "held at their extreme 15"),
        (hangs, faults.RUNS, "accel z", (39, 40), (999, 1000), "accelerometer z"),
        (lambda gyro, _: gyro[500:3500, 0].fill(7), faults.RUNS, "gyro x", (2999, 3000), (499, 500), "gyro x"),
        (lambda gyro, _: gyro[:, 2].fill(0), faults.FROZEN, "gyro z", (COUNT - 1, COUNT), (0,), "gyro z"),
        (repeats, faults.REPEATED, None, (4,), (301,), "4"),
    ],
)
def test_each_fault_is_found_with_its_channel_count_and_place(
    wrong: Callable[..., None], kind: str, channel: str | None, counts: Sequence[int], first: Sequence[int], said: str
) -> None:
    columns = record()
    assert checked(columns, tick_s=ticks_s()) == []
    wrong(columns["gyro"], columns["accel"])
    found = checked(columns)
    (finding,) = [each for each in found if each.kind == kind]
    assert kind in (faults.SATURATED, faults.HELD) or kinds(found) == {kind}
    assert finding.channel == channel or channel is None
    assert (finding.of, finding.refused) == (COUNT, kind not in (faults.FROZEN, faults.REPEATED))
    assert finding.count in counts
    assert finding.first in first
    assert said in finding_text(finding)


def test_gaps_and_two_samples_with_one_counter() -> None:
    counter = np.arange(COUNT)
    assert faults.check_samples(record(), counter, LIMITS) == faults.SampleChecks(COUNT, 0, ())
    counter[700:] -= 1
    found = checked(record(), counter)
    assert "1 of them with its counter" in finding_text(found[0])
    assert kinds(found) == {faults.REPEATED}
    counter = np.arange(COUNT)
    counter[100:] += 7
    counter[2000:] += 1
    found = checked(record(), counter)
    assert (faults.check_samples(record(), counter, LIMITS).missing, kinds(found)) == (8, {faults.GAPS})
    assert (found[0].first, found[0].count, found[0].of, found[0].refused) == (100, 8, 4008, False)
    said = "8 of 4008 samples are missing in 2 gaps, the first before counter 107, the longest of 7"
    assert finding_text(found[0]) == said
    assert checked(record(), counter, tick_s=counter * INTERVAL_s) == found


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("turns", [0.0, 0.4, 7.5, 2700.0])
def test_no_false_alarm_while_a_field_turns(noise: float, turns: float) -> None:
    """A sine stands still at its turning points, and a quiet sensor at one value; neither is a fault."""
    rng = np.random.default_rng([123, int(10 * noise)])
    angle = np.linspace(0.0, 2.0 * np.pi * turns, 36_000)
    sine = np.round(3583.0 * np.cos(angle) + 0.3 + rng.normal(0.0, noise, angle.size)).astype(np.int64)
    if noise == 0.0 and turns == 0.0:
        sine[5] += 1  # a channel that never moves at all is told
    assert faults.check_samples({"mag": sine}, np.arange(angle.size), {"mag": 50_000}).findings == ()


def test_false_alarms_of_many_records() -> None:
    """2,000 records of noise near a step of the output: with one alarm in a hundred asked for, 1 in 100 at most."""
    rng = np.random.default_rng(124)
    alarms = 0
    for _ in range(2000):
        values = np.round(rng.normal(0.0, 1.2, 500))
        longest = faults.longest_equal_run([faults.value_likelihood(values)], values.size, false_alarm=0.01)
        edges = np.flatnonzero(np.concatenate(([1], np.diff(values), [1])))
        alarms += np.diff(edges).max() - 1 > longest
    assert alarms <= 35  # binomial, 1 % of 2,000 and four standard deviations


def test_likelihood_of_one_value() -> None:
    rng = np.random.default_rng(125)
    for noise in (1.0, 4.0, 14.0):
        expected = stats.norm.cdf(0.5 / noise) - stats.norm.cdf(-0.5 / noise)
        values = np.round(rng.normal(0.0, noise, 36_000))
        assert 0.98 * expected < faults.value_likelihood(values) < 1.15 * expected
        values[10_000:20_000] = values[10_000]
        assert faults.value_likelihood(values) > 0.9 * expected
    assert faults.value_likelihood(np.zeros(100)) == 1.0
    assert faults.longest_equal_run([0.5], 1000, 1e-3) == 19  # 1000 x 0.5^20 = 9.5e-4
    assert faults.longest_equal_run([0.01], 1000, 1e-3) == 2  # 1000 x 1e-6 / sqrt(4) = 5e-4, with two pairs 0.058
    assert faults.longest_equal_run([0.01, 0.01], 1000, 1e-3) == 1
    assert faults.longest_equal_run([1.0], 100) == 100
    assert faults.longest_equal_run([0.0], 100) == 0


@pytest.mark.parametrize("rate_steps", [43_200, 43_203.3])
def test_a_turn_without_noise_is_no_fault(rate_steps: float) -> None:
    """Rest, ramp, steady rate, ramp, rest: long stretches of one value where a simulated sensor has no noise."""
    profile = np.interp(np.arange(COUNT), [0, 800, 1000, 1600, 1800, COUNT], [0, 0, rate_steps, rate_steps, 0, 0])
    turning = np.stack((np.round(profile), np.round(0.002 * profile), np.round(-0.003 * profile)), axis=1)
    assert checked({"gyro": turning.astype(np.int64)}, tick_s=ticks_s()) == []


@pytest.mark.parametrize(
    ("where", "change_s", "expected"),
    [
        (slice(50, 51), 0.002, {stamp_checks.IRREGULAR}),
        (slice(50, 51), -0.006, {stamp_checks.IRREGULAR, stamp_checks.BACKWARDS}),
        (slice(50, None), 0.05, {stamp_checks.IRREGULAR}),
    ],
)
def test_time_stamps_beside_their_place(where: slice, change_s: float, expected: set[str]) -> None:
    stamps = ticks_s()
    stamps[where] += change_s
    found = checked(record(), tick_s=stamps)
    assert kinds(found) == expected
    assert next(one for one in found if one.kind == stamp_checks.IRREGULAR).first in (50, 51)


def test_stamps_in_bursts() -> None:
    """A log that was written ten samples at a time."""
    stamps = np.repeat(np.arange(COUNT // 10) * 0.05, 10) + np.tile(np.arange(10) * 1e-4, COUNT // 10)
    assert {stamp_checks.IRREGULAR, stamp_checks.RATE} <= kinds(checked(record(), tick_s=stamps))
    uneven = np.arange(COUNT) * INTERVAL_s
    uneven[100:110] = uneven[110] - np.arange(10, 0, -1) * 1e-4
    assert {stamp_checks.IRREGULAR, stamp_checks.BURST} == kinds(checked(record(), tick_s=uneven))


def test_a_clock_that_runs_off() -> None:
    rng = np.random.default_rng(126)
    device = np.arange(COUNT) * INTERVAL_s
    chunks = np.ceil(device * 50.0) / 50.0  # the bench sees chunks
    delay = rng.exponential(1e-3, COUNT)
    good = stamp_checks.check_ticks(device, np.arange(COUNT), INTERVAL_s, chunks / (1.0 + 20e-6) + delay)
    assert good.faults == ()
    assert abs(good.clock_error - 20e-6) < 1e-3
    bad = stamp_checks.check_ticks(device, np.arange(COUNT), INTERVAL_s, chunks / 1.005 + delay)
    assert [fault.kind for fault in bad.faults] == [stamp_checks.CLOCK]
    assert bad.clock_error == pytest.approx(0.005, abs=5e-4)
    assert np.isnan(stamp_checks.check_ticks(device[:100], np.arange(100), INTERVAL_s, chunks[:100]).clock_error)


def test_ticks_begin_again_at_two_to_the_32() -> None:
    true_us = 2**32 - 12_000 + np.arange(10) * 5000
    np.testing.assert_allclose(stamp_checks.unwrapped_ticks_s(true_us % 2**32), np.arange(10) * 0.005, atol=1e-12)
    backwards = stamp_checks.unwrapped_ticks_s(np.array([1000, 6000, 4000]))
    np.testing.assert_allclose(backwards, [0.0, 0.005, 0.003])


def test_noise_of_which_the_middle_step_does_not_occur() -> None:
    """Noise far wider than a step: half of the second differences are 1,000 steps, half are 1,004, none is between."""
    rng = np.random.default_rng(9)
    second = np.where(np.arange(1000) % 2, 1000, 1004) * rng.choice((-1, 1), 1000)
    values = np.cumsum(np.cumsum(np.concatenate(([0, 1], second))))
    assert np.median(np.abs(np.diff(values, 2))) == 1002.0
    assert 0.0 < faults.value_likelihood(values) < 0.002
    noisy = np.random.default_rng(10).integers(-3000, 3000, 400)
    assert faults.check_samples({"mag": noisy}, np.arange(400), {}).findings == ()


def rows() -> list[SampledRow]:
    rig = Rig(4)
    rig.rest(10.0, POSES["+z"], item="bias")
    (row,) = rig.rows
    assert row.samples is not None
    return [SampledRow(1, row.window.conditions, row.samples, 0)]


@pytest.mark.parametrize(("due_Hz", "found"), [(RATE_Hz, False), (2 * RATE_Hz, True), (RATE_Hz / 2, True)])
def test_a_unit_that_samples_at_another_rate_is_named(due_Hz: float, found: bool) -> None:
    notes = check_notes(checked_rows(rows(), ("gyro", "accelerometer"), {"imu": IMU, "rate_Hz": due_Hz}))
    assert [note for note in notes if "own sensor" not in note] == notes[1:]
    assert any("every 5 ms" in note for note in notes[1:]) is found, notes


def stamps(begin_s: float, length_s: float, error: float, rng: np.random.Generator, switched_on_s: float = 0.0):
    """Ticks of a clock that is ``error`` fast, and receive times: chunks of about 1 s, a delay of up to 20 ms."""
    true_s = begin_s + INTERVAL_s * np.arange(round(length_s / INTERVAL_s))
    tick_us = np.rint((true_s - switched_on_s) * (1.0 + error) * 1e6).astype(np.int64) % (1 << 32)
    chunk = np.ceil(true_s - begin_s + 1e-9)
    late_s = rng.uniform(0.0005, 0.02, int(chunk.max()) + 1)
    return tick_us, begin_s + chunk + late_s[chunk.astype(int)]


def session_of(error: float, rng: np.random.Generator, first_s: float = 400.0) -> list[tuple[np.ndarray, np.ndarray]]:
    return [stamps(first_s + 90.0 * k, 60.0, error, rng) for k in range(20)]


def test_the_error_lies_within_its_interval() -> None:
    rng = np.random.default_rng(CLOCK_SEED)
    errors = rng.normal(0.0, 20e-6, 60)
    found = [clocks.unit_clock(session_of(error, rng), INTERVAL_s) for error in errors]
    z = np.array([(one.error - error) / one.std for one, error in zip(found, errors, strict=True)])
    assert max(one.std for one in found) < 10e-6
    assert np.abs(z).max() < 2.5
    assert np.mean([one.error - error for one, error in zip(found, errors, strict=True)]) == pytest.approx(0, abs=2e-6)


def test_stamps_that_wrap_are_one_stretch_and_a_unit_that_was_switched_off_begins_anew() -> None:
    rng = np.random.default_rng(CLOCK_SEED)
    session = session_of(30e-6, rng, first_s=3_700.0)  # 2^32 us are 4,295 s
    assert len(clocks.power_ons(session)) == 1
    wrapped = clocks.unit_clock(session, INTERVAL_s)
    assert wrapped.error == pytest.approx(30e-6, abs=3 * wrapped.std)
    before = [stamps(100.0 + 90.0 * k, 60.0, 25e-6, rng) for k in range(4)]
    after = [stamps(2_000.0 + 90.0 * k, 60.0, 25e-6, rng, switched_on_s=1_900.0) for k in range(12)]
    found = clocks.unit_clock([*before, *after], INTERVAL_s)
    assert found == min((clocks.unit_clock(part, INTERVAL_s) for part in (before, after)), key=lambda one: one.std)
    assert found.error == pytest.approx(25e-6, abs=3 * found.std)
    unknown = clocks.UnitClock(0.0, clocks.UNKNOWN_STD)  # too short to know is no correction
    assert clocks.unit_clock([stamps(10.0, 20.0, 40e-6, rng)], INTERVAL_s) == unknown


def test_an_output_that_does_not_use_every_step_is_not_held_at_its_extreme() -> None:
    values = 2 * np.round(np.random.default_rng(127).normal(0.0, 4.0, COUNT)).astype(np.int64)
    values = np.clip(values, -14, 14)  # as many at the end as some of the steps before it, and none at odd steps
    assert faults.pinned(values) == 0
    assert faults.check_samples({"gyro": values}, np.arange(COUNT), {}).findings == ()
    assert faults.pinned(np.clip(values, -14, -2)) == int((values >= -2).sum())
