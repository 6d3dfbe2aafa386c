"""The charge-balance converter in closed form, and counts of gates, against loops over every edge of the clock."""

import numpy as np
import pytest
from sim_bench import plain_thermal

from bench.model.clock import NS
from sim_instruments.worlds.af_converter.block import BlockFactory
from sim_instruments.worlds.af_converter.charge_balance import ChargeBalance
from sim_instruments.worlds.af_converter.constants import KINDS
from sim_instruments.worlds.af_converter.gates import Drive, GateMachine
from sim_instruments.worlds.af_converter.unit_constants import NguTruth

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


def test_a_call_that_could_leave_64_bits_is_refused():
    bank = ChargeBalance(np.array([1 << 40]))
    with pytest.raises(ValueError, match="clocks in one call"):
        bank.advance(np.array([[1]]), np.array([1 << 23]))


SECONDS = 0.4


_thermal = plain_thermal(lambda t_ns: np.full(len(t_ns), 31.0))


def _changes(rng):
    """Seven changes of all inputs at arbitrary nanoseconds, some closer together than one clock period."""
    times = np.sort(rng.integers(0, round(SECONDS * NS), 5))
    times = np.sort(np.concatenate((times, times[:1] + 700, times[1:2] + 1900)))
    scale = np.array([kind.full_scale_A for kind in KINDS])
    return [(int(t), rng.uniform(-1, 1, 10) * scale * rng.choice([1.0, 1e-3, 1e-5], 10)) for t in times]


def _run(truth, changes):
    machine = GateMachine(BlockFactory(truth, _thermal, 0, 0), Drive())
    rows = []
    for t_ns, input_A in changes:
        rows += machine.run(t_ns)
        machine.change(Drive(input_A=input_A), t_ns)
    rows += machine.run(round(SECONDS * NS))
    return machine.state.block, rows


def _loop(truth, block, changes, channel):
    """Counts per gate of one channel: charge integrated in floating point between edges, one edge after the other."""
    index = channel - 1
    k0_C = KINDS[index].k0_C
    clock_Hz = 256_000.0 * (1 + 1e-6 * truth.af_clock_error_ppm)
    q_n, q_p = (k0_C * (1 + 1e-6 * truth.dsf_ppm(channel, 31.0)) / (1 + 1e-6 * truth.af_clock_error_ppm)).tolist()
    bias_A = float(truth.bias_A(channel, 31.0, 0.0))
    ampere_per_unit = k0_C * clock_Hz / 2**40
    steps = [(t / NS * clock_Hz, float(input_A[index])) for t, input_A in changes]
    charge, current_A, at = 0.0, 0.0, 0.0
    counts = []
    for gate in range(len(block.edges) - 1):
        if block.ends_ns[gate] > SECONDS * NS:
            break
        noise_A = float(block.noise[index, gate]) * ampere_per_unit
        n = p = 0
        for edge in range(int(block.edges[gate]) + 1, int(block.edges[gate + 1]) + 1):
            while steps and steps[0][0] < edge:
                place, new_A = steps.pop(0)
                charge += (current_A - bias_A + noise_A) * (place - at) / clock_Hz
                at, current_A = place, new_A
            charge += (current_A - bias_A + noise_A) * (edge - at) / clock_Hz
            at = float(edge)
            if charge > k0_C:
                charge, n = charge - q_n, n + 1
            elif charge < -k0_C:
                charge, p = charge + q_p, p + 1
        counts.append((n, p))
    return np.array(counts)


@pytest.mark.parametrize("seed", range(4))
def test_gates_equal_a_loop_over_every_clock_edge(seed):
    truth = NguTruth(seed)
    changes = _changes(np.random.default_rng([77, seed]))
    block, rows = _run(truth, changes)
    npp = np.concatenate([part.npp for part in rows], axis=1)
    ppp = np.concatenate([part.ppp for part in rows], axis=1)
    assert npp.shape[1] == np.flatnonzero(block.ends_ns <= SECONDS * NS)[-1] + 1
    for channel in (1, 2, 7, 10):
        expected = _loop(truth, block, list(changes), channel)
        np.testing.assert_array_equal(npp[channel - 1], expected[:, 0])
        np.testing.assert_array_equal(ppp[channel - 1], expected[:, 1])
    assert npp.any()
    assert ppp.any()


def test_white_noise_is_14_nA_in_a_gate():
    (block,) = BlockFactory(NguTruth(3), _thermal, 0, 0).make(0, 0.0, 0)
    noise_A = block.noise / block.quanta.units_A[:, None]
    assert noise_A.std(axis=1) == pytest.approx(np.full(10, 2e-9 / np.sqrt(2 * 0.01)), rel=0.1)
    others = [
        BlockFactory(NguTruth(3), _thermal, 0, period).make(number, 0.0, 0)[0] for period, number in ((0, 1), (1, 0))
    ]
    together = np.concatenate([block.noise, *(other.noise for other in others)])
    assert np.abs(np.corrcoef(together)[np.triu_indices(30, 1)]).max() < 0.15


def test_gates_follow_the_master_clock_and_edges_the_af_clock():
    truth = NguTruth(1, {"master_error_ppm": "40", "af_clock_error_ppm": "-30", "noise": "off"})
    factory = BlockFactory(truth, plain_thermal(lambda t: np.full(len(t), 20.0)), 5 * NS, 0)
    first, second = factory.make(0, 0.0, 15 * NS)
    assert second.ends_ns[-1] - 5 * NS == pytest.approx(20 * NS / (1 + 40e-6), abs=1)
    assert second.edges[-1] == int(20 / (1 + 40e-6) * 256_000 * (1 - 30e-6))
    assert second.edges[0] == first.edges[-1]
    assert set(np.diff(second.edges)) <= {2559, 2560}


def test_an_input_beyond_the_reset_current_saturates_at_a_pulse_per_clock():
    truth = NguTruth(1, {"noise": "off"})
    machine = GateMachine(BlockFactory(truth, _thermal, 0, 0), Drive(input_A=np.full(10, 1.0)))
    (rows,) = machine.run(NS)
    assert rows.over_range == 0x3FF
    assert (np.abs(rows.npp[:, 1:] - rows.af_clock[1:]) <= 3).all()
