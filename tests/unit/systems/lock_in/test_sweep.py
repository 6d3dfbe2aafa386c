"""The compensators' acceptance figures over whole records of 20 s, and how they degrade."""

from __future__ import annotations

import numpy as np
import pytest
from rlg_chain import Chain, chain, simulated
from rlg_second_opinion import Gyro, simulate

from bench.systems.lock_in.estimators.random_walk import path_exponent
from sim_instruments.worlds.lock_in.core import RingLaser, quantum_deg_rt_h

pytestmark = pytest.mark.sweep
PATHS_m, SECONDS = (0.15, 0.28, 0.34), 20.0


def told(found: Chain, label: str) -> dict[str, float]:
    ratios = found.ratios()
    print(f"{label} {found.turns.clock_Hz / 1e6:.0f} MHz", {name: round(value, 4) for name, value in ratios.items()})
    return ratios


@pytest.mark.parametrize("path_m", PATHS_m)
def test_backscatter_at_90_degrees(path_m: float) -> None:
    laser = RingLaser(path_m=path_m)
    slow, fast = simulated(laser, SECONDS, 1, 20e6, 100e6)
    assert fast.walk().n_deg_rth == pytest.approx(laser.lock_in_walk_deg_rt_h, rel=0.08)
    at_slow, at_fast = (told(found, f"{path_m} m, 90 deg") for found in (slow, fast))
    assert 0.25 < at_fast["J4"] < 0.40
    assert 0.28 < at_slow["J4"] < 0.52
    assert at_fast["S16"] < 0.07
    assert max(at_fast["G"], at_slow["G"]) < 0.02


@pytest.mark.parametrize("path_m", PATHS_m)
def test_backscatter_at_40_degrees(path_m: float) -> None:
    for found in simulated(RingLaser(path_m=path_m, beta_rad=np.deg2rad(40.0)), SECONDS, 2, 20e6, 100e6):
        ratios = told(found, f"{path_m} m, 40 deg")
        assert 0.7 < ratios["J4"] < 0.95
        assert 0.4 < ratios["J16"] < 0.65
        assert ratios["P4"] > 1.3
        assert ratios["G"] < 0.02


@pytest.mark.parametrize("path_m", PATHS_m)
def test_quantum_noise_is_what_is_left(path_m: float) -> None:
    laser = RingLaser(path_m=path_m, beta_rad=0.7, quantum_deg_rt_h=quantum_deg_rt_h(path_m))
    expected = np.hypot(laser.quantum_deg_rt_h / laser.lock_in_walk_deg_rt_h, 0.005)
    for found in simulated(laser, SECONDS, 3, 20e6, 100e6):
        assert told(found, f"{path_m} m, quantum noise")["G"] == pytest.approx(expected, rel=0.2)


def test_walk_goes_with_the_path_to_the_power_minus_two_and_a_half() -> None:
    walks = [simulated(RingLaser(path_m=path_m), SECONDS, 4, 100e6)[0].walk() for path_m in PATHS_m]
    n_deg_rth, std = np.array([(walk.n_deg_rth, walk.n_std_deg_rth) for walk in walks]).T
    exponent, uncertainty = path_exponent(np.array(PATHS_m), n_deg_rth, std)
    print(f"exponent {exponent:.3f} +- {uncertainty:.3f}")
    assert exponent == pytest.approx(-2.5, abs=0.15)


@pytest.mark.parametrize(
    ("label", "most", "wrong"),
    [
        ("drift 0.01 rad/s", 0.02, {"beta_drift_rad_s": 0.01}),
        ("drift 0.1 rad/s", 0.05, {"beta_drift_rad_s": 0.1}),
        ("second harmonic 1 %", 0.02, {"second_harmonic": 0.01}),
        ("second harmonic 10 %", 0.12, {"second_harmonic": 0.1}),
        ("beat noise 1 %", 0.04, {"beat_noise_rad": 0.01}),
        ("beat noise 3 %", 0.08, {"beat_noise_rad": 0.03}),
    ],
)
def test_degradation(label: str, most: float, wrong: dict[str, float]) -> None:
    """Limits of the default method on a gyroscope that its model does not describe; the others are printed."""
    gyro = Gyro(beta=0.7, **wrong)
    beat = simulate(gyro, SECONDS, seed=5)
    of_beat, pickoff = (beat.time_s, beat.rising, beat.cosine), (beat.pickoff_s, beat.pickoff_rising)
    for clock_Hz in (20e6, 100e6):
        assert told(chain(gyro.path_m, clock_Hz, of_beat, pickoff), label)["G"] < most
