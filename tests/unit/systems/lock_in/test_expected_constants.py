"""What the global fit states of lock-in: true on an exact physics (``laser_physics``) without noise, and as predicted
with noise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from doubt_lock_in import simulated
from laser_physics import World, added, higher, integrals
from scipy.integrate import solve_ivp

from bench.model.errors import FitError
from bench.systems.lock_in.estimators.expected_constants import NominalLaser, expected_constants
from bench.systems.lock_in.records import laser_records
from bench.systems.lock_in.result import LaserResult, laser_result


def result_of(seed: int, world: World, *, quiet: bool) -> LaserResult:
    (record,) = laser_records(simulated(seed, world, quiet=quiet).material)
    return laser_result(record)


def world_of(path_m: float, clock_Hz: int, beta_deg: float) -> World:
    """Four seconds of the laser of 28 cm with another path."""
    wider = (0.28 / path_m) ** 2
    return World(path_m=path_m, clock_Hz=clock_Hz, beta_deg=beta_deg, seconds=4.0,
                 lock_in_deg_s=0.05 * wider, quantum_deg_rth=1.15e-4 * wider)  # fmt: skip


def nominal(world: World) -> NominalLaser:
    """The laser of a world, by its own words."""
    return NominalLaser(
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


@pytest.mark.parametrize(("path_m", "clock_Hz", "beta_deg"), [(0.15, 100_000_000, 0.0), (0.28, 20_000_000, 90.0)])
def test_the_fit_states_what_was_expected(path_m: float, clock_Hz: int, beta_deg: float) -> None:
    world = world_of(path_m, clock_Hz, beta_deg)
    (stated,) = result_of(8, world, quiet=False).found.constants
    expected = expected_constants(nominal(world), round(world.seconds / world.half_s))
    assert stated.kappa_std_rad_s == pytest.approx(expected.kappa_std_rad_s, rel=0.08)
    assert stated.beta_std_rad == pytest.approx(expected.beta_std_rad, rel=0.08)
    jump = nominal(world).jump_squared / 2.0
    assert np.mean(expected.jumps.dpsi_rad**2) == pytest.approx(jump, rel=1e-3)
    assert np.nanmean(stated.jumps.dpsi_rad**2) == pytest.approx(jump, rel=0.06)


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
    with pytest.raises(FitError) as caught:
        expected_constants(replace(laser, rate_rad_s=laser.rate_rad_s / 6.0), 1000)
    assert caught.value.code == "B-FIT-097"
    with pytest.raises(FitError) as caught:
        expected_constants(laser, 49)
    assert caught.value.code == "B-FIT-098"
