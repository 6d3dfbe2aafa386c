"""The earth signal and two lock-ins: Bessel series, densities, harmonics, and figures from the design's own tables."""

import numpy as np
import pytest
from fog_signal import (
    FogParameters,
    density_V_rtHz,
    earth_signal,
    eight_records,
    eight_samples,
    lock_in_averages,
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


def test_the_small_swing_is_equation_6():
    t_s, theta0 = mid_samples_s(FS_HZ, 1.0), np.deg2rad(0.05)
    carrier = 2.0 * np.pi * t_s + np.deg2rad(70.0)
    due = np.sin(carrier) + theta0 * np.cos(carrier) * np.sin(2.0 * np.pi * 60.0 * t_s)
    found = earth_signal(FogParameters(phi_e_deg=70.0, **QUIET), t_s, NOBODY)[0]
    np.testing.assert_allclose(found, due, atol=theta0**2 / 1.9)


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


def test_both_noises_are_gaussian_and_add_by_squares():
    rng = np.random.default_rng(21)
    u_V = earth_signal(FogParameters(ke_V=0.0, random_walk_V=0.3, vibration_V=0.4), mid_samples_s(FS_HZ, 200.0), rng)[0]
    assert u_V.std() == pytest.approx(0.5, rel=0.01)
    assert np.mean(u_V**4) / np.mean(u_V**2) ** 2 == pytest.approx(3.0, abs=0.05)


def test_lock_in_1_reads_the_sine_and_lock_in_2_the_cosine():
    for reference, gain in (("square", 2.0 / np.pi), ("sine", 0.5)):
        u1, u2 = eight_samples(
            FogParameters(phi_e_deg=AZIMUTHS, wobble_deg=0.0, **QUIET), FS_HZ, TAU_S, NOBODY, reference
        )
        phases = np.deg2rad(AZIMUTHS[:, None] + np.array([0.0, 90.0, 180.0, 270.0]))
        np.testing.assert_allclose(u1, gain * np.sin(phases), atol=2e-6)
        np.testing.assert_allclose(u2, gain * np.cos(phases), atol=2e-6)


def test_without_noise_every_azimuth_comes_back():
    for variation in ("constant", "double"):
        parameters = FogParameters(phi_e_deg=AZIMUTHS, variation=variation, **QUIET)
        found = of_phasor(*eight_samples(parameters, FS_HZ, TAU_S, NOBODY))
        assert np.abs(wrapped(found - AZIMUTHS)).max() < 1e-9


def test_one_azimuth_or_many_are_the_same():
    one = eight_samples(FogParameters(phi_e_deg=40.0, **QUIET), FS_HZ, TAU_S, NOBODY)
    many = eight_samples(FogParameters(phi_e_deg=np.array([40.0, 40.0]), **QUIET), FS_HZ, TAU_S, NOBODY)
    assert one[0].shape == (4,)
    np.testing.assert_array_equal(many[0], np.tile(one[0], (2, 1)))


@pytest.mark.parametrize(("order", "square_deg"), [(2, 0.0), (3, 0.191), (4, 0.0), (5, 0.1146)])
def test_odd_harmonics_pass_a_square_reference_and_none_passes_a_sine(order, square_deg):
    parameters = FogParameters(phi_e_deg=np.arange(0.0, 360.0, 1.0), harmonics={order: 0.01}, **QUIET)
    worst = {}
    for reference in ("square", "sine"):
        found = of_phasor(*eight_samples(parameters, FS_HZ, 1.0, NOBODY, reference))
        worst[reference] = np.abs(wrapped(found - parameters.phi_e_deg)).max()
    assert worst["square"] == pytest.approx(square_deg, abs=5e-4)
    assert worst["sine"] < 1e-9


def test_the_swing_hardly_matters():
    """A square reference listens to the sidebands at 59 f0 and 61 f0: both gains grow alike, north does not move."""
    t_s, z = mid_samples_s(10_000.0, TAU_S), np.deg2rad(0.05)
    u_V, _ = earth_signal(FogParameters(phi_e_deg=AZIMUTHS, **QUIET), t_s, NOBODY)
    first, second = lock_in_averages(u_V, 360.0 * t_s, 10_000.0, TAU_S)
    gain = jv(0, z) + jv(1, z) * (1 / 61 + 1 / 59)  # 1 + 1.437e-5
    np.testing.assert_allclose(np.hypot(first, second) * np.pi / 2.0, gain, atol=4e-8)
    assert np.abs(wrapped(np.rad2deg(np.arctan2(first, second)) - AZIMUTHS)).max() < 1e-9


def test_samples_on_the_edges_of_the_reference_are_a_trap():
    """sgn 0 = 0: of a grid that begins at 0 a sample is lost at each edge; the mid-sample grid has none there."""
    grid_s = np.arange(5000) / FS_HZ
    parameters = FogParameters(phi_e_deg=AZIMUTHS, wobble_deg=0.0, **QUIET)
    error_deg = []
    for t_s in (grid_s, grid_s + 0.5 / FS_HZ):
        u_V, theta_deg = earth_signal(parameters, t_s, NOBODY)
        first, second = lock_in_averages(u_V, theta_deg, FS_HZ, TAU_S)
        error_deg.append(np.abs(wrapped(np.rad2deg(np.arctan2(first, second)) - AZIMUTHS)).max())
    assert error_deg[0] > 0.1
    assert error_deg[1] < 1e-9


def test_a_tilt_of_the_rotation_axis_turns_north():
    t_s = mid_samples_s(FS_HZ, TAU_S)
    found = {}
    for arcmin in (0.0, 1.0):
        parameters = FogParameters(phi_e_deg=70.0, rotation_tilt_north_deg=arcmin / 60.0, wobble_deg=0.0, **QUIET)
        u_V, theta_deg = earth_signal(parameters, t_s, NOBODY)
        first, second = lock_in_averages(u_V, theta_deg, FS_HZ, TAU_S, "sine")
        found[arcmin] = np.rad2deg(np.arctan2(first, second)) * 60.0
    assert found[1.0] - found[0.0] == pytest.approx(-0.7536, abs=1e-3)  # arc minutes of phi, tan 37 deg


def test_a_tilted_sensing_axis_feels_the_table_where_that_is_asked_for():
    t_s = mid_samples_s(FS_HZ, 2.0)
    base = FogParameters(axis_tilt_deg=1.0 / 60.0, wobble_deg=0.0, **QUIET)
    without = earth_signal(base, t_s, NOBODY)[0]
    within = earth_signal(FogParameters(**{**vars(base), "table_rate": True}), t_s, NOBODY)[0]
    vertical = np.tan(np.deg2rad(37.0)) * np.sin(np.deg2rad(1.0 / 60.0))
    assert without.mean() == pytest.approx(vertical, rel=1e-6)
    due = 360.0 * 3600.0 * np.sin(np.deg2rad(1.0 / 60.0)) / (15.041067 * np.cos(np.deg2rad(37.0)))
    np.testing.assert_allclose(within - without, due, rtol=1e-6)  # 31.4 times the amplitude


@pytest.mark.parametrize(("variation", "due_deg"), [("slow", 0.155), ("linear", 0.039), ("step", 0.0), ("double", 0.0)])
def test_varying_parameters_without_noise_against_the_table_of_the_design(variation, due_deg):
    parameters = FogParameters(phi_e_deg=np.tile(AZIMUTHS, 2), variation=variation, **QUIET)
    found = of_phasor(*eight_samples(parameters, FS_HZ, TAU_S, np.random.default_rng(31)))
    assert rms(wrapped(found - parameters.phi_e_deg)) == pytest.approx(due_deg, abs=max(0.12 * due_deg, 2e-4))


def test_a_gain_at_twice_the_turns_cannot_be_told_from_a_turned_north_in_one_window():
    parameters = FogParameters(phi_e_deg=np.tile(AZIMUTHS, 3), variation="double", **QUIET)
    t_s = mid_samples_s(FS_HZ, TAU_S)
    u_V, theta_deg = earth_signal(parameters, t_s, np.random.default_rng(32))
    first, second = lock_in_averages(u_V, theta_deg, FS_HZ, TAU_S)
    assert rms(wrapped(np.rad2deg(np.arctan2(first, second)) - parameters.phi_e_deg)) == pytest.approx(4.35, abs=0.3)


def ratio_to_bound(runs, seed):
    azimuths = np.linspace(0.0, 360.0, runs, endpoint=False)
    parameters = FogParameters(phi_e_deg=azimuths)
    found = of_phasor(*eight_samples(parameters, FS_HZ, TAU_S, np.random.default_rng(seed)))
    bound_deg = np.rad2deg(np.sqrt(2.0 * parameters.sigma_V**2 / (parameters.ke_V**2 * FS_HZ * 4.0 * TAU_S)))
    assert bound_deg == pytest.approx(0.405, abs=5e-4)
    return rms(wrapped(found - azimuths)) / bound_deg


def test_noise_gives_the_scatter_of_a_square_reference():
    assert ratio_to_bound(480, 41) == pytest.approx(np.pi / np.sqrt(8.0), rel=4.0 / np.sqrt(2 * 480))


@pytest.mark.sweep
def test_noise_gives_the_scatter_of_a_square_reference_over_many_runs():
    assert ratio_to_bound(4800, 42) == pytest.approx(np.pi / np.sqrt(8.0), rel=4.0 / np.sqrt(2 * 4800))


def test_the_records_are_those_of_the_samples():
    parameters = FogParameters(phi_e_deg=np.array([10.0, 200.0]), variation="white")
    u_V, theta_deg, reference_deg = eight_records(parameters, FS_HZ, 1.0, np.random.default_rng(50))
    assert u_V.shape == theta_deg.shape == (2, 4, 1000)
    samples = eight_samples(parameters, FS_HZ, 1.0, np.random.default_rng(50))
    np.testing.assert_array_equal(np.array(lock_in_averages(u_V, reference_deg, FS_HZ, 1.0)), np.array(samples))
    stepped_deg = theta_deg - reference_deg - np.array([0.0, 90.0, 180.0, 270.0])[:, None]
    assert np.abs(stepped_deg).max() < 0.0601  # the swing, within 20 %


def test_white_variation_is_new_each_sample_and_steps_each_turn():
    t_s = mid_samples_s(FS_HZ, 10.0)
    rng = np.random.default_rng(51)
    for variation, samples in (("white", 1), ("step", 1000)):
        parameters = FogParameters(phi_e_deg=90.0, wobble_deg=0.0, variation=variation, **QUIET)
        gain = earth_signal(parameters, t_s, rng)[0] / np.cos(2.0 * np.pi * t_s)
        assert np.unique(gain.round(9)).size == 10_000 // samples
        assert 0.8 <= gain.min() < gain.max() <= 1.2


def test_the_load_angle_turns_the_table_and_its_reference_alike():
    parameters = FogParameters(phi_e_deg=AZIMUTHS, load_angle_deg=2.0, **QUIET)
    found = of_phasor(*eight_samples(parameters, FS_HZ, TAU_S, NOBODY, "sine"))
    assert np.abs(wrapped(found - AZIMUTHS)).max() < 1e-9
    u_V, _ = earth_signal(parameters, t_s := mid_samples_s(FS_HZ, TAU_S), NOBODY)
    generator = lock_in_averages(u_V, 360.0 * t_s, FS_HZ, TAU_S, "sine")  # which knows nothing of the load
    np.testing.assert_allclose(wrapped(np.rad2deg(np.arctan2(*generator)) - AZIMUTHS), -2.0, atol=1e-9)


def test_what_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="'sometimes' does not exist"):
        earth_signal(FogParameters(variation="sometimes"), mid_samples_s(FS_HZ, 1.0), NOBODY)
    with pytest.raises(ValueError, match="neither square nor sine"):
        lock_in_averages(np.zeros(10), np.zeros(10), 10.0, 1.0, "triangle")
