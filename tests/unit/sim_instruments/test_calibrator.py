"""Simulated 5720A: its command language, its fault queue, its ranges, its errors of Table 2."""

from __future__ import annotations

import numpy as np
import pytest
from sim_bench import Bench, open_bench

from sim_instruments.fluke_5720a import parse_value

OPERATING, STANDBY = 4097, 4096


def status(bench: Bench) -> int:
    return int(bench.ask("calibrator", "ISR?"))


def faults(bench: Bench) -> list[int]:
    found = []
    while number := int(bench.ask("calibrator", "FAULT?")):
        found.append(number)
    return found


def on_channel_one(bench: Bench, current: str) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", f"OUT {current} A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)


def test_power_on_is_standby_and_zero_into_an_open_circuit_stays_on(bench: Bench) -> None:
    assert status(bench) == STANDBY
    assert faults(bench) == []
    assert bench.ask("calibrator", "OUT?") == "0.0000000E+00,V,0.00E+00"
    assert bench.ask("calibrator", "RANGELCK?") == "OFF"
    bench.send("calibrator", "OUT 0 A, 0 HZ", "OPER")
    bench.clock.sleep(5.0)
    assert status(bench) == OPERATING


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.0E-02 A", (0.01, "A")),
        ("10 MA", (0.01, "A")),
        ("10MA", (0.01, "A")),
        ("30 UA", (3e-5, "A")),
        ("1 MAOHM", (1e6, "OHM")),
        ("1 KOHM", (1e3, "OHM")),
        ("2 MV", (2e-3, "V")),
        ("3 MAV", (3e6, "V")),
        ("0 HZ", (0.0, "HZ")),
        ("-5", (-5.0, "")),
    ],
)
def test_multipliers_ma_is_milli_only_for_amperes(text: str, value: tuple[float, str]) -> None:
    assert parse_value(text)[0] == pytest.approx(value[0])
    assert parse_value(text)[1] == value[1]


def test_settled_comes_after_its_time_and_later_with_another_range(bench: Bench) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", "OUT 1.0E-03 A, 0 HZ", "OPER")
    assert status(bench) == 1
    bench.clock.sleep(2.98)
    assert status(bench) == 1
    bench.clock.sleep(0.02)
    assert status(bench) == OPERATING
    on_channel_one(bench, "1.0E-03")
    bench.send("calibrator", "OUT 2.0E-03 A, 0 HZ")
    bench.clock.sleep(3.1)
    assert status(bench) == OPERATING
    bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ")
    bench.clock.sleep(3.1)
    assert status(bench) == 1
    bench.clock.sleep(2.0)
    assert status(bench) == OPERATING


def test_operation_complete_waits_until_settled(bench: Bench) -> None:
    bench["calibrator"].timeout = 10_000
    bench.send("switch", ":CLOS (@1!1!1)")
    before_ns = bench.clock.now_ns()
    assert bench.ask("calibrator", "OUT 1.0E-03 A, 0 HZ", "OPER", "*OPC?") == "1"
    assert bench.clock.now_ns() - before_ns == pytest.approx(3e9, abs=2e7)
    assert status(bench) == OPERATING


@pytest.mark.parametrize("lead", ["open circuit", "auxiliary terminals"])
def test_operating_without_a_path_trips_and_says_so(bench: Bench, lead: str) -> None:
    if lead == "auxiliary terminals":
        bench.send("switch", ":CLOS (@1!1!1)")
        bench.send("calibrator", "CUR_POST AUX")
    bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ", "OPER")
    assert status(bench) == STANDBY
    assert bench["calibrator"].read_stb() & 8
    assert bench.ask("calibrator", "FAULT?") == "501"
    assert bench.ask("calibrator", "EXPLAIN? 501") == '"Compliance Voltage Exceeded"'
    assert not bench["calibrator"].read_stb() & 8


