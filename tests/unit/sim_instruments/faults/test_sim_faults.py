"""Fault switches: what they do, and that a seed gives the same faults however the stream is cut."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from calibrator_trip import trip_calibrator
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from sim_bench import Bench, open_bench

from bench.model.errors import InputError
from sim_instruments.faults.fault import Fault
from sim_instruments.faults.named import FaultSwitches
from sim_instruments.faults.switchboard import Faults, LinkFaults

NS = 1_000_000_000


def in_pieces(draw, total: int, sizes: list[int]) -> np.ndarray:
    parts, at = [], 0
    while at < total:
        n = min(sizes[len(parts) % len(sizes)], total - at)
        parts.append(draw(at, n))
        at += n
    return np.concatenate(parts)


@pytest.mark.parametrize("sizes", [[1, 1, 3], [7, 100], [4095, 2], [10_000]])
def test_link_faults_do_not_depend_on_how_the_stream_is_cut(sizes: list[int]) -> None:
    total = 10_000
    faults = LinkFaults(5, "port_a", bit_error_rate=1e-4, drop_rate=0.01, duplicate_rate=0.02)
    assert np.array_equal(in_pieces(faults.copies, total, sizes), faults.copies(0, total))
    flips = in_pieces(lambda at, n: faults.flips(at, n, 57), total, sizes)
    assert np.array_equal(flips, faults.flips(0, total, 57))


def test_link_fault_rates() -> None:
    n, length = 200_000, 57
    faults = LinkFaults(6, "port_a", bit_error_rate=1e-4, drop_rate=0.01, duplicate_rate=0.02)
    copies = faults.copies(0, n)
    assert (copies == 0).mean() == pytest.approx(0.01, rel=0.1)
    assert (copies == 2).mean() == pytest.approx(0.02 * 0.99, rel=0.1)
    bits = np.unpackbits(faults.flips(0, n, length)).sum()
    assert bits / (n * length * 8) == pytest.approx(1e-4, rel=0.02)


def test_links_and_seeds_have_faults_of_their_own() -> None:
    a, b, other = (LinkFaults(seed, name, drop_rate=0.5) for seed, name in ((1, "a"), (1, "b"), (2, "a")))
    assert not np.array_equal(a.copies(0, 1000), b.copies(0, 1000))
    assert not np.array_equal(a.copies(0, 1000), other.copies(0, 1000))


def test_no_fault_is_switched_on_at_the_start() -> None:
    faults = LinkFaults(1, "port_a")
    assert not faults.active
    assert np.array_equal(faults.copies(0, 100), np.ones(100))
    assert not faults.flips(0, 100, 57).any()
    faults.silent = True
    assert faults.active
    assert not faults.copies(0, 100).any()


def test_mute_instrument_times_out_and_comes_back(bench: Bench) -> None:
    bench.world.faults.instrument("calibrator").mute = True
    with pytest.raises(VisaIOError) as caught:
        bench.ask("calibrator", "ISR?")
    assert caught.value.error_code == StatusCode.error_timeout
    bench.world.faults.instrument("calibrator").mute = False
    bench["calibrator"].clear()
    assert bench.ask("calibrator", "ISR?") == "4096"


def test_late_reply_is_read_by_the_next_query_unless_cleared() -> None:
    for clear in (False, True):
        with open_bench() as bench:
            faults = bench.world.faults.instrument("supply")
            faults.late_s, faults.late_replies = 3.0, 1
            with pytest.raises(VisaIOError):
                bench.ask("supply", "*IDN?")
            if clear:
                bench["supply"].clear()
            bench["supply"].timeout = 5000
            assert bench.ask("supply", "VOLT?").startswith("0.0" if clear else "HEWLETT-PACKARD")


def test_reply_later_than_usual_but_inside_the_timeout(bench: Bench) -> None:
    faults = bench.world.faults.instrument("supply")
    faults.late_s, faults.late_replies = 1.5, 1
    began_ns = bench.clock.now_ns()
    assert bench.ask("supply", "VOLT?") == "0.00000E+00"
    assert bench.clock.now_ns() - began_ns == pytest.approx(1.5 * NS, abs=1e7)


def test_garbled_replies_are_seeded_and_counted() -> None:
    replies = []
    for _ in range(2):
        with open_bench(seed=3) as bench:
            bench.world.faults.instrument("supply").garbled_replies = 2
            replies.append([bench.ask("supply", "VOLT?") for _ in range(3)])
    assert replies[0] == replies[1]
    assert "#" in replies[0][0]
    assert "#" in replies[0][1]
    assert replies[0][2] == "0.00000E+00"


@pytest.mark.parametrize(("role", "question"), [("calibrator", "*IDN?"), ("switch", "*IDN?"), ("chamber", "IDEN?")])
def test_wrong_instrument_at_the_address(bench: Bench, role: str, question: str) -> None:
    bench.world.faults.instrument(role).identity = "ACME,42,0,0"
    assert bench.ask(role, question) == "ACME,42,0,0"


def test_calibrator_trips_at_the_given_time(bench: Bench) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", "OUT 1.0E-03 A, 0 HZ", "OPER")
    trip_calibrator(bench.world, 100 * NS)
    bench.clock.sleep_until_ns(99 * NS)
    assert bench.ask("calibrator", "ISR?") == "4097"
    bench.clock.sleep_until_ns(101 * NS)
    assert bench.ask("calibrator", "ISR?") == "4096"
    assert bench.unit.history[-1] == (100 * NS, 1, bench.world.wiring.leakage_A[0, 0])


def test_coming_trip_bounds_the_quiet_time(bench: Bench) -> None:
    seen = []
    trip_calibrator(bench.world, 100 * NS)
    bench.clock.every(40.0, lambda: seen.append(bench.clock.quiet_until_ns()))
    bench.clock.sleep_until_ns(150 * NS)
    assert seen == [100 * NS, 100 * NS, 150 * NS]


def test_chamber_with_a_shortfall_never_settles() -> None:
    with open_bench(instruments={"chamber": {"dialect": "8800"}}) as bench:
        bench.world.switches.switch("chamber_shortfall", 2.0)
        for operation in ("MRMP1,1.0", "SETP1,5", "RUNM"):
            bench.ask("chamber", operation)
        bench.clock.sleep(36_000.0)
        assert float(bench.world.thermal.unit_degC(bench.clock.now_ns())) == pytest.approx(7.0, abs=1e-3)
        assert bench.ask("chamber", "SETP1?") == "5.0"


@pytest.mark.parametrize("name", ["clear", "state"])
def test_clear_and_state_stand_alone(name: str) -> None:
    with pytest.raises(InputError, match=f"B-SIM-012.*stands alone.*bench sim fault {name}"):
        FaultSwitches(SimpleNamespace(instruments={}, ports=["port_a"])).switch(name, "x")


def test_each_model_does_what_it_declares_under_a_name() -> None:
    done: list[tuple[str, float]] = []
    models = {
        role: SimpleNamespace(
            named_faults={"jam": Fault("mill", (("RATE", 0.0, 9.0),), "it jams", lambda model, rate: model.jam(rate))},
            jam=lambda rate, role=role: done.append((role, rate)),
        )
        for role in ("coarse", "fine")
    }
    models["fine"].named_faults["slip"] = Fault("mill", (), "it slips", lambda _: done.append(("slip", 0.0)))
    bench = SimpleNamespace(lock=contextlib.nullcontext(), faults=Faults(1), instruments=models, ports=())
    switches = FaultSwitches(bench)
    switches.switch("jam", "3")
    switches.switch("slip")
    assert done == [("coarse", 3.0), ("fine", 3.0), ("slip", 0.0)]
