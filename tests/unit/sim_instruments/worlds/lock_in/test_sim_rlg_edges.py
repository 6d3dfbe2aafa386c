"""Edges of the simulated comparators: what a counter makes of polarity and cosine, turnarounds, comparator noise."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laser_edges import Edges, simulated_edges

from sim_instruments.worlds.lock_in.core import BEAT, PICK_OFF, RingLaser


def simulated(laser, seconds, seed=1, psi_rad=0.0):
    return simulated_edges(laser, seconds, np.random.default_rng(seed), psi_rad)


def counted(edges: Edges, start_rad: float) -> np.ndarray:
    """floor(psi / pi) behind each beat edge by a counter that sees the two comparators only.

    sin(psi) rises through a multiple of pi where cos(psi) > 0 if psi rises, where cos(psi) < 0 if it falls.
    """
    own = edges.channel == BEAT
    forward = edges.level[own] == edges.cosine[own]
    return math.floor(start_rad / math.pi) + np.cumsum(np.where(forward, 1, -1))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    path_m=st.sampled_from([0.15, 0.28, 0.34]),
    beta_rad=st.floats(-3.14, 3.14),
    psi_rad=st.floats(-100.0, 100.0),
    rate_deg_h=st.floats(-3e5, 3e5),
    quantum=st.sampled_from([0.0, 1.15e-4]),
    seed=st.integers(0, 1000),
)
def test_a_counter_of_both_comparators_finds_every_level(path_m, beta_rad, psi_rad, rate_deg_h, quantum, seed):
    laser = RingLaser(path_m, beta_rad, rate_deg_h=rate_deg_h, quantum_deg_rt_h=quantum)
    edges = simulated(laser, 0.0125, seed, psi_rad)
    own = edges.channel == BEAT
    assert np.array_equal(counted(edges, psi_rad), edges.count[own])
    assert (np.diff(edges.t_s) >= 0.0).all()
    assert (np.diff(edges.t_s[own]) > 0.0).all()
    pick_off = np.flatnonzero(edges.channel == PICK_OFF)
    assert np.array_equal(edges.count[pick_off], np.floor(edges.phase_rad[:-1] / np.pi))
    before = pick_off[1:] - 1
    assert np.array_equal(edges.count[before], edges.count[pick_off[1:]])  # the count runs through the pick-off
    alternate = np.diff(edges.level[own].astype(int))
    assert (np.abs(alternate) == 1).all()  # a comparator that has risen falls next


def turnaround(psi_rad: float) -> Edges:
    return simulated(RingLaser(0.28, 0.7, dither_noise=0.0), 0.00125, psi_rad=psi_rad)


def innermost_s(edges: Edges) -> float:
    """Time between the last edge forward and the first one back."""
    own = edges.channel == BEAT
    forward = edges.level[own] == edges.cosine[own]
    return float(edges.t_s[own][~forward][0] - edges.t_s[own][forward][-1])


def test_a_level_that_is_just_reached_makes_a_pair_of_edges_however_near():
    """psi = n pi + d - a t2 / 2 about its maximum: edges 2 sqrt(2 d / a) apart, and none where d < 0."""
    low, high = 0.0, math.pi / 2  # start phases without and with the pair
    edges_low = len(turnaround(low).t_s)
    if len(turnaround(high).t_s) == edges_low:
        low, high = math.pi / 2, math.pi
        edges_low = len(turnaround(low).t_s)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if len(turnaround(middle).t_s) <= edges_low else (low, middle)
    laser = RingLaser(0.28)
    bend = laser.scale * math.radians(100.0) * math.pi / laser.half_s
    for above_rad in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        edges = turnaround(high + above_rad)
        assert len(edges.t_s) == edges_low + 2
        assert innermost_s(edges) == pytest.approx(2.0 * math.sqrt(2.0 * above_rad / bend), rel=0.05)
        assert len(turnaround(low - above_rad).t_s) == edges_low
    assert low == pytest.approx(high, abs=1e-12)


def test_noise_of_the_comparator_moves_edges_by_its_phase():
    laser = RingLaser(0.28, 0.7)
    noisy = RingLaser(0.28, 0.7, beat_noise=0.01)
    plain, edges = (simulated(one, 0.05, 4) for one in (laser, noisy))  # the dither is drawn before the noise
    assert np.array_equal(plain.phase_rad, edges.phase_rad)
    assert len(plain.t_s) == len(edges.t_s)  # of this seed: no pair grazes its level
    rate = laser.scale * math.radians(100.0) * np.abs(np.cos(np.pi * plain.t_s / laser.half_s))
    fast = (rate > 5e5) & (plain.channel == BEAT)
    assert np.std((edges.t_s - plain.t_s)[fast] * rate[fast]) == pytest.approx(0.01, rel=0.06)
    own = edges.channel == BEAT
    assert np.array_equal(counted(edges, 0.0), edges.count[own])
    assert (np.diff(edges.t_s) >= 0.0).all()


def test_a_grazing_pair_is_lost_in_noise_together():
    found = set()
    for seed in range(40):
        laser = RingLaser(0.28, 0.7, beat_noise=0.05)
        edges = simulated(laser, 0.0125, seed)
        own = edges.channel == BEAT
        assert np.array_equal(counted(edges, 0.0), edges.count[own])
        plain = simulated(RingLaser(0.28, 0.7), 0.0125, seed)
        found.add(len(plain.t_s) - len(edges.t_s))
    print(f"edges lost in 10 half cycles: {sorted(found)}")
    assert found <= {0, 2, 4}
    assert 2 in found
