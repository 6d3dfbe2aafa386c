"""Temperatures in closed form against a numerical integration of the same differential equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_instruments.worlds.common.thermal import AIR_LAG_S, IDLE_LAG_S, LAB_DEGC, UNIT_LAG_S, Thermal

NS = 1_000_000_000


def integrate(setpoint, air_lag_s: float, start: tuple[float, float], t_s: np.ndarray) -> np.ndarray:
    """Air and unit temperature, (2, n), from the lag equations and a set-point function of time."""

    def rates(t: float, state: np.ndarray) -> list[float]:
        return [(setpoint(t) - state[0]) / air_lag_s, (state[0] - state[1]) / UNIT_LAG_S]

    return solve_ivp(rates, (0.0, t_s[-1]), start, t_eval=t_s, rtol=1e-10, atol=1e-10, max_step=30.0).y


def test_bench_starts_in_equilibrium() -> None:
    thermal = Thermal()
    t_ns = np.arange(0, 5) * 3600 * NS
    assert np.all(thermal.air_degC(t_ns) == 23.0)
    assert np.all(thermal.unit_degC(t_ns) == 23.0)


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


def test_unit_lags_by_four_tenths_after_the_first_soak() -> None:
    thermal = Thermal()
    thermal.ramp(-10.0, 0.5, 0)
    assert thermal.unit_degC(9000 * NS) + 10.0 == pytest.approx(0.43, abs=0.02)


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


def test_new_command_replaces_what_was_planned_and_leaves_the_past() -> None:
    thermal = Thermal()
    thermal.ramp(50.0, 0.5, 0)
    t_ns = np.arange(0, 1000, 7) * NS
    before = thermal.unit_degC(t_ns)
    thermal.ramp(0.0, 0.5, 1000 * NS)
    assert np.array_equal(thermal.unit_degC(t_ns), before)
    assert thermal.air_degC(20_000 * NS) == pytest.approx(0.0, abs=1e-6)


def test_setpoint_goes_along_the_ramp_and_is_the_air_when_switched_off() -> None:
    thermal = Thermal()
    thermal.ramp(33.0, 0.5, 0)
    assert thermal.setpoint_degC(600 * NS) == pytest.approx(28.0)
    assert thermal.setpoint_degC(5000 * NS) == 33.0
    thermal.stop(6000 * NS)
    assert thermal.setpoint_degC(7000 * NS) == thermal.air_degC(7000 * NS)


def test_ramp_to_where_the_setpoint_is_already() -> None:
    thermal = Thermal()
    thermal.ramp(23.0, 0.5, 100 * NS)
    assert thermal.unit_degC(3600 * NS) == pytest.approx(23.0, abs=1e-12)


def test_scalar_and_array_agree_and_shapes_are_kept() -> None:
    thermal = Thermal()
    thermal.ramp(5.0, 0.5, 0)
    t_ns = np.array([[1, 2], [3000, 8000]]) * NS
    assert thermal.unit_degC(t_ns).shape == (2, 2)
    assert thermal.unit_degC(t_ns)[1, 0] == thermal.unit_degC(3000 * NS)


def test_laboratory_stays_near_23_degC() -> None:
    lab_degC = Thermal().lab_degC(np.arange(0, 40) * 3600 * NS)
    assert np.abs(lab_degC - 23.0).max() == pytest.approx(0.3)
    assert lab_degC.std() > 0.1
