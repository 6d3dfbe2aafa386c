"""The body's rate and specific force against scipy's rotations and against closed forms."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from gnc_sensor_bench import (
    IDEAL,
    MOUNTINGS,
    Formula,
    Table,
    at,
    body_to_local,
    module,
    posed,
    times_ns,
    trapezoid,
    turning,
)
from scipy.spatial.transform import Rotation

from bench.model.clock import NS
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.gnc.imu import ImuOptions
from sim_instruments.worlds.gnc.imu_errors import ImuErrors

EARTH_DEG_S = 360.0 / 86_164.0905  # by the length of the sidereal day
SITE = Site(latitude_deg=34.2, gravity_m_s2=9.7969, azimuth_deg=71.0)
ONE = np.array([NS], np.int64)


def still(
    outer: float, middle: float, inner: float, mounting: str = "x", site: Site = SITE
) -> tuple[np.ndarray, np.ndarray]:
    read = module(posed(outer, middle, inner, mounting), site=site).readings(ONE)
    return read.gyro_deg_s[0], read.accel_g[0]


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_earth_and_gravity_in_a_hundred_poses(mounting: str) -> None:
    rng = np.random.default_rng(1)
    latitude = np.deg2rad(SITE.latitude_deg)
    earth = EARTH_DEG_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    for outer, middle, inner in rng.uniform(-720.0, 720.0, (100, 3)):
        attitude = body_to_local(posed(outer, middle, inner, mounting), ONE, SITE)[0]
        rate, force = still(outer, middle, inner, mounting)
        assert rate == pytest.approx(attitude.inv().apply(earth), rel=0, abs=2e-9)
        assert force == pytest.approx(attitude.inv().apply([0, 0, 9.7969 / 9.80665]), rel=0, abs=1e-13)


def test_closed_forms() -> None:
    rate, force = still(0, 0, 0, site=Site(90.0, 9.80665, 0.0))  # at the pole, level
    assert rate == pytest.approx([0, 0, EARTH_DEG_S], rel=1e-6, abs=1e-17)
    assert force == pytest.approx([0, 0, 1], abs=1e-16)
    rate, _ = still(0, 0, 0, site=Site(0.0, 9.78, 0.0))  # at the equator, inner axis to the north
    assert rate == pytest.approx([EARTH_DEG_S, 0, 0], rel=1e-6, abs=1e-17)
    rate, _ = still(0, 0, 0, site=Site(0.0, 9.78, 90.0))  # inner axis to the east, table y to the north
    assert rate == pytest.approx([0, EARTH_DEG_S, 0], rel=1e-6, abs=1e-17)
    _, force = still(33.0, -90.0, 0)  # x up
    assert force == pytest.approx([9.7969 / 9.80665, 0, 0], abs=1e-15)
    _, force = still(33.0, 0, 90.0)  # y up
    assert force == pytest.approx([0, 9.7969 / 9.80665, 0], abs=1e-15)


@pytest.mark.parametrize(("mounting", "axis"), [("x", 0), ("y", 1), ("z", 2)])
def test_the_earth_axis_mount(mounting: str, axis: int) -> None:
    """Outer so that the inner axis points north, middle = -latitude: all of Earth's rate on the inner axis, always."""
    for inner in (0.0, 33.0, 190.0):
        rate, _ = still(SITE.azimuth_deg, -SITE.latitude_deg, inner, mounting)
        assert rate == pytest.approx(EARTH_DEG_S * np.eye(3)[axis], rel=1e-6, abs=1e-16)


def wild(mounting: str) -> Table:
    outer = Formula(lambda t_s: 40.0 * t_s + 25.0 * np.sin(2.1 * t_s))
    middle = Formula(lambda t_s: 60.0 * np.sin(1.3 * t_s + 0.4))
    return Table((outer, middle, Formula(lambda t_s: -120.0 * t_s + 80.0 * np.cos(1.7 * t_s))), mounting)


def mean_rate_deg_s(attitude: Callable[[np.ndarray], Rotation], stamps: np.ndarray) -> np.ndarray:
    """Mean body rate over each sample from the attitudes at fifty steps of 0.1 ms."""
    steps = [attitude(stamps - 5_000_000 + 100_000 * step) for step in range(51)]
    turns = [(one.inv() * other).as_rotvec() for one, other in itertools.pairwise(steps)]
    return np.rad2deg(np.sum(turns, axis=0)) / 0.005


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_all_axes_moving(mounting: str) -> None:
    """The rate against the difference of scipy's attitudes over each sample; Earth does not turn here."""
    table, stamps = wild(mounting), times_ns(4.0, first_s=1.0)
    read = module(table, site=Site(latitude_deg=90.0, azimuth_deg=20.0)).readings(stamps)
    expected = mean_rate_deg_s(lambda t_ns: body_to_local(table, t_ns, Site(azimuth_deg=20.0)), stamps)
    middle = body_to_local(table, stamps - 2_500_000, Site(azimuth_deg=20.0))
    earth = middle.inv().apply([0, 0, EARTH_DEG_S])
    assert np.abs(read.gyro_deg_s - earth - expected).max() < 3e-6
    assert np.abs(read.gyro_deg_s).max() > 200.0
    assert np.abs(read.accel_g - middle.inv().apply([0, 0, 9.7969 / 9.80665])).max() < 4e-5  # mean against middle


