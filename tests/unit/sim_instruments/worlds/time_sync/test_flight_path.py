"""Paths of the simulated vehicle against quadrature, and the manoeuvres of the paper's Table 4 and Fig. 2."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import spherical_jn

from sim_instruments.worlds.time_sync.flight.path import MANOEUVRES, FlightPath, _bessel

# begin s, acceleration m/s2, yaw rate deg/s: from 1e-7 deg/s, where closed forms lose digits, to a spinning table
_PIECES = (
    (2.0, 0.0, 0.0),
    (5.0, 3.0, 1e-7),
    (9.0, -2.0, 0.03),
    (12.0, 1.0, -30.0),
    (17.0, 4.0, 720.0),
    (20.0, 0.0, 0.0),
)


def _heading(t_s: float) -> float:
    turned = 20.0
    for (begin, _, rate), end in zip(_PIECES, [*[p[0] for p in _PIECES[1:]], np.inf], strict=True):
        turned += rate * (min(max(t_s, begin), end) - begin)
    return np.radians(turned)


def _speed(t_s: float) -> float:
    speed = 30.0
    for (begin, along, _), end in zip(_PIECES, [*[p[0] for p in _PIECES[1:]], np.inf], strict=True):
        speed += along * (min(max(t_s, begin), end) - begin)
    return speed


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


def test_acceleration_and_yaw_rate_are_derivatives() -> None:
    path = FlightPath(_PIECES, 30.0, 20.0)
    t_s = np.array([1.0, 3.0, 7.0, 10.0, 14.0, 18.2, 25.0])
    h = 1e-4
    before, now, after = path.state(t_s - h), path.state(t_s), path.state(t_s + h)
    assert now.a == pytest.approx((after.v - before.v) / (2 * h), abs=2e-4)
    assert now.yaw_rate == pytest.approx((after.yaw - before.yaw) / (2 * h), abs=1e-7)


def test_position_and_velocity_do_not_jump_at_borders() -> None:
    path = FlightPath(_PIECES, 30.0, 20.0)
    for begin, along, rate in _PIECES:
        before, there = path.state(np.array([np.nextafter(begin, 0.0)])), path.state(np.array([begin]))
        assert there.p == pytest.approx(before.p, abs=1e-9)
        assert there.v == pytest.approx(before.v, abs=1e-9)
        assert there.yaw_rate[0] == np.radians(rate)
        heading = np.array([np.cos(there.yaw[0]), np.sin(there.yaw[0]), 0.0])
        assert there.a[0] @ heading == pytest.approx(along, abs=1e-9)


def test_ramp_in_pieces_of_a_millisecond() -> None:
    """A yaw rate that rises evenly, as a table's does, is met to the square of the pieces' length."""
    path = FlightPath(((0.0, 0.0, 0.0),), 100.0)
    for k in range(500):
        path.add(k * 1e-3, 0.0, 18.0 * (k + 0.5) * 1e-3)
    state = path.state(np.array([0.5]))
    assert np.degrees(state.yaw[0]) == pytest.approx(2.25, abs=1e-9)
    north = quad(lambda t: 100.0 * np.cos(np.radians(9.0 * t * t)), 0.0, 0.5)[0]
    east = quad(lambda t: 100.0 * np.sin(np.radians(9.0 * t * t)), 0.0, 0.5)[0]
    assert state.p[0, :2] == pytest.approx([north, east], abs=3e-6)


def test_a_piece_changes_the_future_only() -> None:
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


def test_manoeuvres_are_those_of_the_paper() -> None:
    assert set(MANOEUVRES) == {"stationary", "linear", "acceleration", "turn", "sar"}
    at = {name: path.state(np.array([-1.0, 10.0, 25.0, 55.0, 500.0])) for name, path in MANOEUVRES.items()}
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


def test_a_manoeuvre_that_was_extended_is_nobody_elses() -> None:
    MANOEUVRES["linear"].add(5.0, 9.0, 9.0)
    assert MANOEUVRES["linear"].borders_s(0.0, 60.0).size == 0
