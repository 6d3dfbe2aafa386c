"""What the global fit states of lock-in: true on an exact physics (``laser_physics``) without noise, and as predicted
with noise; what compensators of single turnarounds are expected to leave, against draws and what can be said by hand.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from doubt_lock_in import simulated
from laser_physics import World, added, higher, integrals
from scipy.integrate import solve_ivp

from bench.model.errors import FitError
from bench.systems.lock_in.compensation import SINGLE
from bench.systems.lock_in.estimators import global_constants as expecting
from bench.systems.lock_in.estimators.random_walk import expected_random_walk, gyro_gain, walk_of_phase_deg_rth
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds
from bench.systems.lock_in.records import laser_records
from bench.systems.lock_in.result import LaserResult, laser_result

GAIN, HALF_s = gyro_gain(0.28), 1.25e-3
LASER = expecting.NominalLaser(
    kappa_rad_s=GAIN * np.radians(0.05), beta_rad=np.radians(40.0), omega_rad_s=2.0 * np.pi * 400.0,
    rate_rad_s=GAIN * np.radians(100.0), walk_rad_rt_s=GAIN * np.radians(1.15e-4 / 60.0), tick_s=1e-8,
)  # fmt: skip


def result_of(seed: int, world: World, *, quiet: bool) -> LaserResult:
    (record,) = laser_records(simulated(seed, world, quiet=quiet).material)
    return laser_result(record)


def world_of(path_m: float, clock_Hz: int, beta_deg: float) -> World:
    """Four seconds of the laser of 28 cm with another path."""
    wider = (0.28 / path_m) ** 2
    return World(path_m=path_m, clock_Hz=clock_Hz, beta_deg=beta_deg, seconds=4.0,
                 lock_in_deg_s=0.05 * wider, quantum_deg_rth=1.15e-4 * wider)  # fmt: skip


def nominal(world: World) -> expecting.NominalLaser:
    """The laser of a world, by its own words."""
    return expecting.NominalLaser(
        kappa_rad_s=world.gain * math.radians(world.lock_in_deg_s),
        beta_rad=math.radians(world.beta_deg),
        omega_rad_s=world.omega,
        rate_rad_s=world.gain * math.radians(100.0),
        walk_rad_rt_s=world.gain * math.radians(world.quantum_deg_rth / 60.0),
        tick_s=1.0 / world.clock_Hz,
    )


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_phase_of_the_tests_is_that_of_the_equation(sense: float) -> None:
    """Equation (10) about a turnaround, integrated step by step."""
    swing, g, v = 258.0, 0.04, np.array([-7.1, -1.2, 0.7, 2.0, 7.1])
    c, s = integrals(v, np.full(v.size, swing))
    for phase in np.linspace(0.0, 6.0, 5):

        def slope(at: float, x: np.ndarray, phase: float = phase) -> np.ndarray:
            return -g * np.sin(phase - sense * at * at + x) / math.sqrt(1.0 - at * at / (2.0 * swing))

        due = [solve_ivp(slope, (0.0, end), [0.0], rtol=1e-10, atol=1e-11, method="DOP853").y[0, -1] for end in v]
        found = added(g, phase, sense, (c + 1j * s, *higher(v, swing)))
        assert found == pytest.approx(due, abs=5e-6)


@pytest.mark.parametrize("beta_deg", [0.0, 40.0, 90.0, 130.0])
def test_rate_and_phase_are_true_without_noise(beta_deg: float) -> None:
    """To less than a fifth of the uncertainty of 4 s at 100 MHz."""
    world = World(seconds=4.0, beta_deg=beta_deg)
    found = result_of(7, world, quiet=True)
    assert found.lock_in_deg_s is not None
    assert found.backscatter_deg is not None
    print(f"{found.lock_in_deg_s.value / world.lock_in_deg_s - 1.0:.2e}, {found.backscatter_deg.value - beta_deg:.2e}")
    assert found.lock_in_deg_s.value == pytest.approx(world.lock_in_deg_s, rel=2.5e-5)
    assert found.backscatter_deg.value == pytest.approx(beta_deg, abs=2e-3)


def errors_of(first_seed: int, world: World, records: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of rate and phase and their stated standard uncertainties, (n, 2) each."""
    errors, stated = [], []
    for seed in range(first_seed, first_seed + records):
        found = result_of(seed, world, quiet=False)
        rate, phase = found.lock_in_deg_s, found.backscatter_deg
        assert rate is not None
        assert phase is not None
        errors.append((rate.value - world.lock_in_deg_s, phase.value - world.beta_deg))
        stated.append((rate.std, phase.std))
    return np.array(errors), np.array(stated)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("first_seed", "path_m", "clock_Hz", "beta_deg"),
    [(8000, 0.15, 100_000_000, 65.0), (9000, 0.15, 20_000_000, 20.0), (9500, 0.28, 100_000_000, 20.0)],
)
def test_intervals_hold_the_truth(first_seed: int, path_m: float, clock_Hz: int, beta_deg: float) -> None:
    """Bands of 99.9 %: 200 records, of whose intervals of +-2 standard uncertainties 0.954 should hold the truth."""
    errors, stated = errors_of(first_seed, world_of(path_m, clock_Hz, beta_deg), 200)
    held = np.mean(np.abs(errors) < 2.0 * stated, axis=0)
    off = np.mean(errors, axis=0) / np.mean(stated, axis=0)
    print(f"seeds from {first_seed}: held {held}, mean off by {off} of u, spread {np.std(errors, axis=0)}")
    assert np.all(held > 0.90)
    assert np.all(np.abs(off) < 3.3 / np.sqrt(200.0))


