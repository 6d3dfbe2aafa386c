"""Tilt of the rotation axis against turned vectors, the bound, time to reach an accuracy, means of repeats."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fog_signal import FogParameters, earth_signal, mid_samples_s
from north_repeats import average_north
from scipy import stats
from scipy.spatial.transform import Rotation

from bench.model.errors import FitError
from bench.systems.north.estimators.likelihood import (
    SQUARE_PENALTY,
    likelihood_north,
    north_bound_deg,
    time_to_accuracy_s,
)
from bench.systems.north.estimators.phasors import (
    half_width_deg,
    heading_deg,
    tilt_correction_deg,
    tilt_std_deg,
    wrapped_deg,
)

THETA = np.arange(0.0, 360.0, 2.0)


def east_north(heading: float) -> np.ndarray:
    """Level unit vector towards a heading, in east, north, up."""
    return np.array([np.sin(np.deg2rad(heading)), np.cos(np.deg2rad(heading)), 0.0])


def found_heading(heading: float, x_mrad: float, y_mrad: float, latitude_deg: float) -> float:
    """Heading found on a table whose axis is tilted: every vector turned, no angle taken as small."""
    latitude = np.deg2rad(latitude_deg)
    earth = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    tilt = Rotation.from_rotvec(1e-3 * (x_mrad * east_north(heading) + y_mrad * east_north(heading + 90.0)))
    level = np.array([Rotation.from_rotvec([0, 0, np.deg2rad(theta)]).apply(east_north(heading)) for theta in THETA])
    return float(heading_deg(likelihood_north(tilt.apply(level) @ earth, THETA).phi_deg, 1))


@pytest.mark.validates(
    "north is corrected for the tilt of the rotation axis, size and sign",
    against="the Earth's rate on a sensing axis turned by scipy's rotations, headings all round, latitudes -60 to 75",
)
def test_tilt_against_turned_vectors(record_property: Callable[[str, object], None]) -> None:
    rng, before, after = np.random.default_rng(41), [], []
    for heading in np.arange(0.0, 360.0, 24.0):
        for latitude in (-60.0, 0.0, 37.0, 75.0):
            x, y = rng.uniform(-2.0, 2.0, 2)
            found = found_heading(heading, x, y, latitude)
            corrected = found + float(tilt_correction_deg(x, y, found, latitude))
            before.append(abs(float(wrapped_deg(found - heading))))
            after.append(abs(float(wrapped_deg(corrected - heading))) / (1.0 + np.tan(np.deg2rad(latitude)) ** 2))
    record_property("obtained", f"up to {max(before):.3f} deg before, {max(after):.1e} (1 + tan^2) deg behind")
    assert max(before) > 0.3
    assert max(after) < 3e-4  # square of 2.8 mrad


def test_one_arcminute_about_north() -> None:
    """At 37 degrees 1 arcmin of lean to the east turns north by 0.75 arcmin; a lean to the north does nothing."""
    arcmin_mrad = 1e3 * np.deg2rad(1.0 / 60.0)
    assert 60.0 * (found_heading(0.0, arcmin_mrad, 0.0, 37.0)) == pytest.approx(0.7536, abs=1e-3)
    assert float(tilt_correction_deg(arcmin_mrad, 0.0, 0.0, 37.0)) * 60.0 == pytest.approx(-0.7536, abs=1e-4)
    assert float(tilt_correction_deg(0.0, arcmin_mrad, 0.0, 37.0)) == pytest.approx(0.0, abs=1e-12)
    assert tilt_std_deg(arcmin_mrad, -37.0) * 60.0 == pytest.approx(0.7536, abs=1e-4)
    ten = found_heading(40.0, 10.0, 0.0, 37.0)
    assert abs(ten + float(tilt_correction_deg(10.0, 0.0, ten, 37.0)) - 40.0) < 0.005


@pytest.mark.parametrize("heading", [0.0, 20.0, 115.0, 250.0])
def test_simulated_gyroscope_on_a_tilted_table(heading: float) -> None:
    """The simulation projects vectors, about north and east; the level reads the same tilt about the bench's axes."""
    north_deg, east_deg = 0.1, -0.06
    parameters = FogParameters(
        phi_e_deg=90.0 - heading, random_walk_V=0.0, vibration_V=0.0,
        rotation_tilt_north_deg=north_deg, rotation_tilt_east_deg=east_deg,
    )  # fmt: skip
    u, theta = earth_signal(parameters, mid_samples_s(200.0, 5.0), np.random.default_rng(42))
    found = float(heading_deg(likelihood_north(u, theta).phi_deg, 1))
    tilt = np.deg2rad([east_deg, north_deg, 0.0]) * 1e3
    x, y = tilt @ east_north(heading), tilt @ east_north(heading + 90.0)
    assert abs(float(wrapped_deg(found - heading))) > 0.07
    assert float(wrapped_deg(found + tilt_correction_deg(x, y, found, 37.0) - heading)) == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("latitude_deg", [89.5, -90.0, float("nan")])
