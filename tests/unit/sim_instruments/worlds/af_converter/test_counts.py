"""Counts of the simulated unit, gate by gate and over a window."""

from __future__ import annotations

import numpy as np
import pytest
from ngu_counts import count_windows

from bench.model.clock import NS
from sim_instruments.worlds.af_converter.block import BlockFactory
from sim_instruments.worlds.af_converter.constants import KINDS
from sim_instruments.worlds.af_converter.gates import Drive, GateMachine
from sim_instruments.worlds.af_converter.unit_constants import NguTruth

K0_C = np.array([kind.k0_C for kind in KINDS])
SECONDS = 0.4


def _frames_of_100_s(truth, input_A):
    """Sums of gates 2,000 to 12,000 at 31 degC, with the same current all the time."""
    machine = GateMachine(BlockFactory(truth, lambda t: np.full(len(t), 31.0), 0, 0), Drive(input_A=input_A))
    rows = machine.run(121 * NS)
    npp, ppp, af = (
        np.concatenate([getattr(part, name) for part in rows], axis=-1) for name in ("npp", "ppp", "af_clock")
    )
    return tuple(counts[..., 2000:12_000].sum(axis=-1, dtype=np.int64) for counts in (npp, ppp, af))


@pytest.mark.parametrize("seed", range(5))
def test_a_record_has_the_counts_of_its_frames(seed):
    """Within one pulse for the charge left over and one for a clock edge that falls on the other side of a gate."""
    truth = NguTruth(seed, {"noise": "off"})
    input_A = np.random.default_rng(seed).uniform(-1, 1, 10) * [kind.full_scale_A for kind in KINDS]
    npp, ppp, af_clock = _frames_of_100_s(truth, input_A)
    counts = count_windows(truth, input_A[None, :], np.array([20.0]), 31.0)
    assert np.abs(counts.npp[0] - npp).max() <= 2
    assert np.abs(counts.ppp[0] - ppp).max() <= 2
    assert abs(int(counts.af_clock[0]) - int(af_clock)) <= 1


def test_equation_1_holds_within_quantisation():
    truth = NguTruth(11, {"noise": "off", "af_clock_error_ppm": "-50", "master_error_ppm": "50"})
    rng = np.random.default_rng(5)
    m = 40
    input_A = rng.uniform(-1, 1, (m, 10)) * rng.choice([1e-3, 1e-5], (m, 10)) + np.copysign(
        2e-6, rng.uniform(-1, 1, (m, 10))
    )
    unit_degC = rng.uniform(-10, 50, m)
    counts = count_windows(truth, input_A, 20 + 120.0 * np.arange(m), unit_degC)
    rate = (256_000.0 / counts.af_clock)[:, None]
    numbers = np.arange(1, 11)
    k_n, k_p = (K0_C * (1 + 1e-6 * dsf(numbers, unit_degC[:, None])) for dsf in (truth.dsf_n_ppm, truth.dsf_p_ppm))
    reading_A = rate * (k_n * counts.npp - k_p * counts.ppp)
    expected_A = input_A - truth.bias_A(numbers, unit_degC[:, None], 0.0)
    assert (np.abs(reading_A - expected_A) < 1.01 * K0_C / 100 + 4e-8 * np.abs(input_A)).all()
    assert (counts.npp > 0).any()
    assert (counts.ppp > 0).any()


def test_clock_counts_tell_the_clock_errors():
    truth = NguTruth(2)
    counts = count_windows(truth, np.zeros((50, 10)), 120.0 * np.arange(50), 20.0, fg_Hz=1e7)
    master = truth.master_error_ppm(20.0) * 1e-6
    assert counts.fg_count.sum() / (50 * 1e9) == pytest.approx(1 / (1 + master), abs=1e-9)  # one pulse
    assert counts.af_clock.sum() / (50 * 25.6e6) == pytest.approx(
        (1 + truth.af_clock_error_ppm * 1e-6) / (1 + master), abs=2e-9
    )
    assert counts.sums(3)["master_count"] == 10**9
    assert counts.sums(3)["npp"].shape == (10,)


def test_white_noise_of_a_record_is_140_pA():
    truths = [NguTruth(3, {"noise": noise}) for noise in ("on", "off")]
    m = 2000
    input_A = np.zeros((m, 10))
    input_A[:, 6:] = 1e-3 + np.random.default_rng(1).uniform(0, 1e-6, (m, 4))
    with_noise, without = (count_windows(truth, input_A, np.full(m, 20.0), 20.0) for truth in truths)
    difference_A = 1e-9 * (with_noise.npp - without.npp)[:, 6:]
    quantisation_A2 = 2 * 1e-9**2 / 6  # two gated counts of independent phase, each (q/t)^2 / 6
    assert np.sqrt(difference_A.var() - quantisation_A2) == pytest.approx(2e-9 / np.sqrt(200), rel=0.15)


def test_the_same_seed_gives_the_same_counts_and_another_does_not():
    input_A = np.full((30, 10), 1e-3)
    runs = [count_windows(NguTruth(seed), input_A, 120.0 * np.arange(30), 20.0).npp for seed in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2]).any()


def _thermal(t_ns):
    return np.full(len(t_ns), 31.0)


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
    q_n = k0_C * (1 + 1e-6 * float(truth.dsf_n_ppm(channel, 31.0))) / (1 + 1e-6 * truth.af_clock_error_ppm)
    q_p = k0_C * (1 + 1e-6 * float(truth.dsf_p_ppm(channel, 31.0))) / (1 + 1e-6 * truth.af_clock_error_ppm)
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
    factory = BlockFactory(truth, lambda t: np.full(len(t), 20.0), 5 * NS, 0)
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
