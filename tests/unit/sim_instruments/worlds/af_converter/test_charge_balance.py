"""The closed form of the charge-balance converter against a loop over every edge of its clock."""

import numpy as np
import pytest

from bench.frame import why_no_kernel
from sim_instruments.worlds.af_converter.charge_balance import ChargeBalance

SEED = 20260
UNIT = 1 << 20  # charge units per design pulse charge in these tests


def loop(charge, clocks, q_n, q_p, threshold, residue=0):
    """One converter, one clock at a time, in Python integers: counts of each stretch and the last residue."""
    counts = []
    for step, edges in zip(charge, clocks, strict=True):
        n = p = 0
        for _ in range(edges):
            residue += step
            if residue > threshold:
                residue -= q_n
                n += 1
            elif residue < -threshold:
                residue += q_p
                p += 1
        counts.append((n, p))
    return np.array(counts).reshape(-1, 2), residue


def _direct(rng, n):
    return np.full(n, rng.integers(-UNIT, UNIT) * 9 // 10)


def _noise_near_zero(rng, n):
    return np.rint(rng.normal(rng.normal(0, 100), UNIT // 8, n))


def _slow_noise(rng, n):
    return np.rint(np.cumsum(rng.normal(0, UNIT // 200, n)))


def _switching(rng, n):
    return np.repeat(rng.integers(-UNIT, UNIT, n // 10 + 1) * 9 // 10, 10)[:n]


def _sine(rng, n):
    return np.rint(0.9 * UNIT * np.sin(np.arange(n) * rng.uniform(0.01, 1.0)))


SHAPES = (_direct, _noise_near_zero, _slow_noise, _switching, _sine)


@pytest.mark.validates(
    "three-state charge balance of the simulated converter, closed form",
    against="a loop over every clock edge",
)
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__.strip("_"))
@pytest.mark.parametrize("case", range(12))
def test_counts_equal_the_clock_by_clock_loop(shape, case):
    rng = np.random.default_rng([SEED, case])
    rows, n = 4, 120
    q_n, q_p = rng.integers(UNIT * 999 // 1000, UNIT * 1001 // 1000, (2, rows))
    threshold = np.full(rows, UNIT)
    charge = np.array([shape(rng, n) for _ in range(rows)], np.int64)
    limit = np.minimum(q_n, q_p)[:, None]
    charge = np.clip(charge, -limit, limit)
    clocks = rng.integers(0, 40, n)
    bank = ChargeBalance(threshold)
    bank.set_quanta(q_n, q_p)
    bank.residue = rng.integers(-UNIT, UNIT, rows)
    start = bank.residue.copy()
    n_pulses, p_pulses = bank.advance(charge.copy(), clocks)
    for row in range(rows):
        expected, residue = loop(
            charge[row].tolist(), clocks.tolist(), int(q_n[row]), int(q_p[row]), UNIT, int(start[row])
        )
        np.testing.assert_array_equal(n_pulses[row], expected[:, 0])
        np.testing.assert_array_equal(p_pulses[row], expected[:, 1])
        assert bank.residue[row] == residue
    assert n_pulses.sum() + p_pulses.sum() > 0


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__.strip("_"))
def test_counts_do_not_depend_on_how_time_is_cut(shape):
    rng = np.random.default_rng(SEED)
    charge = np.clip(np.array([shape(rng, 300) for _ in range(3)], np.int64), -UNIT, UNIT)
    clocks = rng.integers(0, 3000, 300)
    whole, cut = ChargeBalance(np.full(3, UNIT)), ChargeBalance(np.full(3, UNIT))
    expected = whole.advance(charge.copy(), clocks)
    places = np.sort(rng.integers(1, 299, 20))
    parts = [
        cut.advance(np.ascontiguousarray(charge[:, a:b]), clocks[a:b])
        for a, b in zip([0, *places], [*places, 300], strict=True)
        if b > a
    ]
    for polarity in (0, 1):
        np.testing.assert_array_equal(np.concatenate([part[polarity] for part in parts], axis=1), expected[polarity])
    np.testing.assert_array_equal(whole.residue, cut.residue)


@pytest.mark.parametrize("case", range(20))
def test_one_stretch_at_a_time_equals_the_loop(case):
    rng = np.random.default_rng([SEED, case])
    q_n, q_p = rng.integers(UNIT * 999 // 1000, UNIT * 1001 // 1000, (2, 5))
    bank = ChargeBalance(np.full(5, UNIT))
    bank.set_quanta(q_n, q_p)
    residue = [0] * 5
    for _ in range(10):
        charge, clocks = rng.integers(-UNIT, UNIT, 5) * 9 // 10, int(rng.integers(0, 60))
        n_pulses, p_pulses = bank.advance_once(charge, clocks)
        for row in range(5):
            step, quanta = int(charge[row]), (int(q_n[row]), int(q_p[row]))
            expected, residue[row] = loop([step], [clocks], *quanta, UNIT, residue[row])
            assert (n_pulses[row], p_pulses[row]) == tuple(expected[0])
    assert bank.residue.tolist() == residue


@pytest.mark.parametrize("case", range(6))
def test_one_way_equals_any_way(case):
    """Also where the charge that is left belongs to the other polarity, and where an unsigned type holds the counts."""
    rng = np.random.default_rng([SEED, case])
    steady = rng.choice((-1, 1), 8) * rng.integers(2000, UNIT // 10 ** rng.integers(1, 3), 8)
    noise, clocks = rng.integers(-1000, 1001, (8, 300)).astype(np.int32), rng.integers(1, 60, 300)
    banks = ChargeBalance(np.full(8, UNIT)), ChargeBalance(np.full(8, UNIT), np.uint16)
    for bank in banks:
        bank.set_quanta(*np.random.default_rng(case).integers(UNIT * 999 // 1000, UNIT * 1001 // 1000, (2, 8)))
        bank.residue = np.where(np.arange(8) % 2, UNIT, -UNIT)
    expected = banks[0]._any_way((noise + steady[:, None]) * clocks)
    np.testing.assert_array_equal(banks[1].advance_one_way(steady, noise, clocks), expected)
    np.testing.assert_array_equal(banks[1].residue, banks[0].residue)


def test_only_one_polarity_at_a_constant_current():
    bank = ChargeBalance(np.full(2, UNIT))
    n_pulses, p_pulses = bank.advance(np.array([[1000], [-1000]], np.int64), np.array([1_000_000]))
    assert n_pulses[0, 0] == (1000 * 1_000_000 - UNIT + UNIT - 1) // UNIT
    assert p_pulses[0, 0] == n_pulses[1, 0] == 0
    assert p_pulses[1, 0] == n_pulses[0, 0]


def test_reversal_waits_until_twice_the_threshold_is_crossed():
    bank = ChargeBalance(np.array([UNIT]))
    bank.residue = np.array([UNIT])
    step = UNIT // 1000
    _, p_pulses = bank.advance(np.full((1, 4000), -step, np.int64), np.ones(4000, np.int64))
    dead_clocks = int(np.flatnonzero(p_pulses[0])[0]) + 1
    assert dead_clocks == 2 * UNIT // step + 1


def test_a_call_that_could_leave_64_bits_is_refused():
    bank = ChargeBalance(np.array([1 << 40]))
    for call in (
        lambda: bank.advance(np.array([[1]]), np.array([1 << 23])),
        lambda: bank.advance_one_way(np.array([1]), np.zeros((1, 1), np.int32), np.array([1 << 23])),
        lambda: bank.advance_once(np.array([1]), 1 << 23),
    ):
        with pytest.raises(ValueError, match="clocks in one call"):
            call()


@pytest.mark.skipif(bool(why_no_kernel()), reason=why_no_kernel() or "the kernel is there")
@pytest.mark.parametrize("case", range(40))
def test_kernel_counts_as_numpy_does(case):
    """Counts of 16 bits are made by the kernel, longer ones by numpy; the noise is a part of a block, as in a run."""
    rng = np.random.default_rng([SEED, case])
    rows, n, design = 10, int(rng.integers(1, 1000)), 1 << 40
    residue = rng.integers(-design, design + 1, rows)
    q_n, q_p = design + rng.integers(-(10**8), 10**8, (2, rows))
    steady = (rng.uniform(-0.97, 0.97, rows) * design * 10.0 ** rng.integers(-6, 1, rows)).astype(np.int64)
    peak = np.minimum(np.abs(steady), 1 << 22)[:, None]
    noise = (rng.uniform(-1.0, 1.0, (rows, 1000)) * peak).astype(np.int32)[:, 1000 - n :]
    clocks = rng.integers(1, 2570, n)
    counts, residues = [], []
    for pulse_type in (np.uint16, np.int64):
        bank = ChargeBalance(np.full(rows, design), pulse_type)
        bank.residue = residue
        bank.set_quanta(q_n, q_p)
        counts.append(bank.advance_one_way(steady, noise, clocks))
        residues.append(bank.residue)
    np.testing.assert_array_equal(counts[0], counts[1])
    np.testing.assert_array_equal(residues[0], residues[1])
