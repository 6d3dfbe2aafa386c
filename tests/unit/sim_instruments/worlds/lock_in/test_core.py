"""Phase and edges of the simulated ring laser against an integrator and formulas that nobody here wrote."""

import math
from dataclasses import replace

import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rlg_rig import Edges, simulated_edges
from scipy.integrate import solve_ivp
from scipy.special import j0

from sim_instruments.worlds.lock_in.core import BEAT, PICK_OFF, RingLaser, quantum_deg_rt_h

PATHS_M = (0.15, 0.28, 0.34)


def simulated(laser, seconds, seed=1, psi_rad=0.0):
    return simulated_edges(laser, seconds, np.random.default_rng(seed), psi_rad)


def beat(edges):
    return edges.channel == BEAT


def solved(laser, edges, halves, psi_rad, dense=True):
    """Equation (10) by DOP853: phase at the crossings and at the end of each of the first half cycles."""
    scale, kappa, omega = laser.scale, laser.kappa_rad_s, math.pi / laser.half_s
    input_rad_s = scale * math.radians(laser.rate_deg_h) / 3600.0
    for half in range(halves):
        swing = scale * math.radians(edges.dither_deg_s[half]) * (-1) ** half / omega

        def slope(t, u, swing=swing):
            psi = swing * math.sin(omega * t) + u[0]
            second = laser.second_harmonic * math.sin(2.0 * psi + laser.second_phase_rad)
            return input_rad_s - kappa * (math.sin(psi + laser.beta_rad) + second)

        found = solve_ivp(
            slope, (0.0, laser.half_s), [psi_rad], "DOP853", rtol=1e-12, atol=1e-12, max_step=2e-6, dense_output=dense
        )
        own = beat(edges) & (edges.t_s >= half * laser.half_s) & (edges.t_s < (half + 1) * laser.half_s)
        since_s = edges.t_s[own] - half * laser.half_s
        psi_rad = float(found.y[0][-1])
        crossed = swing * np.sin(omega * since_s) + found.sol(since_s)[0] if dense else None
        yield since_s, crossed, swing * omega, psi_rad


@pytest.mark.validates(
    "crossings of the simulated ring laser", against="paper 004 equation (10) solved by scipy's DOP853, tolerance 1e-12"
)
@pytest.mark.parametrize(("path_m", "second"), [(0.15, 0.0), (0.28, 0.0), (0.34, 0.0), (0.28, 0.05)])
def test_crossings_and_phase_are_those_of_an_independent_integrator(path_m, second, record_property):
    laser = RingLaser(path_m, 0.7, rate_deg_h=3600.0, second_harmonic=second, second_phase_rad=0.3)
    edges = simulated(laser, 0.0025, psi_rad=0.4)
    worst_s = 0.0
    for half, (since_s, psi, rate, end_rad) in enumerate(solved(laser, edges, 2, 0.4)):
        off_level = psi - np.pi * np.round(psi / np.pi)
        off_s = off_level / (rate * np.cos(math.pi / laser.half_s * since_s))
        assert len(since_s) > 100
        worst_s = max(worst_s, np.abs(off_s).max())
        assert abs(end_rad - edges.phase_rad[half + 1]) < 5e-6
    record_property("obtained", f"{100 * path_m:.0f} cm, second harmonic {second:g}: {worst_s:.0e} s, limit 1e-10")
    assert worst_s < 1e-10


@pytest.mark.sweep
def test_the_phase_after_a_second_is_that_of_an_independent_integrator():
    laser = RingLaser(0.28, 0.7, rate_deg_h=9.0)
    edges = simulated(laser, 1.0, psi_rad=0.4)
    ends = [end_rad for *_, end_rad in solved(laser, edges, len(edges.dither_deg_s), 0.4, dense=False)]
    assert len(ends) == 800
    off_rad = np.abs(np.array(ends) - edges.phase_rad[1:]).max()
    print(f"largest difference of the phase in a second: {off_rad:.1e} rad")
    assert off_rad < 1e-6