def test_there_is_no_north_at_a_pole(latitude_deg: float) -> None:
    with pytest.raises(FitError, match="B-FIT-115"):
        tilt_correction_deg(0.1, 0.1, 20.0, latitude_deg)


def test_bound_is_the_inverse_of_the_information() -> None:
    """Fisher's matrix of amplitude, phase and offset from differences of the model."""
    theta, at, step = np.deg2rad(np.arange(2000) * 1.8 + 0.9), np.array([0.8, 1.1, 0.3]), 1e-6

    def model(values: np.ndarray) -> np.ndarray:
        return values[0] * np.sin(theta + values[1]) + values[2]

    slopes = np.array([(model(at + step * one) - model(at - step * one)) / (2 * step) for one in np.eye(3)])
    least = np.sqrt(np.linalg.inv(slopes @ slopes.T / 0.6**2)[1, 1])
    assert float(north_bound_deg(0.8, 0.6, 2000)) == pytest.approx(np.rad2deg(least), rel=1e-6)


def test_penalty_of_a_square_reference() -> None:
    """Noise power over the square of the signal, square reference against sine, by sums over a turn."""
    angle = 2 * np.pi * (np.arange(100_000) + 0.5) / 100_000
    square, sine = np.sign(np.sin(angle)), np.sin(angle)
    power = [np.mean(one**2) / np.mean(one * sine) ** 2 for one in (square, sine)]
    assert pytest.approx(np.sqrt(power[0] / power[1]), rel=1e-6) == SQUARE_PENALTY
    assert pytest.approx(1.1107, abs=1e-4) == SQUARE_PENALTY


def test_time_to_reach_an_accuracy() -> None:
    assert float(time_to_accuracy_s(0.45, 20.0, 0.1)) == pytest.approx(405.0)
    np.testing.assert_allclose(time_to_accuracy_s([0.45, 0.9], 20.0, 0.1, factor=2.0), [1620.0, 6480.0])
    assert float(time_to_accuracy_s(0.45, 20.0, 0.1, floor_deg=0.06)) == pytest.approx(405.0 / 0.64)
    assert float(time_to_accuracy_s(0.45, 20.0, 0.1, factor=2.0, floor_deg=0.05)) == np.inf
    with pytest.raises(FitError, match=r"B-FIT-114.*0 deg after 20 s"):
        time_to_accuracy_s(0.45, 20.0, 0.0)


def test_phasors_are_averaged_not_angles() -> None:
    """About 180 degrees the mean of the angles is about 0."""
    angles = np.array([179.0, -179.5, 179.5, -178.0])
    found = average_north(np.exp(1j * np.deg2rad(angles)))
    assert abs(angles.mean()) < 1.0
    assert float(found.phi_deg) == pytest.approx(-179.75, abs=1e-2)
    unwrapped = np.mod(angles, 360.0)
    assert float(found.scatter_deg) == pytest.approx(np.std(unwrapped, ddof=1), rel=1e-3)
    assert float(found.std_deg) == pytest.approx(stats.sem(unwrapped), rel=1e-3)
    interval = stats.t.interval(0.95, 3, scale=stats.sem(unwrapped))
    assert float(found.half_width_deg()) == pytest.approx(interval[1], rel=1e-3)
    assert (found.dof, found.repeats) == (3.0, 4)


def test_means_of_many_headings_and_of_too_few_repeats() -> None:
    phasors = np.exp(1j * np.deg2rad(np.array([[10.0, 100.0], [12.0, 104.0]]))) * np.array([[1.0], [1.3]])
    found = average_north(phasors)
    assert found.phi_deg.shape == found.amplitude.shape == (2,)
    for few in (phasors[:1], phasors[0, 0]):
        with pytest.raises(ValueError, match="no scatter"):
            average_north(few)


def test_width_of_an_interval() -> None:
    widths = half_width_deg(np.array([0.01, 1.0, 40.0, np.nan]), np.array([4.0, np.inf, 4.0, 4.0]))
    np.testing.assert_allclose(widths[:2], [0.01 * stats.t.ppf(0.975, 4), 1.96], rtol=1e-3)
    assert widths[2] == 180.0
    assert np.isnan(widths[3])
