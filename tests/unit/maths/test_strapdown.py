"""Strapdown integration against motions in closed form; geodesy against published worked examples."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.maths.geodesy import FLATTENING, SEMI_MAJOR_m, TangentFrame, body_to_level, geocentric_m, level_axes
from bench.maths.strapdown import Track, earth_rate, gradient, navigate, normal_gravity, small_rotation
from sim_instruments.worlds.time_sync.flight.imu import exact_increments
from sim_instruments.worlds.time_sync.flight.path import manoeuvre

Array = NDArray[np.float64]

LATITUDE_DEG = 37.5
RATE_HZ = 200.0


@pytest.mark.validates(
    "normal gravity and its gradient in the strapdown",
    against="published values at equator and pole, free-air gradient, Laplace's equation",
)
def test_gravity_is_the_published_one_of_wgs_84() -> None:
    assert normal_gravity(0.0) == pytest.approx(9.7803253359, abs=1e-10)  # NIMA TR8350.2, equator and pole
    assert normal_gravity(90.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert normal_gravity(-90.0) == normal_gravity(90.0)
    # free air: 0.3086 mGal per metre of height; down is positive, so gravity grows with the down coordinate
    assert gradient(45.0)[2] == pytest.approx(3.086e-6, rel=0.005)
    assert gradient(45.0).sum() == pytest.approx(0.0, abs=1e-20)  # Laplace
    assert np.linalg.norm(earth_rate(31.0)) == pytest.approx(7.292115e-5)
    assert earth_rate(31.0)[2] < 0.0  # north of the equator the vertical component points up


def test_series_of_a_small_rotation_is_rodrigues_formula() -> None:
    vector = np.array([0.03, -0.07, 0.06])
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    expected = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    assert small_rotation(vector[:, None])[..., 0] == pytest.approx(expected, abs=1e-14)


def test_rotation_within_an_interval_bends_the_increment_as_the_closed_form_says() -> None:
    """Steady rate and force in the body, over an interval so short that neither the Earth nor gravity does anything."""
    vector, dv = np.array([0.03, -0.07, 0.06]), np.array([4.0, -9.0, 5.0])
    begin = small_rotation(np.array([0.05, 0.02, -0.08])[:, None])[..., 0]
    angle = np.linalg.norm(vector)
    x, y, z = vector
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    bent = dv + (1.0 - np.cos(angle)) / angle**2 * K @ dv + (angle - np.sin(angle)) / angle**3 * K @ K @ dv
    t_s = np.array([1e-9, 2e-9])
    track = navigate(t_s, np.tile(dv, (2, 1)), np.tile(vector, (2, 1)), np.zeros(3), np.zeros(3), begin, LATITUDE_DEG)
    turn = small_rotation(vector[:, None])[..., 0]
    assert track.v[0] == pytest.approx(begin @ bent, abs=3e-4)  # of the fourth power of the angle, 0.1 rad
    assert track.v[1] - track.v[0] == pytest.approx(begin @ turn @ bent, abs=3e-4)
    assert track.C[1] == pytest.approx(begin @ turn @ turn, abs=1e-12)


def test_free_of_noise_the_flight_comes_back_within_a_millimetre() -> None:
    t_s = np.arange(60 * int(RATE_HZ) + 1) / RATE_HZ
    paths = [manoeuvre("turn"), manoeuvre("acceleration"), manoeuvre("stationary")]
    increments = [exact_increments(path, t_s) for path in paths]
    dv, dtheta = (np.stack([lane[k] for lane in increments], axis=1) for k in (0, 1))
    begin = [path.state(t_s[:1]) for path in paths]
    p0, v0 = np.concatenate([s.p for s in begin]), np.concatenate([s.v for s in begin])
    track = navigate(t_s[1:], dv, dtheta, p0, v0, np.eye(3), LATITUDE_DEG)
    for lane, path in enumerate(paths):
        true = path.state(t_s[1:])
        yaw = np.arctan2(track.C[:, lane, 1, 0], track.C[:, lane, 0, 0])
        assert np.abs(track.p[:, lane] - true.p).max() < 1e-3
        assert np.abs(track.v[:, lane] - true.v).max() < 5e-5
        assert np.abs(np.rad2deg(yaw - true.yaw)).max() < 5e-5
        assert np.abs(np.rad2deg(track.C[:, lane, 2, :2])).max() < 5e-5  # level


def quadrature(of: Callable[[Array], Array], ends_s: Array) -> Array:
    """Integrals of a function of time, (n, 3) for times (n,), over intervals of 1/RATE_HZ that end there."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    half = 0.5 / RATE_HZ
    return sum((half * w * of(ends_s - half + half * x) for x, w in zip(nodes, weights, strict=True)), np.zeros(3))