@pytest.mark.validates(
    "simulated ring laser without dither: it locks, and beats above", against="Adler's equation (1946) in closed form"
)
def test_a_laser_without_dither_locks_and_above_that_beats_as_adler_says():
    still = RingLaser(beta_rad=0.7, dither_deg_s=0.0, rate_deg_h=0.5 * 0.05 * 3600.0)
    locked = simulated(still, 0.1, psi_rad=-0.01)
    assert not beat(locked).any()
    assert locked.phase_rad[-1] == pytest.approx(math.asin(0.5) - 0.7, abs=1e-7)
    for factor in (1.5, 3.0):
        edges = simulated(replace(still, rate_deg_h=factor * 0.05 * 3600.0), 0.2)
        same = edges.t_s[beat(edges)][::2]
        expected = still.kappa_rad_s * math.sqrt(factor**2 - 1.0)  # Adler 1946
        assert 2.0 * np.pi / np.diff(same) == pytest.approx(expected, rel=2e-7)


@pytest.mark.validates(
    "dynamic lock-in of the simulated ring laser without dither noise",
    against="Adler's equation with the Bessel function of the dither's swing, solved by scipy",
)
def test_without_dither_noise_a_dynamic_lock_in_remains(record_property):
    """The mean over a period of the dither leaves Adler's equation with kappa J0 of the dither's phase swing."""
    laser = RingLaser(rate_deg_h=9.05, dither_noise=0.0, beta_rad=math.pi / 2)
    edges = simulated(laser, 2.0)
    input_rad_s = laser.scale * math.radians(9.05) / 3600.0
    bessel = laser.kappa_rad_s * j0(laser.scale * math.radians(100.0) / (800.0 * math.pi))
    t_s = np.arange(0, len(edges.phase_rad), 2) * laser.half_s
    mean = solve_ivp(lambda _, y: input_rad_s - bessel * np.sin(y + laser.beta_rad), (0.0, t_s[-1]), [0.0],
                     rtol=1e-10, atol=1e-10, t_eval=t_s)  # fmt: skip
    off_rad = np.abs(mean.y[0] - edges.phase_rad[::2]).max()
    record_property("obtained", f"within {off_rad:.2f} rad over 2 s, limit 0.08")
    assert off_rad < 0.08  # terms of second order, and the ripple
    assert np.ptp(mean.y[0] - input_rad_s * t_s) > 1.0


def jumps(laser, edges):
    """What lock-in adds from one maximum of the velocity to the next, rad, and what theory gives for it."""
    measured = np.diff(edges.phase_rad) - laser.scale * math.radians(laser.rate_deg_h) / 3600.0 * laser.half_s
    omega = math.pi / laser.half_s
    swing = laser.scale * np.radians(edges.dither_deg_s) / omega
    up = 1.0 - 2.0 * (np.arange(len(swing)) % 2)  # +1: the turnaround is a maximum of psi, where it bends down
    middle = 0.5 * (edges.phase_rad[1:] + edges.phase_rad[:-1])
    largest = laser.kappa_rad_s * np.sqrt(2.0 * np.pi / (swing * omega**2))
    return measured, -largest * np.sin(middle + up * swing + laser.beta_rad - up * np.pi / 4.0), largest


@pytest.mark.validates(
    "jumps at the turnarounds and random walk of the simulated ring laser",
    against="paper 004 (5) and (6); Allan deviation of the package allantools",
)
@pytest.mark.parametrize("path_m", PATHS_M)
def test_jumps_and_random_walk_are_those_of_theory(path_m, record_property):
    laser = RingLaser(path_m, 0.7)
    edges = simulated(laser, 2.0, seed=5)
    measured, expected, largest = jumps(laser, edges)
    assert np.std(measured) == pytest.approx(np.sqrt(np.mean(largest**2) / 2.0), rel=0.03)
    assert np.std(measured - expected) < 0.08 * np.std(measured)  # ripple at the ends, second order
    assert np.abs(measured).max() < 1.06 * largest.max()
    walk = random_walk_deg_rt_h(laser, edges, (0.0025, 0.005, 0.01, 0.02))
    ratios = np.std(measured) / np.sqrt(np.mean(largest**2) / 2.0), walk / laser.lock_in_walk_deg_rt_h
    record_property("obtained", f"{100 * path_m:.0f} cm: jump {ratios[0]:.3f}, walk {ratios[1]:.3f} of theory")
    assert walk == pytest.approx(laser.lock_in_walk_deg_rt_h, rel=0.08)


