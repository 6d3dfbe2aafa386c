"""Paths, increments and places of the simulated vehicle against quadrature, an integrator and published figures."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import allantools
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import spherical_jn

from sim_instruments.worlds.time_sync.flight.imu import ImuClass, ImuErrors, exact_increments, imu_runs
from sim_instruments.worlds.time_sync.flight.path import (
    MANOEUVRES,
    FlightPath,
    _bessel,
    gravity_m_s2,
    manoeuvre,
    normal_gravity_m_s2,
)
from sim_instruments.worlds.time_sync.samples import euler_rad, level_axes, to_earth, to_geodetic

Array = np.ndarray

_LATITUDE = np.radians(37.5)
_EARTH = 7.292115e-5 * np.array([np.cos(_LATITUDE), 0.0, -np.sin(_LATITUDE)])


def _cross(vector: Array) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _felt(path: FlightPath, first_s: float, last_s: float) -> Callable[[float], tuple[Array, Array]]:
    """Specific force and rate at a time inside one piece, from increments of 1 ms about it."""

    def at(t_s: float) -> tuple[Array, Array]:
        middle = min(max(t_s, first_s + 5e-4), last_s - 5e-4)
        dv, dtheta = exact_increments(path, np.array([middle - 5e-4, middle + 5e-4]))
        return dv[0] / 1e-3, dtheta[0] / 1e-3

    return at


def _navigated(path: FlightPath, borders_s: list[float]) -> Array:
    """Position, velocity and C from the continuous mechanisation equation, piece by piece, by DOP853."""
    start = path.state(np.array(borders_s[:1]))
    turn = Rotation.from_euler("z", start.yaw[0]).as_matrix()
    flat = np.concatenate((start.p[0], start.v[0], turn.ravel()))
    gravity = normal_gravity_m_s2(37.5)
    for first, last in pairwise(borders_s):
        felt = _felt(path, first, last)

        def rates(t_s: float, y: Array, felt: Callable[[float], tuple[Array, Array]] = felt) -> Array:
            force, rate = felt(t_s)
            p, v, c = y[:3], y[3:6], y[6:].reshape(3, 3)
            pull = gravity * (np.array([0.0, 0.0, 1.0]) + np.array([-p[0], -p[1], 2.0 * p[2]]) / 6.371e6)
            return np.concatenate(
                (v, c @ force + pull - 2.0 * np.cross(_EARTH, v), (c @ _cross(rate) - _cross(_EARTH) @ c).ravel())
            )

        flat = solve_ivp(rates, (first, last), flat, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return flat


@pytest.mark.validates(
    "increments of the simulated inertial unit over 70 s of flight",
    against="the mechanisation equation integrated by scipy's DOP853, tolerance 1e-12",
)
@pytest.mark.parametrize("name", list(MANOEUVRES))
def test_mechanisation_returns_the_path(name: str, record_property: Callable[[str, object], None]) -> None:
    path = manoeuvre(name)
    borders = [0.0, *path.borders_s(0.0, 70.0), 70.0]
    found, true = _navigated(path, borders), path.state(np.array([70.0]))
    record_property("obtained", f"{name}: {1e3 * np.abs(found[:3] - true.p[0]).max():.1g} mm, limit 0.2")
    assert found[:3] == pytest.approx(true.p[0], abs=2e-4)
    assert found[3:6] == pytest.approx(true.v[0], abs=1e-5)
    turn = found[6:].reshape(3, 3) @ Rotation.from_euler("z", true.yaw[0]).as_matrix().T
    assert np.degrees(Rotation.from_matrix(turn).magnitude()) < 1e-7


@pytest.mark.validates(
    "specific force and rate of a vehicle that turns and speeds up",
    against="the path differenced twice in a frame that does not turn with the Earth",
)
def test_force_is_the_second_derivative_in_an_inertial_frame() -> None:
    """Nothing of the mechanisation equation: the path seen from a frame that does not turn, differenced twice."""
    path = FlightPath(((0.0, 1.0, 2.0),), 250.0, 30.0)
    h = 0.05
    t_s = 3.0 + h * np.array([-1.0, 0.0, 1.0])
    turns = [Rotation.from_rotvec(_EARTH * t).as_matrix() for t in t_s]  # seen along the plane's axes at t = 0
    state = path.state(t_s)
    inertial = np.array([turn @ p for turn, p in zip(turns, state.p, strict=True)])
    felt = turns[1].T @ (inertial[0] - 2.0 * inertial[1] + inertial[2]) / h**2
    felt -= np.cross(_EARTH, np.cross(_EARTH, state.p[1]))  # this part of it is within gravity
    felt -= gravity_m_s2(state.p[1], 37.5)
    body = Rotation.from_euler("z", state.yaw[1])
    dv, dtheta = exact_increments(path, 3.0 + np.array([-1e-4, 1e-4]))
    assert dv[0] / 2e-4 == pytest.approx(body.inv().apply(felt), abs=1e-5)
    before, after = (
        Rotation.from_rotvec(_EARTH * t) * Rotation.from_euler("z", path.state(np.array([t])).yaw[0])
        for t in (3.0 - 1e-4, 3.0 + 1e-4)
    )
    assert dtheta[0] == pytest.approx((before.inv() * after).as_rotvec(), rel=1e-7, abs=1e-15)


def test_increments_add_up_over_borders_inside_intervals() -> None:
    path = manoeuvre("sar")
    whole = exact_increments(path, np.array([19.9987, 20.0031, 49.998, 50.003, 50.0037]))
    cuts = np.array([19.9987, 20.0, 20.0031, 30.0, 49.998, 50.0, 50.003, 50.0037])
    parts = exact_increments(path, cuts)
    for one, of in zip(whole, parts, strict=True):
        assert one[0] == pytest.approx(of[0] + of[1], abs=1e-13)
        assert one[1] == pytest.approx(of[2] + of[3], abs=1e-9)
        assert one[2] == pytest.approx(of[4] + of[5], abs=1e-13)
    assert whole[1][2, 2] == pytest.approx(0.003 * np.radians(9.0), abs=1e-6)
    assert whole[0][0, 0] == pytest.approx(0.0031 * 15.0, abs=3e-5)


@pytest.mark.validates(
    "normal gravity of the simulated flights", against="published values at equator and pole, free-air gradient"
)
def test_published_gravity() -> None:
    assert normal_gravity_m_s2(0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity_m_s2(90.0) == pytest.approx(9.8321849378, abs=1e-10)
    up = gravity_m_s2(np.array([0.0, 0.0, -1000.0]), 45.0) - gravity_m_s2(np.zeros(3), 45.0)
    assert up[2] == pytest.approx(-3.086e-3, rel=3e-3)  # free-air gradient, 0.3086 mGal/m
    pulled = gravity_m_s2(np.array([1000.0, 0.0, 0.0]), 45.0)
    assert pulled[0] / pulled[2] == pytest.approx(-1000.0 / 6.371e6, rel=1e-6)  # back to the origin: to the centre


def test_noise_and_biases_have_the_stated_size() -> None:
    """Allan deviation at 1 s is the coefficient of the random walk; the mean is the bias."""
    runs = imu_runs(manoeuvre("stationary"), 200.0, 4, 11)
    quiet = exact_increments(manoeuvre("stationary"), np.concatenate(([0.0], runs.t_s)))
    for noisy, exact, walk, bias in (
        (runs.dv, quiet[0], 20e-6 * 9.80665, runs.accel_bias),
        (runs.dtheta, quiet[1], np.radians(0.07) / 60.0, runs.gyro_bias),
    ):
        error = (noisy - exact[:, None]) * 200.0
        deviation = [allantools.adev(row, 200.0, "freq", [1.0])[1][0] for row in error.reshape(-1, 12).T]
        assert np.mean(deviation) == pytest.approx(walk, rel=0.05)
        assert np.abs(error.mean(0) - bias).max() < 4.5 * walk / np.sqrt(200.0)
        flat = error.reshape(-1, 12) - error.reshape(-1, 12).mean(0)
        assert np.abs(np.corrcoef(flat.T) - np.eye(12)).max() < 5.0 / np.sqrt(flat.shape[0])
        assert np.abs(np.mean(flat[1:] * flat[:-1], 0) / flat.var(0)).max() < 5.0 / np.sqrt(flat.shape[0])
    lanes = [ImuErrors(5, run) for run in range(400)]
    accel = np.array([lane.accel_bias for lane in lanes]) / 9.80665e-6
    gyro = np.degrees([lane.gyro_bias for lane in lanes]) * 3600.0
    assert accel.std(0) == pytest.approx(200.0, rel=0.12)
    assert gyro.std(0) == pytest.approx(1.0, rel=0.12)
    assert np.abs(np.corrcoef(np.hstack((accel, gyro)).T) - np.eye(6)).max() < 0.25


def test_noise_belongs_to_the_run_and_the_number_of_the_sample() -> None:
    path = manoeuvre("turn")
    many, few = imu_runs(path, 30.0, 5, 3), imu_runs(path, 25.0, 2, 3)
    n = few.t_s.size
    assert few.t_s[-1] == 25.0
    assert np.array_equal(many.dv[:n, :2], few.dv)
    assert np.array_equal(many.dtheta[:n, :2], few.dtheta)
    assert np.array_equal(many.accel_bias[:2], few.accel_bias)
    assert np.all(many.dv.std(1) > 0.0)
    assert np.unique(many.gyro_bias).size == 15
    assert not np.array_equal(imu_runs(path, 1.0, 1, 4).dv, few.dv[:200, :1])
    lane = ImuErrors(9, 2)
    whole = lane.noise(0, 10_000)
    assert np.array_equal(ImuErrors(9, 2).noise(8100, 200), whole[8100:8300])
    assert np.array_equal(lane.noise(17, 1), whole[17:18])
    assert np.array_equal(np.concatenate([lane.noise(k, 1) for k in range(4090, 4100)]), whole[4090:4100])
    perfect = ImuClass(accel_bias_ug=0.0, velocity_walk_ug=0.0, gyro_bias_deg_h=0.0, angle_walk_deg_rt_h=0.0)
    runs = imu_runs(manoeuvre("turn"), 2.0, 1, 1, perfect)
    dv, dtheta = exact_increments(manoeuvre("turn"), np.arange(401) / 200.0)
    assert np.array_equal(runs.dv[:, 0], dv)
    assert np.array_equal(runs.dtheta[:, 0], dtheta)


# begin s, acceleration m/s2, yaw rate deg/s: from 1e-7 deg/s, where closed forms lose digits, to a spinning table
_PIECES = (
    (2.0, 0.0, 0.0),
    (5.0, 3.0, 1e-7),
    (9.0, -2.0, 0.03),
    (12.0, 1.0, -30.0),
    (17.0, 4.0, 720.0),
    (20.0, 0.0, 0.0),
)


def _grown(t_s: float, start: float, column: int) -> float:
    """What an acceleration or a yaw rate of the pieces has made of a start."""
    for piece, end in zip(_PIECES, [*[p[0] for p in _PIECES[1:]], np.inf], strict=True):
        start += piece[column] * (min(max(t_s, piece[0]), end) - piece[0])
    return start


def _heading(t_s: float) -> float:
    return np.radians(_grown(t_s, 20.0, 2))


def _speed(t_s: float) -> float:
    return _grown(t_s, 30.0, 1)


@pytest.mark.parametrize("t_s", [-3.0, 2.0, 4.9, 5.0, 8.0, 11.5, 14.0, 17.0, 17.3, 19.9, 33.0])
def test_position_is_the_integral_of_the_velocity(t_s: float) -> None:
    state = FlightPath(_PIECES, 30.0, 20.0, -1234.0).state(np.array([t_s]))
    borders = sorted({2.0, t_s, *[p[0] for p in _PIECES if 2.0 < p[0] < t_s]})
    north = east = 0.0
    for first, last in pairwise(borders):
        north += quad(lambda t: _speed(t) * np.cos(_heading(t)), first, last, epsabs=1e-11, limit=500)[0]
        east += quad(lambda t: _speed(t) * np.sin(_heading(t)), first, last, epsabs=1e-11, limit=500)[0]
    sense = -1.0 if t_s < 2.0 else 1.0
    assert state.p[0] == pytest.approx([sense * north, sense * east, -1234.0], abs=1e-9)
    speed, heading = _speed(t_s), _heading(t_s)
    assert state.v[0] == pytest.approx([speed * np.cos(heading), speed * np.sin(heading), 0.0], abs=1e-10)
    assert state.yaw[0] == pytest.approx(heading, abs=1e-12)


def test_spherical_bessel_functions_by_series_and_closed_form_are_those_of_scipy() -> None:
    x = np.concatenate((-np.geomspace(1e-9, 3.0, 60), [0.0], np.geomspace(1e-9, 3.0, 60), [0.0999, 0.1, 0.1001]))
    for found, order in zip(_bessel(x), (0, 1), strict=True):
        assert found == pytest.approx(spherical_jn(order, x), rel=1e-13, abs=1e-300)


def test_a_piece_changes_the_future_only_and_of_this_path_only() -> None:
    path = FlightPath(((0.0, 0.0, 0.0), (10.0, 5.0, 0.0), (20.0, 0.0, 9.0)), 100.0)
    past = path.state(np.linspace(-5.0, 14.99, 50))
    path.add(15.0, 0.0, -3.0)
    again = path.state(np.linspace(-5.0, 14.99, 50))
    assert np.array_equal(past.p, again.p)
    assert np.array_equal(past.v, again.v)
    assert path.state(np.array([25.0])).yaw[0] == pytest.approx(np.radians(-30.0))  # the turn of 20 s is forgotten
    assert list(path.borders_s(0.0, 100.0)) == [10.0, 15.0]
    with pytest.raises(ValueError, match="before the path"):
        path.add(-1.0, 0.0, 0.0)
    manoeuvre("linear").add(5.0, 9.0, 9.0)
    assert manoeuvre("linear").borders_s(0.0, 60.0).size == 0


def test_manoeuvres_are_those_of_the_paper() -> None:
    assert set(MANOEUVRES) == {"stationary", "linear", "acceleration", "turn", "sar"}
    at = {name: manoeuvre(name).state(np.array([-1.0, 10.0, 25.0, 55.0, 500.0])) for name in MANOEUVRES}
    assert not at["stationary"].v.any()
    assert at["linear"].p[:, 0] == pytest.approx([-100.0, 1000.0, 2500.0, 5500.0, 50000.0])
    assert at["acceleration"].v[:, 0] == pytest.approx([100.0, 100.0, 125.0, 200.0, 200.0])
    assert np.degrees(at["turn"].yaw) == pytest.approx([0.0, 0.0, 22.5, 90.0, 90.0])
    assert at["turn"].a[2, :2] == pytest.approx(  # to the right
        100.0 * np.radians(4.5) * np.array([-np.sin(np.radians(22.5)), np.cos(np.radians(22.5))])
    )
    assert np.linalg.norm(at["sar"].v, axis=1) == pytest.approx([100.0, 100.0, 175.0, 250.0, 250.0])
    assert np.degrees(at["sar"].yaw) == pytest.approx([0.0, 0.0, 0.0, 45.0, 90.0])
    assert np.linalg.norm(at["sar"].a[3]) == pytest.approx(39.27, abs=0.005)
    assert np.all(at["sar"].p[:, 2] == -3000.0)


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


def test_the_way_back_is_exact_everywhere():
    draw = np.random.default_rng(7)
    for _ in range(200):
        place = draw.uniform(-1.55, 1.55), draw.uniform(-3.14, 3.14), draw.uniform(-5e3, 5e4)
        earth_m = to_earth(*(np.array(one) for one in place))
        found = [float(one) for one in to_geodetic(earth_m)]
        close(found[:2], place[:2], atol=2e-15)
        close(found[2], [place[2]], atol=1e-8)


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