CONE_RAD, CONE_HZ = np.deg2rad(1.0), 5.0


def coning_attitude(t_s: Array) -> Array:
    """Classical coning: a rotation vector of constant length whose direction goes round, (n, 3, 3)."""
    turn = 2.0 * np.pi * CONE_HZ * t_s
    vector = CONE_RAD * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    return np.moveaxis(small_rotation(vector), -1, 0)


def coning_angle(t_s: Array) -> Array:
    """Integral of the rate in the body that belongs to it, in closed form (Bortz 1971), (n, 3)."""
    pulse = 2.0 * np.pi * CONE_HZ
    sine = np.sin(CONE_RAD)
    down = -2.0 * np.sin(0.5 * CONE_RAD) ** 2 * pulse * t_s
    return np.stack([sine * np.cos(pulse * t_s), sine * np.sin(pulse * t_s), down], axis=-1)


def coning_track(seconds: int) -> tuple[Track, Array]:
    """Navigate an IMU that cones where it stands; returns the track and the true attitude at its times."""
    t_s = np.arange(1, seconds * int(RATE_HZ) + 1) / RATE_HZ
    earth, gravity = earth_rate(LATITUDE_DEG), np.array([0.0, 0.0, normal_gravity(LATITUDE_DEG)])
    dtheta = coning_angle(t_s) - coning_angle(t_s - 1.0 / RATE_HZ)
    dtheta += quadrature(lambda t: np.einsum("nij,i->nj", coning_attitude(t), earth), t_s)
    dv = quadrature(lambda t: np.einsum("nij,i->nj", coning_attitude(t), -gravity), t_s)
    first = coning_attitude(np.zeros(1))[0]
    return navigate(t_s, dv, dtheta, np.zeros(3), np.zeros(3), first, LATITUDE_DEG), coning_attitude(t_s)


def down_angle(track: Track, true: Array) -> float:
    """Rotation about the vertical between solution and truth at the end, rad."""
    rest = track.C[-1] @ true[-1].T
    return float(0.5 * (rest[1, 0] - rest[0, 1]))


@pytest.mark.validates(
    "coning correction of the strapdown, 1 deg at 5 Hz",
    against="drift of plain sums of increments in closed form (Savage 1998): 18 deg/h, at most 1 % of it left",
)
def test_coning_does_not_turn_the_platform() -> None:
    seconds = 10
    pulse, interval = 2.0 * np.pi * CONE_HZ, 1.0 / RATE_HZ
    # drift of plain sums of increments, in closed form (Savage 1998, part 1): 18 deg/h here
    plain = pulse * (1.0 - np.cos(CONE_RAD)) * (1.0 - np.sin(pulse * interval) / (pulse * interval)) * seconds
    track, true = coning_track(seconds)
    assert abs(down_angle(track, true)) < 0.01 * plain
    assert np.abs(track.v).max() < 1e-3


