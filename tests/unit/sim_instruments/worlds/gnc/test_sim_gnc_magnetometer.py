"""The simulated magnetometer and the fields it is in."""

import numpy as np
import pytest
from gnc_sensor_bench import IDEAL, QUIET, Table, at, body_to_local, module, posed, times_ns, turning

from bench.model.clock import NS
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.gnc.imu import ImuOptions
from sim_instruments.worlds.gnc.magnetometer import EarthField, Magnetometer

ONE = np.array([NS], np.int64)
TURN = Table((at(90.0), at(0), turning(0.05)), "z")  # z north, a turn in 7,200 s: 0.01 deg for each of 36,000 samples
ONCE = np.arange(720_000, dtype=np.int64)[::20] * (NS // 100)


def test_the_field_of_the_earth() -> None:
    """0.43 gauss, 55 degrees below the horizon, 4 degrees west of north."""
    east, north, up = EarthField().local_gauss
    assert np.hypot(np.hypot(east, north), up) == pytest.approx(0.43, rel=1e-12)
    assert np.rad2deg(np.arctan2(-up, np.hypot(east, north))) == pytest.approx(55.0)
    assert np.rad2deg(np.arctan2(east, north)) == pytest.approx(-4.0)


@pytest.mark.parametrize("mounting", ["x", "y", "z"])
def test_an_ideal_sensor_shows_it_in_body_axes(mounting: str) -> None:
    for outer, middle, inner in np.random.default_rng(3).uniform(-180, 180, (30, 3)):
        table = posed(outer, middle, inner, mounting)
        expected = body_to_local(table, ONE, Site())[0].inv().apply(EarthField().local_gauss)
        assert module(table, IDEAL).readings(ONE).mag_gauss[0] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("serial", ["GNC-01", "GNC-02", "GNC-03"])
def test_what_a_turn_about_z_shows(serial: str) -> None:
    """Centre, ratio of the sizes, x at the largest y, and the roll after correction, of 36,000 points of the turn."""
    unit = module(TURN, QUIET, serial)
    seen, true = unit.readings(ONCE).mag_gauss, module(TURN, IDEAL).readings(ONCE).mag_gauss
    plane = unit.magnetometer.in_plane(np.hypot(true[0, 0], true[0, 1]), true[:, 2].mean())
    high, low = seen.max(axis=0), seen.min(axis=0)
    assert (high + low)[:2] / 2 == pytest.approx(plane.offset_gauss, abs=1e-8)
    assert (high - low)[0] / (high - low)[1] == pytest.approx(plane.gain, rel=1e-7)
    x, y = seen[:, 0] - plane.offset_gauss[0], (seen[:, 1] - plane.offset_gauss[1]) * plane.gain
    sin_alpha = x[np.argmax(y)] / y.max()
    assert np.rad2deg(np.arcsin(sin_alpha)) == pytest.approx(plane.angle_deg, abs=0.01)  # a step of the turn
    sin_alpha = np.sin(np.deg2rad(plane.angle_deg))
    corrected = (x - y * sin_alpha) / np.cos(np.deg2rad(plane.angle_deg)) + 1j * y
    assert np.abs(corrected) == pytest.approx(np.full(ONCE.size, plane.radius_gauss), rel=1e-12)  # a circle
    shift_deg = np.rad2deg(np.angle((true[:, 0] + 1j * true[:, 1]) / corrected))  # roll is minus the angle of x, y
    assert shift_deg == pytest.approx(np.full(ONCE.size, plane.roll_deg), abs=1e-9)


def test_draws_of_many_units() -> None:
    """Gains of 3 %, 1 to 2 degrees between the axes, 0.1 gauss of offset; soft iron turns the roll by tenths."""
    planes = [Magnetometer(2, f"GNC-{number}").in_plane(0.35, 0.2) for number in range(400)]
    assert np.std([plane.gain for plane in planes]) == pytest.approx(0.042, rel=0.12)
    angles = np.abs([plane.angle_deg for plane in planes])
    assert np.mean(angles) == pytest.approx(1.5, abs=0.1)
    assert 0.4 < angles.min() < angles.max() < 2.6
    assert np.std([plane.offset_gauss for plane in planes]) == pytest.approx(0.1, rel=0.1)
    assert 0.05 < np.std([plane.roll_deg for plane in planes]) < 0.2
    ideal = Magnetometer(2, "GNC-0", errors=False)
    assert np.array_equal(ideal.matrix, np.eye(3))
    assert not ideal.offset_gauss.any()


def test_the_turntable_makes_it_wrong() -> None:
    """Its iron turns with the unit: the centre of the ellipse is off by more than a tenth of the field."""
    wrong, right = (module(Table(TURN.motion, "z", table), QUIET) for table in ("turntable", "non_magnetic"))
    middles, sizes = [], []
    for unit in (wrong, right):
        seen = unit.readings(ONCE).mag_gauss
        middles.append((seen.max(axis=0) + seen.min(axis=0))[:2] / 2)
        sizes.append((seen.max(axis=0) - seen.min(axis=0))[:2])
    assert np.hypot(*(middles[0] - middles[1])) > 0.043
    gains = [one[0] / one[1] for one in sizes]
    assert abs(gains[0] / gains[1] - 1) > 0.01
    bench = module(Table(TURN.motion, "z", "bench"), QUIET).readings(ONCE[:5]).mag_gauss
    assert np.array_equal(bench, right.readings(ONCE[:5]).mag_gauss)


def test_its_noise() -> None:
    noise = module(posed(0, 0, 0), ImuOptions()).readings(times_ns(200.0)).mag_gauss.std(axis=0)
    assert noise == pytest.approx([0.5e-3] * 3, rel=0.02)
