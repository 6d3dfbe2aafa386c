"""The earth signal and two lock-ins: Bessel series, densities, harmonics, and figures from the design's own tables."""

import numpy as np
import pytest
from fog_signal import (
    FogParameters,
    density_V_rtHz,
    earth_signal,
    eight_samples,
    mid_samples_s,
    sample_sigma_V,
)
from scipy.signal import periodogram
from scipy.special import jv

FS_HZ, TAU_S = 1000.0, 5.0
QUIET = {"random_walk_V": 0.0, "vibration_V": 0.0}
AZIMUTHS = np.arange(0.0, 360.0, 3.0)
NOBODY = np.random.default_rng(0)  # for signals without a draw


def wrapped(deg):
    return (np.asarray(deg) + 180.0) % 360.0 - 180.0


def of_phasor(u1, u2):
    """Phase by the sum of the four simultaneous pairs, turned back; degrees."""
    return np.rad2deg(np.angle(((u2 + 1j * u1) * (-1j) ** np.arange(4)).sum(axis=-1)))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_swing_is_the_bessel_series_of_the_paper():
    """Equation (5), to order 8, with a swing a hundred times the usual one."""
    t_s, z = mid_samples_s(FS_HZ, 2.0), np.deg2rad(5.0)
    omega, alpha, phi = 2.0 * np.pi, 2.0 * np.pi * 7.3, np.deg2rad(33.0)
    series = jv(0, z) * np.sin(omega * t_s + phi)
    for m in range(1, 9):
        upper, lower = np.sin((omega + m * alpha) * t_s + phi), np.sin((omega - m * alpha) * t_s + phi)
        series += jv(m, z) * (upper + (-1) ** m * lower)
    parameters = FogParameters(phi_e_deg=33.0, wobble_deg=5.0, wobble_Hz=7.3, **QUIET)
    np.testing.assert_allclose(earth_signal(parameters, t_s, NOBODY)[0], series, atol=1e-13)


def test_the_phase_of_the_swing_is_the_integral_of_its_frequency():
    """sin(alpha(t) t) swings faster the longer it takes: the trap is shown, and not fallen into."""
    t_s = mid_samples_s(FS_HZ, 20.0)
    parameters = FogParameters(wobble_deg=1.0, variation="linear", **QUIET)
    theta_deg = earth_signal(parameters, t_s, NOBODY)[1]
    change = 0.2 * (t_s / 10.0 - 1.0)
    swing = (theta_deg - 360.0 * t_s) / (1.0 + change)
    summed = np.cumsum(60.0 * (1.0 + change)) / FS_HZ - 30.0 * (1.0 + change) / FS_HZ  # turns at mid-sample
    np.testing.assert_allclose(swing, np.sin(2.0 * np.pi * summed), atol=1e-3)
    trap = np.sin(2.0 * np.pi * 60.0 * (1.0 + change) * t_s)
    assert swings_per_s(swing, t_s > 19.0) == pytest.approx(72.0, abs=1.0)
    assert swings_per_s(trap, t_s > 19.0) > 80.0


def swings_per_s(swing, where):
    return np.count_nonzero(np.diff(np.signbit(swing[where]))) / 2.0 / (np.count_nonzero(where) / FS_HZ)


def test_noise_has_the_density_its_samples_say():
    rng = np.random.default_rng(20)
    for fs_Hz in (200.0, 1000.0):
        parameters = FogParameters(ke_V=0.0)
        u_V = earth_signal(parameters, mid_samples_s(fs_Hz, 100.0), rng)[0]
        _, power = periodogram(u_V, fs_Hz, detrend=False)
        mean, n = power[1:-1].mean(), power.size
        assert mean == pytest.approx(density_V_rtHz(parameters.sigma_V, fs_Hz) ** 2, rel=5.0 / np.sqrt(n))
        thirds = [part.mean() for part in np.array_split(power[1:-1], 3)]
        assert np.ptp(thirds) / mean < 8.0 / np.sqrt(n / 3.0)  # white
        assert sample_sigma_V(density_V_rtHz(0.5, fs_Hz), fs_Hz) == pytest.approx(0.5)
    assert density_V_rtHz(0.5, 1000.0) == pytest.approx(0.022361, abs=1e-6)


@pytest.mark.parametrize(("order", "square_deg"), [(2, 0.0), (3, 0.191), (4, 0.0), (5, 0.1146)])
def test_odd_harmonics_pass_a_square_reference_and_none_passes_a_sine(order, square_deg):
    parameters = FogParameters(phi_e_deg=np.arange(0.0, 360.0, 1.0), harmonics={order: 0.01}, **QUIET)
    worst = {}
    for reference in ("square", "sine"):
        found = of_phasor(*eight_samples(parameters, FS_HZ, 1.0, NOBODY, reference))
        worst[reference] = np.abs(wrapped(found - parameters.phi_e_deg)).max()
    assert worst["square"] == pytest.approx(square_deg, abs=5e-4)
    assert worst["sine"] < 1e-9


@pytest.mark.parametrize(("variation", "due_deg"), [("slow", 0.155), ("linear", 0.039), ("step", 0.0), ("double", 0.0)])
def test_varying_parameters_without_noise_against_the_table_of_the_design(variation, due_deg):
    parameters = FogParameters(phi_e_deg=np.tile(AZIMUTHS, 2), variation=variation, **QUIET)
    found = of_phasor(*eight_samples(parameters, FS_HZ, TAU_S, np.random.default_rng(31)))
    assert rms(wrapped(found - parameters.phi_e_deg)) == pytest.approx(due_deg, abs=max(0.12 * due_deg, 2e-4))


@pytest.mark.parametrize(("runs", "seed"), [(480, 41), pytest.param(4800, 42, marks=pytest.mark.sweep)])
def test_noise_gives_the_scatter_of_a_square_reference(runs, seed):
    azimuths = np.linspace(0.0, 360.0, runs, endpoint=False)
    parameters = FogParameters(phi_e_deg=azimuths)
    found = of_phasor(*eight_samples(parameters, FS_HZ, TAU_S, np.random.default_rng(seed)))
    bound_deg = np.rad2deg(np.sqrt(2.0 * parameters.sigma_V**2 / (parameters.ke_V**2 * FS_HZ * 4.0 * TAU_S)))
    assert bound_deg == pytest.approx(0.405, abs=5e-4)
    ratio = rms(wrapped(found - azimuths)) / bound_deg
    assert ratio == pytest.approx(np.pi / np.sqrt(8.0), rel=4.0 / np.sqrt(2 * runs))