def test_sculling_does_not_push_the_vehicle() -> None:
    """Rocking about x in step with a force along y: the path is chosen, the increments follow from it."""
    rock_rad, shake_m_s2, pulse = np.deg2rad(1.0), 5.0, 2.0 * np.pi * 10.0
    earth, gravity = earth_rate(LATITUDE_DEG), np.array([0.0, 0.0, normal_gravity(LATITUDE_DEG)])
    seconds = 5
    t_s = np.arange(1, seconds * int(RATE_HZ) + 1) / RATE_HZ

    def attitude(t: Array) -> Array:
        angle = rock_rad * np.sin(pulse * t)
        return np.moveaxis(small_rotation(np.stack([angle, 0.0 * t, 0.0 * t])), -1, 0)

    def rate(t: Array) -> Array:
        own = np.stack([rock_rad * pulse * np.cos(pulse * t), 0.0 * t, 0.0 * t], axis=-1)
        return np.asarray(own + np.einsum("nij,i->nj", attitude(t), earth))

    def force(t: Array) -> Array:
        east = np.array([0.0, 1.0, 0.0])
        v = -shake_m_s2 / pulse * np.cos(pulse * t)[:, None] * east
        a = shake_m_s2 * np.sin(pulse * t)[:, None] * east
        p = -shake_m_s2 / pulse**2 * np.sin(pulse * t)[:, None] * east
        total = a - gravity - gradient(LATITUDE_DEG) * p + 2.0 * np.cross(earth, v)
        return np.einsum("nij,ni->nj", attitude(t), total)

    v0 = np.array([0.0, -shake_m_s2 / pulse, 0.0])
    track = navigate(
        t_s, quadrature(force, t_s), quadrature(rate, t_s), np.zeros(3), v0, attitude(np.zeros(1))[0], LATITUDE_DEG
    )
    # 10 ug; rectified by a quarter interval of lag it would be some 1000 ug
    assert np.linalg.norm(track.v[-1] - v0) / seconds < 1e-4


def test_a_lane_gives_the_same_bits_in_any_company() -> None:
    rng = np.random.default_rng(4)
    t_s = np.arange(1, 301) / RATE_HZ
    dv, dtheta = rng.normal(size=(300, 7, 3)) * 0.05, rng.normal(size=(300, 7, 3)) * 0.01
    together = navigate(t_s, dv, dtheta, np.zeros(3), np.ones(3), np.eye(3), LATITUDE_DEG)
    alone = navigate(t_s, dv[:, 4], dtheta[:, 4], np.zeros(3), np.ones(3), np.eye(3), LATITUDE_DEG)
    assert np.array_equal(together.p[:, 4], alone.p)
    assert np.array_equal(together.C[:, 4], alone.C)


def test_begin_of_the_first_interval_can_be_stated() -> None:
    t_s = np.array([0.007, 0.012, 0.017])
    still = navigate(t_s, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.ones(3), np.eye(3), LATITUDE_DEG)
    longer = navigate(t_s, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.ones(3), np.eye(3), LATITUDE_DEG, 0.0)
    assert (longer.p - still.p)[-1, :2] == pytest.approx([0.002, 0.002], rel=1e-4)


# EPSG Guidance Note 7-2, sections 4.1.1 to 4.1.3: one point on WGS 84, in every form
PLACE_DEG = 53.0 + 48.0 / 60.0 + 33.820 / 3600.0
PLACE_EAST_DEG = 2.0 + 7.0 / 60.0 + 46.380 / 3600.0
HEIGHT_m = 73.0
GEOCENTRIC_m = [3_771_793.968, 140_253.342, 5_124_304.349]
ORIGIN_DEG, ORIGIN_HEIGHT_m = (55.0, 5.0), 200.0
EAST_NORTH_UP_m = [-189_013.869, -128_642.040, -4_220.171]


def one(*values: float) -> list[np.ndarray]:
    return [np.array([value]) for value in values]


@pytest.mark.validates(
    "Earth-centred coordinates of the analysis",
    against="worked example of IOGP Report 373-7-2 (EPSG Guidance Note 7-2), method 9602",
)
def test_geocentric_coordinates_of_the_worked_example(record_property: Callable[[str, object], None]) -> None:
    found = geocentric_m(*one(PLACE_DEG, PLACE_EAST_DEG, HEIGHT_m))
    record_property("obtained", f"within {1e3 * np.abs(found[0] - GEOCENTRIC_m).max():.1f} mm, printed to 1 mm")
    assert found[0] == pytest.approx(GEOCENTRIC_m, abs=1e-3)


