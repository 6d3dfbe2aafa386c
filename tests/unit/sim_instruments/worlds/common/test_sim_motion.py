"""Motion of an axis: against integration by small steps, closed forms of trapezoids, and random changes on the way."""

from __future__ import annotations

import numpy as np
import pytest

from bench.model.clock import NS
from sim_instruments.worlds.common.motion import AxisMotion


def test_a_trapezoid_in_numbers_written_down() -> None:
    """1080 deg at 270 deg/s with ramps of one second: up in 1 s (135 deg), 3 s at rate (810 deg), down in 1 s."""
    axis = AxisMotion(10.0)
    axis.go_to(1090.0, 270.0, 270.0, 2 * NS)
    t_s = np.array([0.0, 2.0, 2.5, 3.0, 4.5, 6.0, 6.5, 7.0, 100.0])
    angle = np.array([0.0, 0.0, 33.75, 135.0, 540.0, 945.0, 1046.25, 1080.0, 1080.0]) + 10.0
    assert axis.angle_deg((t_s * NS).astype(np.int64)) == pytest.approx(angle, abs=1e-12)
    assert axis.rate_deg_s((t_s * NS).astype(np.int64)) == pytest.approx(
        [0, 0, 135, 270, 270, 270, 135, 0, 0], abs=1e-12
    )
    assert axis.rest_ns == 7 * NS


def test_a_short_way_is_a_triangle() -> None:
    axis = AxisMotion()
    axis.go_to(-1.0, 100.0, 25.0, 0)
    assert axis.rest_ns == pytest.approx(0.4 * NS, abs=1)
    assert axis.rate_deg_s(NS // 5) == pytest.approx(-5.0, abs=1e-6)
    assert axis.angle_deg(NS // 5) == pytest.approx(-0.5, abs=1e-6)


def test_a_turn_there_and_back_ends_exactly_where_it_began() -> None:
    axis = AxisMotion(33.3)
    for turn in range(20):
        axis.go_to(33.3 + (1080.0 if turn % 2 == 0 else 0.0), 271.3, 269.9, axis.rest_ns + NS)
    assert axis.angle_deg(axis.rest_ns) == 33.3


def test_times_between_nanoseconds_are_not_rounded() -> None:
    """Phases of 1/3 s: rounded to whole nanoseconds the angle would step at each joint by 1e-7 deg."""
    axis = AxisMotion()
    axis.go_to(200.0, 100.0, 300.0, 0)
    joints = np.array([NS // 3, NS // 3 + 1, axis.rest_ns - 1, axis.rest_ns])
    angle = axis.angle_deg(joints)
    assert angle[1] - angle[0] == pytest.approx(100.0 / NS, rel=1e-4)
    assert angle[0] == pytest.approx(150.0 * (joints[0] / NS) ** 2, abs=1e-13)
    assert angle[3] == 200.0


@pytest.mark.parametrize("seed", range(5))
def test_angle_is_the_integral_of_rate_whatever_is_ordered_on_the_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, t_ns, highest = AxisMotion(), 0, 500.0
    for _ in range(60):
        if rng.random() < 0.6:
            axis.go_to(float(rng.uniform(-400, 400)), float(rng.uniform(5, 300)), float(rng.uniform(50, highest)), t_ns)
        else:
            axis.run_at(float(rng.uniform(-300, 300)), float(rng.uniform(50, highest)), t_ns)
        t_ns += int(rng.uniform(0.0, 3.0) * NS)
    grid = np.arange(0, t_ns, NS // 2000)
    angle, rate = axis.angle_deg(grid), axis.rate_deg_s(grid)
    step_s = np.diff(grid) / NS
    middle = axis.rate_deg_s((grid[:-1] + grid[1:]) // 2)
    assert np.abs(np.diff(rate)).max() <= highest * step_s[0] * (1 + 1e-6)  # no jump of the rate anywhere
    assert np.abs(np.diff(angle) - middle * step_s).max() <= highest * step_s[0] ** 2 / 4
    simpson = np.sum((rate[:-1] + 4.0 * middle + rate[1:]) * step_s / 6.0)
    assert angle[-1] - angle[0] == pytest.approx(simpson, abs=2e-3)


@pytest.mark.parametrize("speed", [-200.0, -50.0, 0.0, 80.0, 250.0])
@pytest.mark.parametrize("way", [-90.0, -0.001, 0.0, 0.5, 40.0, 700.0])
def test_it_arrives_from_any_speed_and_never_exceeds_what_is_allowed(speed: float, way: float) -> None:
    axis = AxisMotion()
    axis.run_at(speed, 1e9, 0)
    here = float(axis.angle_deg(NS))
    axis.go_to(here + way, 100.0, 150.0, NS)
    end_ns = axis.rest_ns
    assert axis.angle_deg(end_ns) == here + way
    assert axis.angle_deg(end_ns - 1) == pytest.approx(here + way, abs=1e-6)
    rate = axis.rate_deg_s(np.linspace(NS, end_ns, 500).astype(np.int64))
    assert np.abs(rate).max() <= max(100.0, abs(speed)) + 1e-6
    assert axis.rate_deg_s(end_ns + NS) == 0.0


def test_the_past_stays_what_it_was() -> None:
    axis = AxisMotion()
    axis.go_to(1080.0, 270.0, 270.0, 0)
    past = np.arange(0, 2 * NS, NS // 100)
    before = axis.angle_deg(past)
    axis.run_at(0.0, 400.0, 2 * NS)
    assert np.array_equal(axis.angle_deg(past), before)
    assert axis.angle_deg(axis.rest_ns) == pytest.approx(405.0 + 270.0**2 / 800.0, abs=1e-9)