def test_voltage_into_the_current_input_trips(bench: Bench) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", "OUT 5 V, 0 HZ", "OPER")
    assert (status(bench), faults(bench)) == (STANDBY, [503])


@pytest.mark.parametrize(
    ("command", "fault"),
    [
        ("OUT 3 A, 0 HZ", 705),
        ("OUT 1.0E-02 A, 50 HZ", 704),
        ("OUT ten A", 703),
        ("OUT 1 MAOHM", 707),
        ("NONSENSE", 702),
        ("RANGELCK MAYBE", 701),
        ("EXPLAIN? 9999", 703),
        ("LIMIT -1 A, 1 A", 704),
    ],
)
def test_what_is_wrong_is_a_fault_and_changes_nothing(bench: Bench, command: str, fault: int) -> None:
    bench.send("calibrator", "OUT 1.0E-03 A, 0 HZ", command)
    assert faults(bench) == [fault]
    assert bench.ask("calibrator", "OUT?") == "1.0000000E-03,A,0.00E+00"


def test_entry_limit_is_kept(bench: Bench) -> None:
    bench.send("calibrator", "LIMIT 0.25 A, -0.25 A", "OUT 0.3 A, 0 HZ")
    assert faults(bench) == [705]
    bench.send("calibrator", "OUT 0.2 A, 0 HZ")
    assert faults(bench) == []
    assert bench.ask("calibrator", "LIMIT?") == "2.500E-01,-2.500E-01"


def test_faults_are_queued_to_fifteen_and_lost_with_the_status(bench: Bench) -> None:
    bench.send("calibrator", *["NONSENSE"] * 7, *["OUT x A"] * 13)
    assert faults(bench) == [702] * 7 + [703] * 8 + [601]
    bench.send("calibrator", "NONSENSE", "*CLS")
    assert faults(bench) == []


def test_high_voltage_is_inhibited_while_a_fault_is_queued(bench: Bench) -> None:
    bench.send("calibrator", "OUT 22 V, 0 HZ", "NONSENSE", "OPER")
    assert (status(bench), faults(bench)) == (STANDBY, [702, 708])
    bench.send("calibrator", "OPER")
    assert status(bench) == OPERATING


def test_a_range_is_kept_down_and_not_exceeded(bench: Bench) -> None:
    calibrator = bench.world.instruments["calibrator"]
    bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ", "RANGELCK ON", "OUT 0 A, 0 HZ")
    assert calibrator.range_index == 2
    bench.send("calibrator", "OUT 1.0E-01 A, 0 HZ")
    assert faults(bench) == [706]
    assert calibrator.value == 0.0
    bench.send("calibrator", "RANGELCK OFF", "OUT 0 A, 0 HZ")
    assert calibrator.range_index == 0
    bench.send("calibrator", "OUT 1.00000012345E-03 A, 0 HZ")
    assert bench.ask("calibrator", "OUT?").split(",")[0] == "1.0000000E-03"


@pytest.mark.parametrize(
    ("current", "index"),
    [("0", 0), ("2.2E-4", 0), ("2.21E-4", 1), ("2.2E-3", 1), ("2.0E-2", 2), ("0.2", 3), ("0.299", 4), ("-0.2", 3)],
)
def test_lowest_range_that_holds(bench: Bench, current: str, index: int) -> None:
    bench.send("calibrator", f"OUT {current} A, 0 HZ")
    assert bench.world.instruments["calibrator"].range_index == index


def test_reset_goes_to_standby(bench: Bench) -> None:
    on_channel_one(bench, "1.0E-02")
    bench.send("calibrator", "*RST")
    assert status(bench) == STANDBY
    assert bench.unit.inputs[1] == bench.world.wiring.leakage_A[0, 0]


