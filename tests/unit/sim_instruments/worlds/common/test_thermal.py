"""Temperatures and motions in closed form against numerical integration of the same equations; the world as a whole:
opening, errors, truth, threads, the same seed giving the same transcript; its wires."""

from collections.abc import Callable

import numpy as np
import pytest
import pyvisa
from scipy.integrate import solve_ivp
from sim_bench import Bench, RecordingUnit, open_bench, station

from bench.model.clock import NS, VirtualClock
from bench.model.errors import ExitStatus, InputError
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.thermal import AIR_LAG_S, IDLE_LAG_S, LAB_DEGC, UNIT_LAG_S, Thermal
from sim_instruments.worlds.common.world import _worlds, live_world
from sim_instruments.worlds.simulation import open_world


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
def test_commands_in_the_middle_of_a_ramp_against_integration(
    record_property: Callable[[str, object], None],
) -> None:
    thermal, worst_degC = Thermal(), 0.0
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
        off_degC = np.abs([thermal.air_degC(t_ns) - air, thermal.unit_degC(t_ns) - unit]).max()
        worst_degC = max(worst_degC, off_degC)
        state, at_s = (air[-1], unit[-1]), end_s
    record_property("obtained", f"{worst_degC:.0e} degC, limit 2e-6")
    assert worst_degC < 2e-6


def test_the_setpoint_goes_along_with_commands() -> None:
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


def open_plain(name: str = "af_converter", changes: dict | None = None, options: dict[str, str] | None = None):
    described = station()
    described["instruments"].update(changes or {})
    return open_world(
        name, clock=VirtualClock(), seed=1, station=described, options=options, unit_factory=RecordingUnit
    )


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        ("B-SIM-001", {"name": "moon"}),
        ("B-SIM-002", {"options": {"calibrator_gain": "maybe"}}),
        ("B-SIM-002", {"options": {"calibrator_gian": "off"}}),
        ("B-SIM-002", {"options": {"calibrator_drift_ppm": "fast"}}),
        ("B-SIM-002", {"options": {"calibrator_drift_ppm": "nan"}}),
        ("B-SIM-003", {"changes": {"extra": {"driver": "no_such_model", "resource": "GPIB0::20::INSTR"}}}),
        ("B-SIM-003", {"changes": {"extra": {"driver": "../../etc", "resource": "GPIB0::20::INSTR"}}}),
        ("B-SIM-003", {"changes": {"extra": {"driver": "wiring", "resource": "GPIB0::20::INSTR"}}}),
        ("B-SIM-004", {"changes": {"extra": {"driver": "hp_6632b", "resource": "GPIB0::4::INSTR"}}}),
        ("B-SIM-004", {"changes": {"extra": {"driver": "hp_6632b", "resource": "somewhere"}}}),
    ],
)
def test_mistakes_in_the_station_are_errors_with_a_code_and_leave_no_world(code: str, arguments: dict) -> None:
    before = set(_worlds)
    with pytest.raises(InputError) as caught:
        open_plain(**arguments)
    assert caught.value.code == code
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert set(_worlds) == before


def test_unit_gets_its_own_options_only() -> None:
    with open_bench(options={"calibrator_gain": "off", "noise": "off"}) as bench:
        assert bench.unit.options == {"noise": "off"}
        assert bench.world.options == {"calibrator_gain": False, "calibrator_floor": True, "dmm_errors": True}


def test_a_live_world_has_its_names_and_one_manager() -> None:
    with open_bench() as bench:
        assert bench.world.visa_library == f"{bench.world.id}@bench"
        assert bench.world.link_url("port_a") == f"sim://{bench.world.id}/port_a"
        assert live_world(bench.world.id) is bench.world
    assert live_world(bench.world.id) is None
    with open_bench() as bench:
        assert pyvisa.ResourceManager(bench.world.visa_library) is bench.manager


def test_event_after_the_end_of_the_world_does_nothing() -> None:
    clock, seen = VirtualClock(), []
    with open_bench(clock=clock) as bench:
        bench.world.after(1.0, lambda: seen.append("during"))
        bench.world.after(3.0, lambda: seen.append("afterwards"))
        clock.sleep(2.0)
    clock.sleep(5.0)
    assert seen == ["during"]


def window(number: int, channel: int, degC: float, start_s: int, **conditions: object) -> RecordWindow:
    kind = "gyro" if channel <= 6 else "accelerometer"
    shared = {"channel": channel, "kind": kind, "temperature_degC": degC, "route": "closed", "purpose": "point"}
    return RecordWindow(number, "port_a", 0, 10_000, start_s * NS, (start_s + 100) * NS, {**shared, **conditions})


def truths(bench: Bench, windows: list[RecordWindow]) -> dict[tuple, float]:
    return {
        (e["quantity"], e["conditions"].get("channel"), e["conditions"].get("temperature_degC")): e["value"]
        for e in bench.world.truth(windows)
    }


def test_truth_is_taken_at_the_true_unit_temperature() -> None:
    with open_bench() as bench:
        bench.world.thermal.ramp(-10.0, 0.5, 0)
        found = truths(bench, [window(0, 2, -10.0, 9000, route="open"), window(1, 2, -10.0, 9120)])
        unit_degC = bench.world.thermal.unit_degC
        mean_degC = (unit_degC(9050 * NS) + unit_degC(9170 * NS)) / 2
        assert found["dsf_n", 2, -10.0] == pytest.approx(200.0 + mean_degC, abs=1e-3)
        assert found["dsf_p", 2, -10.0] == 100.0
        assert found["dsf_asymmetry", 2, -10.0] == pytest.approx(100.0 + mean_degC, abs=1e-3)
        assert found["bias", 2, -10.0] == pytest.approx(2e-9 + 1e-12 * 9050 + 2e-9 * 2.0, rel=1e-9)
        assert found["master_clock_error", None, -10.0] == pytest.approx(1.5, rel=1e-12)
        assert found["clock_ratio_error", None, -10.0] == pytest.approx(-18.5, abs=1e-3)
        assert found["dsf_n_tc1", 2, None] == 1.0
        assert found["dsf_n_tc2", 2, None] == 0.02