def random_walk_deg_rt_h(laser, edges, taus_s):
    """Angle random walk of the phase at the rising pick-off edges, by another's Allan deviation."""
    angle_deg = np.degrees(edges.phase_rad[::2] / laser.scale)
    x = np.arange(len(angle_deg))
    angle_deg = angle_deg - np.polyval(np.polyfit(x, angle_deg, 1), x)
    tau_s, deviation, *_ = allantools.oadev(angle_deg, rate=400.0, data_type="phase", taus=np.array(taus_s))
    return 60.0 * math.sqrt(np.sum(deviation**2) / np.sum(1.0 / tau_s))  # weights 1 / tau


@pytest.mark.sweep
def test_the_random_walk_falls_with_the_path_to_the_power_of_two_and_a_half():
    walks = []
    for path_m in PATHS_M:
        laser = RingLaser(path_m, math.pi / 2, rate_deg_h=9.05)
        walks.append(random_walk_deg_rt_h(laser, simulated(laser, 20.0, seed=7), (0.05, 0.1, 0.2, 0.5, 1.0)))
        assert walks[-1] == pytest.approx(laser.lock_in_walk_deg_rt_h, rel=0.08)
    assert np.polyfit(np.log(PATHS_M), np.log(walks), 1)[0] == pytest.approx(-2.5, abs=0.15)


def test_the_published_figures_of_the_model():
    """Design figures of the paper's gyroscopes: 1.865 arcsec a fringe and 2.724e-3 deg/rt-h at 28 cm."""
    laser = RingLaser(0.28)
    assert laser.scale == pytest.approx(6.950e5, rel=1e-4)
    assert math.degrees(2.0 * math.pi / laser.scale) * 3600.0 == pytest.approx(1.865, rel=5e-4)
    assert laser.lock_in_walk_deg_rt_h == pytest.approx(2.724e-3, rel=1e-3)
    assert RingLaser(0.14).lock_in_walk_deg_rt_h / laser.lock_in_walk_deg_rt_h == pytest.approx(5.657, rel=1e-3)
    assert quantum_deg_rt_h(0.14) == pytest.approx(4.0 * 1.15e-4)


def test_quantum_noise_is_a_random_walk_of_its_size():
    laser = RingLaser(0.28, lock_in_deg_s=0.0, quantum_deg_rt_h=1.15e-4)
    edges = simulated(laser, 2.0, seed=3)
    step = np.diff(edges.phase_rad)
    expected = laser.scale * math.radians(1.15e-4) / 60.0 * math.sqrt(laser.half_s)
    assert step.std() == pytest.approx(expected, rel=0.05)
    assert abs(np.corrcoef(step[1:], step[:-1])[0, 1]) < 0.06
    assert np.abs(simulated(replace(laser, quantum_deg_rt_h=0.0), 0.1).phase_rad).max() < 1e-9


def test_pick_off_edges_stand_at_the_maxima_of_the_velocity():
    edges = simulated(RingLaser(0.28), 0.02)
    pick_off = edges.channel == PICK_OFF
    assert edges.t_s[pick_off] == pytest.approx(np.arange(16) * 1.25e-3, abs=1e-15)
    assert edges.level[pick_off].tolist() == [1, 0] * 8
    assert edges.cosine[pick_off].tolist() == (np.cos(edges.phase_rad[:-1]) > 0).tolist()


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


def test_noise_of_the_comparator_moves_edges_by_its_phase_and_loses_grazing_pairs():
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
    found = set()
    for seed in range(40):
        laser = RingLaser(0.28, 0.7, beat_noise=0.05)
        edges = simulated(laser, 0.0125, seed)
        own = edges.channel == BEAT
        assert np.array_equal(counted(edges, 0.0), edges.count[own])
        plain = simulated(RingLaser(0.28, 0.7), 0.0125, seed)
        found.add(len(plain.t_s) - len(edges.t_s))
    assert found <= {0, 2, 4}
    assert 2 in found