@pytest.mark.validates(
    "tangent plane of the analysis",
    against="worked example of IOGP Report 373-7-2 (EPSG Guidance Note 7-2), method 9837",
)
def test_tangent_positions_of_the_worked_example() -> None:
    # the example's origin stands 200 m above the ellipsoid, ours on it: 200 m further down
    north, east, down = TangentFrame(*ORIGIN_DEG).positions_m(*one(PLACE_DEG, PLACE_EAST_DEG, HEIGHT_m))[0]
    assert [east, north, -(down + ORIGIN_HEIGHT_m)] == pytest.approx(EAST_NORTH_UP_m, abs=1.5e-3)


def second_geodetic(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Bowring's way back (Survey Review 23, 1976), which knows nothing of the way there."""
    b_m = SEMI_MAJOR_m * (1.0 - FLATTENING)
    e2, second = FLATTENING * (2.0 - FLATTENING), (SEMI_MAJOR_m**2 - b_m**2) / b_m**2
    out_m = np.hypot(x_m, y_m)
    reduced = np.arctan2(z_m * SEMI_MAJOR_m, out_m * b_m)
    for _ in range(3):
        latitude = np.arctan2(
            z_m + second * b_m * np.sin(reduced) ** 3, out_m - e2 * SEMI_MAJOR_m * np.cos(reduced) ** 3
        )
        reduced = np.arctan2((1.0 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    normal_m = SEMI_MAJOR_m / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height_m = out_m * np.cos(latitude) + z_m * np.sin(latitude) - SEMI_MAJOR_m**2 / normal_m
    return float(np.degrees(latitude)), float(np.degrees(np.arctan2(y_m, x_m))), float(height_m)


@pytest.mark.parametrize(
    "place", [(37.5, 127.0, 3000.0), (-33.9, -70.1, 12_000.0), (0.0, 179.9, 0.0), (71.0, 8.0, 5e4)]
)
def test_second_method_finds_the_way_back(place: tuple[float, float, float]) -> None:
    back = second_geodetic(*geocentric_m(*one(*place))[0])
    assert back[:2] == pytest.approx(place[:2], abs=1e-12)
    assert back[2] == pytest.approx(place[2], abs=1e-8)


def test_level_frame_is_the_gradient_of_the_position() -> None:
    """North, east and down are where the position goes when latitude, longitude and height change."""
    place, step = (37.5, 127.0, 3000.0), 1e-5
    axes = level_axes(*one(*place[:2]))[0]
    for row, (index, sense) in enumerate(((0, 1.0), (1, 1.0), (2, -1.0))):
        high, low = list(place), list(place)
        high[index] += step
        low[index] -= step
        along = sense * (geocentric_m(*one(*high))[0] - geocentric_m(*one(*low))[0])
        assert axes[row] == pytest.approx(along / np.linalg.norm(along), abs=2e-8 if index < 2 else 1e-4)


def test_level_frame_ahead_is_turned_by_the_way_on_the_ellipsoid() -> None:
    """A kilometre north the level frame has pitched by the way over the meridian's radius of curvature."""
    tangent = TangentFrame(37.5, 127.0)
    north_m = tangent.positions_m(*one(37.51, 127.0, 0.0))[0, 0]
    turned = tangent.from_level(*one(37.51, 127.0))[0]
    assert np.degrees(Rotation.from_matrix(turned).as_rotvec()) == pytest.approx([0.0, -0.01, 0.0], abs=1e-12)
    assert north_m / np.radians(0.01) == pytest.approx(6_359_100.0, rel=2e-4)  # radius of the meridian at 37.5 deg


def test_attitude_by_another_program() -> None:
    rng = np.random.default_rng(8)
    angles = rng.uniform([-180.0, -89.0, 0.0], [180.0, 89.0, 360.0], (50, 3))
    expected = Rotation.from_euler("ZYX", angles[:, ::-1], degrees=True).as_matrix()
    assert body_to_level(*angles.T) == pytest.approx(expected, abs=1e-12)
    assert body_to_level(*one(0.0, 0.0, 90.0))[0] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