def test_truth_has_the_form_of_the_contract_and_leaves_out_wiring_checks_and_repeats() -> None:
    with open_bench() as bench:
        windows = [
            window(0, 1, 20.0, 10, purpose="wiring"),
            window(1, 1, 50.0, 20_000, repeat=1),
            RecordWindow(2, "port_a", 0, 1, 0, NS, {"purpose": "idle"}),
        ]
        assert bench.world.truth(windows) == []
        for estimate in bench.world.truth([window(0, 1, 20.0, 10), window(1, 7, 20.0, 200)]):
            assert set(estimate) == {"quantity", "unit", "value", "conditions"}
            assert isinstance(estimate["value"], float)
            assert estimate["conditions"].get("kind", "gyro") in ("gyro", "accelerometer")


LEVEL_A = 1e-3
# gain 4.5 sigma, floor and level error of the 2.2 mA range
TOLERANCE_A = LEVEL_A * 45e-6 + 4.5 * 7e-9


def operate(bench: Bench, current: str = "1.0E-03") -> None:
    bench.send("calibrator", f"OUT {current} A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)


def connected(bench: Bench) -> dict[int, float]:
    return {channel: current_A for channel, current_A in bench.unit.inputs.items() if current_A is not None}


@pytest.mark.parametrize(
    ("closed", "carried"),  # part of the level by channel
    [
        *[(f"1!{row}!{channel}", {channel: sign}) for channel in (1, 3, 10) for row, sign in ((1, 1.0), (2, -1.0))],
        ("1!1!1,1!2!2", {1: 0.5, 2: -0.5}),  # two routes share the current
        ("1!1!1,1!2!1,1!1!2", {1: 0.0, 2: 0.0}),  # both rows of a channel short the calibrator
    ],
)
def test_current_arrives_where_it_is_routed_with_the_polarity_of_the_row(
    closed: str, carried: dict[int, float]
) -> None:
    with open_bench() as bench:
        bench.send("switch", f":CLOS (@{closed})")
        operate(bench)
        assert bench.ask("calibrator", "ISR?") == "4097"
        assert connected(bench) == {
            channel: pytest.approx(part * LEVEL_A, abs=TOLERANCE_A if part else 2e-10)
            for channel, part in carried.items()
        }


def test_rows_that_lead_nowhere_carry_nothing_and_standby_leaves_the_leakage() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!3!4,1!4!4)")
        operate(bench)
        assert connected(bench) == {}
        assert bench.ask("calibrator", "ISR?") == "4096"
        for row in (1, 2):
            bench.send("switch", ":OPEN ALL", f":CLOS (@1!{row}!5)")
            assert connected(bench)[5] == bench.world.wiring.leakage_A[row - 1, 4]
            assert 0 < abs(connected(bench)[5]) <= 1e-10


def test_leakage_differs_from_row_to_row_and_has_its_sign_in_both_polarities() -> None:
    with open_bench(options={"calibrator_gain": "off", "calibrator_floor": "off"}) as bench:
        leaks = bench.world.wiring.leakage_A
        for row, sign in ((1, 1.0), (2, -1.0)):
            bench.send("switch", ":OPEN ALL", f":CLOS (@1!{row}!7)")
            operate(bench, "3.0E-05")
            assert connected(bench)[7] == pytest.approx(sign * 3e-5 + leaks[row - 1, 6], abs=1e-18)
            bench.send("calibrator", "STBY")
        assert leaks[0, 6] != leaks[1, 6]


def test_opening_the_whole_path_under_current_trips_and_one_of_two_routes_does_not() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!1!2)")
        operate(bench)
        bench.send("switch", ":OPEN (@1!1!2)")
        assert bench.ask("calibrator", "ISR?") == "4096"
        assert bench.ask("calibrator", "FAULT?") == "502"
        assert connected(bench) == {}
        bench.send("switch", ":CLOS (@1!1!1,1!1!2)")
        operate(bench)
        bench.send("switch", ":OPEN (@1!1!1)")
        assert bench.ask("calibrator", "ISR?") == "4097"
        assert connected(bench)[2] == pytest.approx(LEVEL_A, abs=TOLERANCE_A)


def test_current_is_nearly_there_at_once_and_exact_when_settled() -> None:
    with open_bench(options={"calibrator_gain": "off", "calibrator_floor": "off"}) as bench:
        bench.send("switch", ":CLOS (@1!1!1)")
        leak_A = bench.world.wiring.leakage_A[0, 0]
        bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ", "OPER")
        on_ns = bench.clock.now_ns()
        bench.clock.sleep(60.0)
        (first_ns, _, first_A), (settled_ns, _, settled_A) = bench.unit.history[-2:]
        assert first_ns == on_ns
        assert first_A == pytest.approx(0.999 * 1e-2 + leak_A, rel=1e-12)
        assert settled_ns - on_ns == 3_000_000_000
        assert settled_A == pytest.approx(1e-2 + leak_A, rel=1e-12)


def test_settling_stopped_by_standby_changes_nothing_later() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!1!1)")
        bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ", "OPER", "STBY")
        changes = len(bench.unit.history)
        bench.clock.sleep(60.0)
        assert len(bench.unit.history) == changes
        assert bench.unit.inputs[1] == bench.world.wiring.leakage_A[0, 0]
