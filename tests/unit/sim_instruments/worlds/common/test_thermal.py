"""Temperatures and motions in closed form against numerical integration of the same equations."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.model.clock import NS
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.thermal import AIR_LAG_S, IDLE_LAG_S, LAB_DEGC, UNIT_LAG_S, Thermal


def integrate(setpoint, air_lag_s: float, start: tuple[float, float], t_s: np.ndarray) -> np.ndarray:
    """Air and unit temperature, (2, n), from the lag equations and a set-point function of time."""

    def rates(t: float, state: np.ndarray) -> list[float]:
        return [(setpoint(t) - state[0]) / air_lag_s, (state[0] - state[1]) / UNIT_LAG_S]

    return solve_ivp(rates, (0.0, t_s[-1]), start, t_eval=t_s, rtol=1e-10, atol=1e-10, max_step=30.0).y


def test_at_rest_nothing_changes_and_shapes_are_kept() -> None:
    thermal = Thermal()
    t_ns = np.arange(0, 5) * 3600 * NS
    assert np.all(thermal.air_degC(t_ns) == 23.0)
    assert np.all(thermal.unit_degC(t_ns) == 23.0)
    thermal = Thermal()
    thermal.ramp(23.0, 0.5, 100 * NS)
    assert thermal.unit_degC(3600 * NS) == pytest.approx(23.0, abs=1e-12)
    thermal = Thermal()
    thermal.ramp(5.0, 0.5, 0)
    t_ns = np.array([[1, 2], [3000, 8000]]) * NS
    assert thermal.unit_degC(t_ns).shape == (2, 2)
    assert thermal.unit_degC(t_ns)[1, 0] == thermal.unit_degC(3000 * NS)
    lab_degC = Thermal().lab_degC(np.arange(0, 40) * 3600 * NS)
    assert np.abs(lab_degC - 23.0).max() == pytest.approx(0.3)
    assert lab_degC.std() > 0.1


@pytest.mark.validates(
    "temperatures of the simulated chamber and unit",
    against="numerical integration of the two lags",
)
def test_ramp_and_soak_against_integration(record_property: Callable[[str, object], None]) -> None:
    thermal = Thermal()
    thermal.ramp(-10.0, 0.5, 0)
    t_s = np.linspace(0.0, 9000.0, 901)
    air, unit = integrate(lambda t: max(23.0 - 0.5 / 60 * t, -10.0), AIR_LAG_S, (23.0, 23.0), t_s)
    t_ns = np.round(t_s * NS).astype(np.int64)
    worst_degC = max(np.abs(thermal.air_degC(t_ns) - air).max(), np.abs(thermal.unit_degC(t_ns) - unit).max())
    record_property("obtained", f"{worst_degC:.0e} degC, limit 2e-6")
    assert np.abs(thermal.air_degC(t_ns) - air).max() < 2e-6
    assert np.abs(thermal.unit_degC(t_ns) - unit).max() < 2e-6


def test_commands_in_the_middle_of_a_ramp_against_integration() -> None:
    thermal = Thermal()
    thermal.ramp(50.0, 1.0, 0)
    thermal.hold(600 * NS)
    thermal.ramp(20.0, 2.0, 1200 * NS)
    thermal.stop(1500 * NS)
    state, at_s = (23.0, 23.0), 0
    pieces = [
        (600, lambda t: 23.0 + t / 60.0, AIR_LAG_S),
        (1200, lambda t: 33.0, AIR_LAG_S),
        (1500, lambda t: 33.0 - t / 30.0, AIR_LAG_S),
        (9000, lambda t: LAB_DEGC, IDLE_LAG_S),
    ]
    for end_s, setpoint, lag_s in pieces:
        t_s = np.linspace(0.0, end_s - at_s, 200)
        air, unit = integrate(setpoint, lag_s, state, t_s)
        t_ns = np.round((at_s + t_s) * NS).astype(np.int64)
        assert np.abs(thermal.air_degC(t_ns) - air).max() < 2e-6
        assert np.abs(thermal.unit_degC(t_ns) - unit).max() < 2e-6
        state, at_s = (air[-1], unit[-1]), end_s


def test_a_new_command_replaces_what_was_planned_and_the_setpoint_goes_along() -> None:
    thermal = Thermal()
    thermal.ramp(50.0, 0.5, 0)
    t_ns = np.arange(0, 1000, 7) * NS
    before = thermal.unit_degC(t_ns)
    thermal.ramp(0.0, 0.5, 1000 * NS)
    assert np.array_equal(thermal.unit_degC(t_ns), before)
    assert thermal.air_degC(20_000 * NS) == pytest.approx(0.0, abs=1e-6)
    thermal = Thermal()
    thermal.ramp(33.0, 0.5, 0)
    assert thermal.setpoint_degC(600 * NS) == pytest.approx(28.0)
    assert thermal.setpoint_degC(5000 * NS) == 33.0
    thermal.stop(6000 * NS)
    assert thermal.setpoint_degC(7000 * NS) == thermal.air_degC(7000 * NS)


def test_ways_in_numbers_written_down() -> None:
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
    axis = AxisMotion()
    axis.go_to(-1.0, 100.0, 25.0, 0)
    assert axis.rest_ns == pytest.approx(0.4 * NS, abs=1)
    assert axis.rate_deg_s(NS // 5) == pytest.approx(-5.0, abs=1e-6)
    assert axis.angle_deg(NS // 5) == pytest.approx(-0.5, abs=1e-6)
    axis = AxisMotion(33.3)
    for turn in range(20):
        axis.go_to(33.3 + (1080.0 if turn % 2 == 0 else 0.0), 271.3, 269.9, axis.rest_ns + NS)
    assert axis.angle_deg(axis.rest_ns) == 33.3


def test_a_way_is_exact_between_nanoseconds_and_its_past_stays() -> None:
    """Phases of 1/3 s: rounded to whole nanoseconds the angle would step at each joint by 1e-7 deg."""
    axis = AxisMotion()
    axis.go_to(200.0, 100.0, 300.0, 0)
    joints = np.array([NS // 3, NS // 3 + 1, axis.rest_ns - 1, axis.rest_ns])
    angle = axis.angle_deg(joints)
    assert angle[1] - angle[0] == pytest.approx(100.0 / NS, rel=1e-4)
    assert angle[0] == pytest.approx(150.0 * (joints[0] / NS) ** 2, abs=1e-13)
    assert angle[3] == 200.0
    axis = AxisMotion()
    axis.go_to(1080.0, 270.0, 270.0, 0)
    past = np.arange(0, 2 * NS, NS // 100)
    before = axis.angle_deg(past)
    axis.run_at(0.0, 400.0, 2 * NS)
    assert np.array_equal(axis.angle_deg(past), before)
    assert axis.angle_deg(axis.rest_ns) == pytest.approx(405.0 + 270.0**2 / 800.0, abs=1e-9)


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
