"""Kirchhoff on the simulated wires: current arrives only where relays really lead it, with sign and leakage."""

from __future__ import annotations

import pytest
from sim_bench import Bench, open_bench

LEVEL_A = 1e-3
# gain 4.5 sigma, floor and level error of the 2.2 mA range
TOLERANCE_A = LEVEL_A * 45e-6 + 4.5 * 7e-9


def operate(bench: Bench, current: str = "1.0E-03") -> None:
    bench.send("calibrator", f"OUT {current} A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)


def connected(bench: Bench) -> dict[int, float]:
    return {channel: current_A for channel, current_A in bench.unit.inputs.items() if current_A is not None}


@pytest.mark.parametrize(("row", "sign"), [(1, 1.0), (2, -1.0)])
@pytest.mark.parametrize("channel", [1, 3, 10])
def test_current_arrives_in_the_routed_channel_with_the_polarity_of_the_row(
    channel: int, row: int, sign: float
) -> None:
    with open_bench() as bench:
        bench.send("switch", f":CLOS (@1!{row}!{channel})")
        operate(bench)
        assert connected(bench).keys() == {channel}
        assert connected(bench)[channel] == pytest.approx(sign * LEVEL_A, abs=TOLERANCE_A)


def test_rows_that_lead_nowhere_carry_nothing() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!3!4,1!4!4)")
        operate(bench)
        assert connected(bench) == {}
        assert bench.ask("calibrator", "ISR?") == "4096"


def test_standby_leaves_only_the_leakage_of_the_row() -> None:
    with open_bench() as bench:
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


def test_two_closed_routes_share_the_current() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!1!1)", ":CLOS (@1!2!2)")
        operate(bench)
        assert connected(bench)[1] == pytest.approx(LEVEL_A / 2, abs=TOLERANCE_A)
        assert connected(bench)[2] == pytest.approx(-LEVEL_A / 2, abs=TOLERANCE_A)


def test_both_rows_of_a_channel_short_the_calibrator() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!1!1,1!2!1,1!1!2)")
        operate(bench)
        assert bench.ask("calibrator", "ISR?") == "4097"
        assert all(abs(current_A) <= 2e-10 for current_A in connected(bench).values())


def test_opening_the_path_under_current_trips_the_calibrator() -> None:
    with open_bench() as bench:
        bench.send("switch", ":CLOS (@1!1!2)")
        operate(bench)
        bench.send("switch", ":OPEN (@1!1!2)")
        assert bench.ask("calibrator", "ISR?") == "4096"
        assert bench.ask("calibrator", "FAULT?") == "502"
        assert connected(bench) == {}


def test_opening_one_of_two_routes_under_current_does_not_trip() -> None:
    with open_bench() as bench:
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


def test_multimeter_in_the_loop_reads_the_current() -> None:
    with open_bench(options={"dmm_errors": "off"}) as bench:
        bench["dmm"].timeout = 10_000
        bench.send("switch", ":CLOS (@1!2!1)")
        operate(bench)
        bench.send("dmm", "END ALWAYS", "PRESET NORM", "DCI 0.001", "NPLC 10", "TRIG SGL")
        assert float(bench["dmm"].read()) == pytest.approx(LEVEL_A, rel=80e-6)
        bench.send("calibrator", "STBY")
        bench.send("dmm", "TRIG SGL")
        assert abs(float(bench["dmm"].read())) < 2e-9
