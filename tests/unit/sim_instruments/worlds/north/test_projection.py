"""What a gyroscope on a tilted, turning table feels of the Earth, against geometry from elsewhere."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_instruments.worlds.north.projection import earth_rate_rad_s, sensed_rad_s, tilted

LATITUDE_DEG = 37.0
EARTH_DEG_H = 15.041067


def of_heading(heading_deg, **tilts):
    """Sensed rate of an axis of that heading, deg/h."""
    in_table = tilted(tilts.get("east", 0.0), tilts.get("north", 0.0)).T @ earth_rate_rad_s(LATITUDE_DEG)
    angle_rad = np.deg2rad(90.0 - np.asarray(heading_deg))
    return np.rad2deg(sensed_rad_s(in_table, angle_rad, tilts.get("axis", 0.0))) * 3600.0


def phase_deg(sensed):
    """Heading of the largest rate when all whole degrees of heading are given."""
    headings = np.deg2rad(np.arange(360.0))
    return np.rad2deg(np.arctan2(sensed @ np.sin(headings), sensed @ np.cos(headings)))


def amplitude(sensed):
    headings = np.deg2rad(np.arange(360.0))
    return np.hypot(sensed @ np.sin(headings), sensed @ np.cos(headings)) / 180.0


@pytest.mark.parametrize("longitude_deg", [0.0, 127.0])
def test_against_the_axis_of_the_earth_in_earth_fixed_coordinates(longitude_deg):
    """Axis of rotation (0, 0, 1), local directions by longitude and latitude: nothing local is assumed."""
    latitude, longitude = np.deg2rad([LATITUDE_DEG, longitude_deg])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    north = np.cross(up, east)
    for heading_deg in (0.0, 20.0, 135.0, 300.0):
        heading = np.deg2rad(heading_deg)
        axis = np.cos(heading) * north + np.sin(heading) * east
        assert of_heading(heading_deg) == pytest.approx(EARTH_DEG_H * axis[2], abs=2e-6)


def test_nothing_is_felt_east_and_west_and_most_north():
    east, west, north, south = of_heading([90.0, 270.0, 0.0, 180.0])
    assert max(abs(east), abs(west)) < 1e-12
    assert north == -south == pytest.approx(EARTH_DEG_H * np.cos(np.deg2rad(LATITUDE_DEG)), abs=2e-6)


@pytest.mark.parametrize(("east", "north"), [(1.0, 0.0), (0.0, -2.0), (0.7, 0.4)])
def test_the_tilt_is_a_turn_by_its_vector(east, north):
    vector = np.deg2rad([east, north, 0.0])
    np.testing.assert_allclose(tilted(east, north), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
    for heading_deg in (0.0, 50.0, 222.0):
        flat = np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg)), 0.0])
        axis = Rotation.from_rotvec(vector).apply(flat)
        due = EARTH_DEG_H * axis @ [0.0, np.cos(np.deg2rad(LATITUDE_DEG)), np.sin(np.deg2rad(LATITUDE_DEG))]
        assert of_heading(heading_deg, east=east, north=north) == pytest.approx(due, abs=2e-6)


def test_a_tilt_about_north_turns_north_and_one_about_east_does_not():
    headings = np.arange(360.0)
    arcmin = 1.0 / 60.0
    apparent_north = phase_deg(of_heading(headings, north=arcmin))
    assert apparent_north * 60.0 == pytest.approx(-np.tan(np.deg2rad(37.0)), rel=1e-4)  # 0.75 arcmin to the west
    assert abs(phase_deg(of_heading(headings, east=arcmin))) < 1e-9
    gain = amplitude(of_heading(headings, east=arcmin)) / amplitude(of_heading(headings))
    assert gain - 1.0 == pytest.approx(np.deg2rad(arcmin) * np.tan(np.deg2rad(37.0)), rel=1e-3)


def test_an_axis_out_of_the_plane_loses_little_and_feels_the_vertical():
    headings = np.arange(360.0)
    level, tilted_axis = of_heading(headings), of_heading(headings, axis=1.0)
    loss = amplitude(tilted_axis) / amplitude(level) - 1.0
    assert loss == pytest.approx(-0.000152, abs=1e-6)  # the paper's factor 1 - sin: -0.0175
    assert tilted_axis.mean() == pytest.approx(EARTH_DEG_H * np.sin(np.deg2rad(37.0)) * np.sin(np.deg2rad(1.0)), 1e-6)
