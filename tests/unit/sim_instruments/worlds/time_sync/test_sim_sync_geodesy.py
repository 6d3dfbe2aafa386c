"""What the simulated EGI tells of a place in the tangent plane: against published figures and a second method."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.maths.geodesy import TangentFrame, body_to_level
from sim_instruments.worlds.time_sync.geodesy import TangentPlane, euler_rad, level_axes, to_earth, to_geodetic

close = partial(np.testing.assert_allclose, rtol=0.0)

# IOGP Report 373-7-2 (EPSG Guidance Note 7-2), examples of methods 9602 and 9837, WGS 84
LATITUDE = np.radians(53 + 48 / 60 + 33.820 / 3600)
LONGITUDE = np.radians(2 + 7 / 60 + 46.380 / 3600)
HEIGHT_M, EARTH_M = 73.0, (3_771_793.968, 140_253.342, 5_124_304.349)
ORIGIN_M = (3_652_755.3058, 319_574.6799, 5_201_547.3536)  # 55 deg north, 5 deg east, 200 m
EAST_NORTH_UP_M = (-189_013.869, -128_642.040, -4_220.171)


@pytest.mark.validates(
    "place of the simulated EGI on WGS 84, Earth-centred",
    against="worked example of IOGP Report 373-7-2 (EPSG Guidance Note 7-2), method 9602",
)
def test_published_example_of_earth_centred_coordinates(record_property):
    found = to_earth(np.array(LATITUDE), np.array(LONGITUDE), np.array(HEIGHT_M))
    record_property("obtained", f"within {1e3 * np.abs(found - EARTH_M).max():.1f} mm, printed to 1 mm")
    close(found, EARTH_M, atol=6e-4)
    latitude, longitude, height_m = to_geodetic(np.array(EARTH_M))
    close([latitude, longitude], [LATITUDE, LONGITUDE], atol=1e-10)
    assert height_m == pytest.approx(HEIGHT_M, abs=6e-4)


@pytest.mark.validates(
    "tangent plane of the simulated flight",
    against="worked example of IOGP Report 373-7-2 (EPSG Guidance Note 7-2), method 9837",
)
def test_published_example_of_a_tangent_plane(record_property):
    axes = level_axes(np.radians(55.0), np.radians(5.0))
    north, east, down = (np.array(EARTH_M) - ORIGIN_M) @ axes
    close((east, north, -down), EAST_NORTH_UP_M, atol=1.5e-3)
    off_m = np.abs(np.array([east, north, -down]) - EAST_NORTH_UP_M).max()
    record_property("obtained", f"within {1e3 * off_m:.1f} mm, printed to 1 mm")


def by_iteration(earth_m):
    """Latitude, longitude, height as anybody first tries: latitude until it stays (Bowring's is another way)."""
    a, f = 6_378_137.0, 1.0 / 298.257223563
    e2, level_m = f * (2.0 - f), np.hypot(earth_m[0], earth_m[1])
    latitude = np.arctan2(earth_m[2], level_m * (1.0 - e2))
    for _ in range(60):
        across_m = a / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(earth_m[2] + e2 * across_m * np.sin(latitude), level_m)
    root = np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height_m = level_m * np.cos(latitude) + earth_m[2] * np.sin(latitude) - a * root
    return latitude, np.arctan2(earth_m[1], earth_m[0]), height_m


def test_the_way_back_agrees_with_iteration_everywhere():
    draw = np.random.default_rng(7)
    for _ in range(200):
        place = draw.uniform(-1.55, 1.55), draw.uniform(-3.14, 3.14), draw.uniform(-5e3, 5e4)
        earth_m = to_earth(*(np.array(one) for one in place))
        found = [float(one) for one in to_geodetic(earth_m)]
        close(found[:2], place[:2], atol=2e-15)
        close(found[:2], by_iteration(earth_m)[:2], atol=1e-15)
        close(found[2], [place[2]], atol=1e-8)
        close(found[2], by_iteration(earth_m)[2], atol=1e-8)


def test_axes_and_angles_are_those_of_a_second_method():
    place, step = np.array([0.65, 2.2, 3000.0]), np.array([1e-6, 1e-6, 1.0])
    axes = level_axes(place[0], place[1])
    for column, coordinate in enumerate((0, 1)):
        ahead, behind = place.copy(), place.copy()
        ahead[coordinate] += step[coordinate]
        behind[coordinate] -= step[coordinate]
        grown = to_earth(*ahead) - to_earth(*behind)
        close(grown / np.linalg.norm(grown), axes[:, column], atol=1e-9)
    close(to_earth(*place) - to_earth(place[0], place[1], place[2] + 1.0), axes[:, 2], atol=1e-8)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    angles = np.random.default_rng(3).uniform([-3.0, -1.5, 0.0], [3.0, 1.5, 6.28], (50, 3))
    turn = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    close(euler_rad(turn), angles, atol=1e-12)


def test_the_analysis_finds_the_tangent_plane_again():
    """Its own conversion, written apart: positions, velocities and attitudes of a flight of 100 km."""
    draw = np.random.default_rng(11)
    p = draw.uniform(-1e5, 1e5, (200, 3)) * [1.0, 1.0, 0.1]
    v, turn = draw.normal(0.0, 100.0, (200, 3)), Rotation.random(200, random_state=2).as_matrix()
    told = TangentPlane(37.5, 127.0).told(p, v, turn)
    frame = TangentFrame(37.5, 127.0)
    close(frame.positions_m(told.latitude_deg, told.longitude_deg, told.height_m), p, atol=1e-8)
    back = frame.from_level(told.latitude_deg, told.longitude_deg)
    close(np.einsum("nij,nj->ni", back, told.velocity_m_s), v, atol=1e-10)
    close(back @ body_to_level(*told.attitude_deg.T), turn, atol=1e-11)


def test_one_second_of_flight_is_what_the_radii_of_curvature_say():
    """100 m north and 100 m east at 3 km: published radii at 37.5 deg are M = 6359.1 km, N = 6386.1 km (formulae)."""
    a, e2, sine = 6_378_137.0, 6.69437999014e-3, np.sin(np.radians(37.5))
    north_m, east_m = a * (1 - e2) / (1 - e2 * sine**2) ** 1.5, a / np.sqrt(1 - e2 * sine**2)
    p = np.array([[0.0, 0.0, -3000.0], [100.0, 0.0, -3000.0], [0.0, 100.0, -3000.0]])
    told = TangentPlane(37.5, 127.0).told(p, np.zeros((3, 3)), np.broadcast_to(np.eye(3), (3, 3, 3)))
    grown = np.radians(told.latitude_deg[1] - told.latitude_deg[0]) * (north_m + 3000.0)
    assert grown == pytest.approx(100.0, abs=2e-5)
    grown = np.radians(told.longitude_deg[2] - 127.0) * (east_m + 3000.0) * np.cos(np.radians(37.5))
    assert grown == pytest.approx(100.0, abs=2e-5)
    assert told.height_m[0] == pytest.approx(3000.0, abs=1e-8)
