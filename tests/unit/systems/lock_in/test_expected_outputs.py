"""What compensators of single turnarounds are expected to leave, against draws and against what can be said by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench.systems.lock_in.compensation import SINGLE
from bench.systems.lock_in.estimators.expected_constants import (
    ExpectedOutput,
    NominalLaser,
    expected_output,
    expected_turnarounds,
)
from bench.systems.lock_in.estimators.random_walk import expected_random_walk, gyro_gain, walk_of_phase_deg_rth
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds

GAIN = gyro_gain(0.28)
LASER = NominalLaser(
    kappa_rad_s=GAIN * np.radians(0.05), beta_rad=np.radians(40.0), omega_rad_s=2.0 * np.pi * 400.0,
    rate_rad_s=GAIN * np.radians(100.0), walk_rad_rt_s=GAIN * np.radians(1.15e-4 / 60.0), tick_s=1e-8,
)  # fmt: skip
HALF_s = 1.25e-3
SEED = 77


def taking_off(share: float, laser: NominalLaser) -> Any:
    """A compensator that knows equation (5) and takes off a share of each jump."""

    def compensator(turns: Turnarounds) -> Jumps:
        motion = expected_turnarounds(laser)[1]
        curvature = laser.rate_rad_s * laser.omega_rad_s
        turned = motion.psi0_rad + laser.beta_rad + motion.sign * np.pi / 4.0
        jump = -laser.kappa_rad_s * np.sqrt(2.0 * np.pi / curvature) * np.sin(turned)
        return Jumps("by hand", share * jump, turned, turned, turned, turned)

    return compensator


@pytest.mark.parametrize(("share", "shared"), [(0.0, 1.0), (0.5, 1.0), (1.0, 0.0)])
def test_what_is_not_taken_off_is_left(share: float, shared: float) -> None:
    """Equation (6) for what is left of the lock-in, beside the quantum noise."""
    found = expected_output(LASER, taking_off(share, LASER))
    lock_in = (1.0 - share) * expected_random_walk(0.05, 100.0, 0.28)
    assert walk_of_phase_deg_rth(found.walk_rad_rt_s, 0.28) == pytest.approx(np.hypot(lock_in, 1.15e-4), rel=0.01)
    assert found.shared == pytest.approx(shared, abs=0.01)


@pytest.mark.parametrize("method", SINGLE)
def test_steps_of_the_clock_and_walk_are_those_of_draws(method: str) -> None:
    """Without lock-in: 400 draws of crossings that a walk moves and a clock of 20 MHz cuts off; the step from pick-off
    to pick-off less what the compensator takes for a jump. The walk is in steps from crossing to crossing.
    """
    laser = replace(LASER, kappa_rad_s=1e-9, tick_s=5e-8, walk_rad_rt_s=20.0 * LASER.walk_rad_rt_s)
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    time_s, motion = expected_turnarounds(laser)
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
    assert expected_output(laser, SINGLE[method]).walk_rad_rt_s == pytest.approx(drawn, rel=0.03)


def turning(laser: NominalLaser, time_s: Any, phase_rad: Any) -> Turnarounds:
    every, none = np.ones(len(time_s), bool), np.zeros(len(time_s), np.int64)
    sign = expected_turnarounds(laser)[1].sign
    return Turnarounds(
        1.0 / laser.tick_s, laser.omega_rad_s, 0.0, sign, every, every, ~every, none, none, time_s, phase_rad, {}
    )


def test_a_phase_of_90_degrees_is_the_best_for_the_shape_of_the_dither() -> None:
    """The ripple is zero at the crossings there, and largest at 0 degrees."""

    def left(beta_deg: float) -> ExpectedOutput:
        return expected_output(replace(LASER, beta_rad=np.radians(beta_deg)), SINGLE["dither_shape"])

    walks = [left(beta_deg).walk_rad_rt_s for beta_deg in (0.0, 40.0, 90.0)]
    assert walks == sorted(walks, reverse=True)
    assert left(90.0).walk_rad_rt_s == pytest.approx(left(-90.0).walk_rad_rt_s, rel=0.02)