def test_a_weak_dither_and_a_short_record_are_refused() -> None:
    laser = nominal(World())
    with pytest.raises(FitError, match="B-FIT-097"):
        expecting.expected_constants(replace(laser, rate_rad_s=laser.rate_rad_s / 6.0), 1000)
    with pytest.raises(FitError, match="B-FIT-098"):
        expecting.expected_constants(laser, 49)


def taking_off(share: float, laser: expecting.NominalLaser) -> Any:
    """A compensator that knows equation (5) and takes off a share of each jump."""

    def compensator(turns: Turnarounds) -> Jumps:
        motion = expecting.expected_turnarounds(laser)[1]
        curvature = laser.rate_rad_s * laser.omega_rad_s
        turned = motion.psi0_rad + laser.beta_rad + motion.sign * np.pi / 4.0
        jump = -laser.kappa_rad_s * np.sqrt(2.0 * np.pi / curvature) * np.sin(turned)
        return Jumps("by hand", share * jump, turned, turned, turned)

    return compensator


@pytest.mark.parametrize(("share", "shared"), [(0.0, 1.0), (0.5, 1.0), (1.0, 0.0)])
def test_what_is_not_taken_off_is_left(share: float, shared: float) -> None:
    """Equation (6) for what is left of the lock-in, beside the quantum noise."""
    found = expecting.expected_output(LASER, taking_off(share, LASER))
    lock_in = (1.0 - share) * expected_random_walk(0.05, 100.0, 0.28)
    assert walk_of_phase_deg_rth(found.walk_rad_rt_s, 0.28) == pytest.approx(np.hypot(lock_in, 1.15e-4), rel=0.01)
    assert found.shared == pytest.approx(shared, abs=0.01)


@pytest.mark.parametrize("method", SINGLE)
def test_steps_of_the_clock_and_walk_are_those_of_draws(method: str) -> None:
    """Without lock-in: 400 draws of crossings that a walk moves and a clock of 20 MHz cuts off; the step from pick-off
    to pick-off less what the compensator takes for a jump. The walk is in steps from crossing to crossing.
    """
    laser = replace(LASER, kappa_rad_s=1e-9, tick_s=5e-8, walk_rad_rt_s=20.0 * LASER.walk_rad_rt_s)
    rng = np.random.default_rng(77)
    time_s, motion = expecting.expected_turnarounds(laser)
    phase, rate = motion.phase(time_s), laser.rate_rad_s * np.sin(laser.omega_rad_s * time_s)
    edges = np.column_stack((np.full(len(time_s), -HALF_s / 2.0), time_s, np.full(len(time_s), HALF_s / 2.0)))
    steps = laser.walk_rad_rt_s * np.sqrt(np.diff(edges, axis=1))
    left = []
    for _ in range(400):
        walk = np.cumsum(steps * rng.standard_normal(steps.shape), axis=1)
        ticks = motion.sign[:, None] * rate * laser.tick_s * (rng.random(time_s.shape) - 0.5)
        jumps = SINGLE[method](turning(laser, time_s, phase + walk[:, :-1] + ticks)).dpsi_rad
        left.append(walk[:, -1] - jumps)
    drawn = float(np.sqrt(np.mean(np.var(left, axis=0)) / HALF_s))
    assert expecting.expected_output(laser, SINGLE[method]).walk_rad_rt_s == pytest.approx(drawn, rel=0.03)


def turning(laser: expecting.NominalLaser, time_s: Any, phase_rad: Any) -> Turnarounds:
    every, none = np.ones(len(time_s), bool), np.zeros(len(time_s), np.int64)
    sign = expecting.expected_turnarounds(laser)[1].sign
    return Turnarounds(
        1.0 / laser.tick_s, laser.omega_rad_s, 0.0, sign, every, every, ~every, none, none, time_s, phase_rad, {}
    )