def test_tilt_turns_the_body_with_its_rate() -> None:
    """A tilt of 1 arcmin that wobbles with the angles, as a rotation vector handed to scipy."""
    options = ImuOptions(errors=False, noise=False, tilt_arcmin=1.0)
    table, stamps = wild("x"), times_ns(4.0, first_s=1.0)
    unit = module(table, options, site=Site(azimuth_deg=20.0))
    tilt = unit.errors.tilt("x")
    assert tilt is not None

    def attitude(t_ns: np.ndarray) -> Rotation:
        angles = np.stack([axis.angle_deg(t_ns) for axis in table.motion], axis=1)
        return body_to_local(table, t_ns, Site(azimuth_deg=20.0)) * Rotation.from_rotvec(tilt.rad(angles))

    latitude = np.deg2rad(34.2)
    earth = attitude(stamps - 2_500_000).inv().apply(EARTH_DEG_S * np.array([0, np.cos(latitude), np.sin(latitude)]))
    expected = mean_rate_deg_s(attitude, stamps)
    read = unit.readings(stamps)
    assert np.abs(read.gyro_deg_s - earth - expected).max() < 1e-4  # the tilt is kept to its first order
    assert (
        np.abs(module(table, site=Site(azimuth_deg=20.0)).readings(stamps).gyro_deg_s - earth - expected).max() > 0.03
    )


def test_size_of_the_tilt() -> None:
    """1 arcmin RMS about each axis over mountings and poses."""
    poses = np.random.default_rng(2).uniform(-180, 180, (50, 3))
    options = ImuOptions(tilt_arcmin=1.0)
    tilts = [ImuErrors(5, f"GNC-{unit}", options).tilt("xyz"[unit % 3]).rad(poses) for unit in range(300)]
    rms_arcmin = np.rad2deg(np.sqrt(np.mean(np.square(tilts), axis=(0, 1)))) * 60
    assert rms_arcmin == pytest.approx([1, 1, 1], rel=0.08)
    assert ImuErrors(5, "GNC-1", ImuOptions()).tilt("x") is None


@pytest.mark.parametrize("turn_deg", [1080.0, -1080.0])
@pytest.mark.parametrize("start_s", [1.0, 1.00237])
def test_the_sum_of_the_samples_is_the_turn(turn_deg: float, start_s: float) -> None:
    """Corners of the trapezoid between samples cost nothing: a sample is the mean over its interval.

    The inner axis points east, where Earth's rate has no component.
    """
    table = Table((at(0), at(0), trapezoid(start_s, turn_deg, 270.0, 270.0)))
    read = module(table, IDEAL).readings(times_ns(15.3))
    assert read.gyro_deg_s[:, 0].sum() * 0.005 == pytest.approx(turn_deg, rel=1e-9)
    slow = module(table, IDEAL).readings(times_ns(15.3, rate_hz=10.0), 100_000_000)
    assert slow.gyro_deg_s[:, 0].sum() * 0.1 == pytest.approx(turn_deg, rel=1e-9)


def test_a_long_interval_is_no_coarser_inside() -> None:
    """Samples of 100 ms are the means of twenty of 5 ms, all axes moving."""
    table = wild("y")
    fine = module(table).readings(times_ns(3.0))
    coarse = module(table).readings(times_ns(3.0, rate_hz=10.0), 100_000_000)
    assert coarse.gyro_deg_s == pytest.approx(fine.gyro_deg_s.reshape(30, 20, 3).mean(axis=1), abs=1e-9)
    assert coarse.accel_g == pytest.approx(fine.accel_g.reshape(30, 20, 3).mean(axis=1), abs=1e-12)


def test_lever_arm() -> None:
    """10 mm beside the axis at 300 deg/s: omega squared r inward; a change of rate pushes along the circle."""
    options = ImuOptions(errors=False, noise=False, lever_arm_m=(0.5, 0.01, 0.0))
    stamps = times_ns(1.0)
    spinning = Table((at(0), at(0), turning(300.0)))
    extra = module(spinning, options).readings(stamps).accel_g - module(spinning).readings(stamps).accel_g
    assert extra == pytest.approx(
        np.tile([0, -(np.deg2rad(300) ** 2) * 0.01 / 9.80665, 0], (200, 1)), rel=1e-6, abs=1e-9
    )
    speeding = Table((at(0), at(0), Formula(lambda t_s: 50.0 * t_s**2)))
    extra = module(speeding, options).readings(stamps).accel_g - module(speeding).readings(stamps).accel_g
    assert extra[:, 2] == pytest.approx(np.full(200, np.deg2rad(100) * 0.01 / 9.80665), rel=1e-4)