def settled_A(bench: Bench, current: str, row: int = 1, channel: int = 1) -> float:
    """Current in the channel without the leakage of the route."""
    bench.send("calibrator", "STBY")
    bench.send("switch", ":OPEN ALL", f":CLOS (@1!{row}!{channel})")
    bench.send("calibrator", f"OUT {current} A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)
    return bench.unit.inputs[channel] - bench.world.wiring.leakage_A[row - 1, channel - 1]


@pytest.mark.parametrize(
    ("offset_A", "scale", "bits", "current_A"), [(5e-4, 1.0, 256, 1.5e-3), (0.0, 1.01, 512, 1.01e-3)]
)
def test_an_offset_or_a_scale_factor_is_told_by_the_status_alone(
    bench: Bench, offset_A: float, scale: float, bits: int, current_A: float
) -> None:
    calibrator = bench.world.instruments["calibrator"]
    calibrator.offset_A, calibrator.scale = offset_A, scale
    assert settled_A(bench, "1.0E-03") == pytest.approx(current_A, rel=1e-4)
    assert status(bench) == OPERATING | bits
    assert bench.ask("calibrator", "OUT?") == "1.0000000E-03,A,0.00E+00"
    assert settled_A(bench, "0") == pytest.approx(offset_A, abs=1e-7)
    bench.send("calibrator", "*RST")
    assert status(bench) == STANDBY
    assert settled_A(bench, "1.0E-03") == pytest.approx(1e-3, rel=1e-4)


def test_errors_are_common_to_polarity_channel_and_time() -> None:
    with open_bench(seed=4) as bench:
        first_A = settled_A(bench, "1.0E-02")
        assert first_A != 1e-2
        assert settled_A(bench, "1.0E-02", row=2) == pytest.approx(-first_A, abs=1e-17)
        bench.clock.sleep(36_000.0)
        assert settled_A(bench, "1.0E-02", channel=9) == pytest.approx(first_A, abs=1e-17)


def test_zero_shows_the_offset_of_its_range() -> None:
    with open_bench(seed=4) as bench:
        low_A = settled_A(bench, "0")
        settled_A(bench, "1.0E-01")
        bench.send("calibrator", "RANGELCK ON")
        high_A = settled_A(bench, "0")
        assert 0 < abs(low_A) < 5 * 3e-9
        assert 5 * 3e-9 < abs(high_A) < 5 * 3.5e-7


def test_gain_and_floor_can_be_switched_off() -> None:
    with open_bench(seed=4, options={"calibrator_gain": "off"}) as bench:
        assert abs(settled_A(bench, "2.0E-01") - 0.2) < 5 * 0.7e-6
    with open_bench(seed=4, options={"calibrator_floor": "off"}) as bench:
        gain = settled_A(bench, "2.0E-01") / 0.2 - 1
        assert settled_A(bench, "3.0E-05") / 3e-5 - 1 == pytest.approx(gain, abs=1e-9)
        assert 0 < abs(gain) < 50e-6
    with open_bench(seed=4, options={"calibrator_gain": "off", "calibrator_floor": "off"}) as bench:
        assert settled_A(bench, "2.0E-01") == pytest.approx(0.2, abs=1e-16)


def test_errors_of_seeds_0_to_299_have_the_spread_of_table_2() -> None:
    gains, zeros, levels = [], [], []
    for seed in range(300):
        with open_bench(seed=seed) as bench:
            calibrator = bench.world.instruments["calibrator"]
            gains.append(calibrator.gain)
            bench.send("calibrator", "OUT 0 A, 0 HZ")
            zeros.append(calibrator.true_current_A())
            bench.send("calibrator", "OUT 1.0E-04 A, 0 HZ")
            levels.append(calibrator.true_current_A() - 1e-4 * (1 + calibrator.gain) - zeros[-1])
    assert np.std(gains) == pytest.approx(10e-6, rel=0.15)
    assert np.std(zeros) == pytest.approx(3e-9, rel=0.15)
    assert np.std(levels) == pytest.approx(3e-9, rel=0.15)
    assert abs(np.corrcoef(zeros, levels)[0, 1]) < 0.2
    assert abs(np.corrcoef(gains, zeros)[0, 1]) < 0.2
