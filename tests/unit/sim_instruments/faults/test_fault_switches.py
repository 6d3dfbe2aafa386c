"""Every fault of the list, in virtual time: its effect through VISA, the port or the wires, its rate and its end."""

import contextlib
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyvisa
import serial
from fault_schedule import DRAWS, random_schedule, schedule
from sim_bench import DRIVERS, Bench, open_bench, station, timed_out, trip_calibrator

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import VirtualClock
from bench.model.errors import InputError
from bench.model.lab import find_shipped
from sim_instruments.faults.fault import Fault
from sim_instruments.faults.named import FaultSwitches, listing
from sim_instruments.faults.switchboard import Faults, LinkFaults
from sim_instruments.worlds.simulation import open_world, possible_faults

NS = 1_000_000_000
BAUD = {"port_a": 921_600, "port_b": 115_200}


@pytest.fixture
def bench() -> Iterator[Bench]:
    with open_bench(instruments={"chamber": {"dialect": "8800"}}) as opened:
        yield opened


@pytest.fixture
def unit(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """The bench with the real simulated unit, powered and streaming."""
    monkeypatch.setattr(serial, "protocol_handler_packages", [*serial.protocol_handler_packages, "sim_instruments.bus"])
    world = open_world("af_converter", clock=VirtualClock(), seed=1, station=station())
    manager = pyvisa.ResourceManager(world.visa_library)
    opened = Bench(world, manager)
    opened.send("supply", "VOLT 18", "CURR 2", "OUTP ON")
    yield opened
    manager.close()
    world.close()


def listen(bench: Bench, seconds: float, link: str = "port_a") -> Any:
    """Counts of the frames of a link over some seconds."""
    decoder = LinkDecoder(load_frame(find_shipped("frames", {"port_a": "ngu_a", "port_b": "ngu_b"}[link])))
    with serial.serial_for_url(bench.world.link_url(link), baudrate=BAUD[link], timeout=0) as port:
        bench.clock.sleep(seconds)
        decoder.push(bench.clock.now_ns(), port.read(port.in_waiting))
    decoder.flush()
    return decoder.counts


def test_the_list_names_every_fault_once_with_what_it_takes() -> None:
    faults = possible_faults()
    lines = listing(faults)
    assert [line.split()[0] for line in lines] == list(faults)
    assert any(line.startswith("late ROLE SECONDS [COUNT] ") for line in lines)
    assert set(DRAWS) == {name for name in faults if not name.startswith("table_")} - {"replug"}


def test_faults_of_a_link_are_seen_by_the_decoder(unit: Bench) -> None:
    switch = unit.world.switches.switch
    unit.clock.sleep(2.0)
    assert listen(unit, 10.0).bad == 0
    switch("bit_errors", "port_a", 1e-4)
    assert listen(unit, 10.0).bad > 10
    switch("bit_errors", "port_a", "off")
    switch("drop", "port_a", "0.05")
    assert 20 < listen(unit, 10.0).lost < 90
    switch("drop", "port_a", 0)
    switch("duplicate", "port_a", 0.05)
    assert 20 < listen(unit, 10.0).duplicate < 90
    unit.world.switches.clear()
    clean = listen(unit, 10.0)
    assert (clean.bad, clean.lost, clean.duplicate) == (0, 0, 0)


def test_a_silent_link_says_nothing_and_the_other_goes_on(unit: Bench) -> None:
    unit.world.switches.switch("silent", "port_a")
    unit.clock.sleep(2.0)
    assert listen(unit, 2.0).bytes <= 57  # what was on the line already
    assert listen(unit, 2.0, "port_b").frames > 10


def test_a_stuck_link_repeats_its_bytes_without_end(unit: Bench) -> None:
    unit.clock.sleep(2.0)
    unit.world.switches.switch("stuck", "port_a", "EB90")
    with serial.serial_for_url(unit.world.link_url("port_a"), baudrate=BAUD["port_a"], timeout=0) as port:
        unit.clock.sleep(0.1)  # what was on the line already
        port.reset_input_buffer()
        unit.clock.sleep(2.0)
        received = port.read(100_000)
    assert len(received) > 10_000
    assert set(received) == {0xEB, 0x90}
    assert received[100:102] * 2 == received[102:106]


def test_an_unplugged_port_is_gone_and_a_new_one_must_be_opened(unit: Bench) -> None:
    url = unit.world.link_url("port_a")
    unit.clock.sleep(2.0)
    port = serial.serial_for_url(url, baudrate=BAUD["port_a"], timeout=0)
    unit.world.switches.switch("unplug", "port_a")
    with pytest.raises(serial.SerialException):
        port.read(1)
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(url)
    unit.clock.sleep(1.0)
    unit.world.switches.switch("replug", "port_a")
    assert unit.world.switches.on == []
    with pytest.raises(serial.SerialException):
        port.write(b"x")
    with serial.serial_for_url(url, baudrate=BAUD["port_a"], timeout=0) as again:
        port.close()  # the earlier one is put away: the new one still listens
        again.reset_input_buffer()
        unit.clock.sleep(1.0)
        assert again.in_waiting > 5000


def test_a_restarted_unit_counts_anew(unit: Bench) -> None:
    unit.clock.sleep(10.0)
    counters = []
    decoder = LinkDecoder(load_frame(find_shipped("frames", "ngu_a")))
    with serial.serial_for_url(unit.world.link_url("port_a"), baudrate=BAUD["port_a"], timeout=0) as port:
        for _ in range(2):
            unit.clock.sleep(3.0)
            decoder.push(unit.clock.now_ns(), port.read(port.in_waiting))
            (frames,) = decoder.flush().messages.values()
            counters.append(int(frames.raw("counter")[-1]))
            unit.world.switches.switch("unit_restart")
    assert counters[0] > 1000
    assert counters[1] < 200  # 0.3 s without supply and 1 s of boot


def test_a_mute_instrument_still_answers_a_poll_and_one_that_hangs_does_not(bench: Bench) -> None:
    switch, dmm = bench.world.switches.switch, bench["dmm"]
    switch("mute", "dmm")
    assert timed_out(lambda: dmm.query("ID?"))
    assert dmm.read_stb() & 16
    switch("mute", "dmm", "off")
    dmm.clear()
    switch("hang", "dmm")
    dmm.write("ID?")
    assert timed_out(dmm.read)
    assert timed_out(dmm.read_stb)
    assert timed_out(dmm.clear)
    switch("hang", "dmm", "off")
    assert dmm.query("ID?").strip() == "HP3458A"


def test_late_garbled_and_wrong_replies(bench: Bench) -> None:
    switch = bench.world.switches.switch
    switch("late", "supply", 1.5)
    began_ns = bench.clock.now_ns()
    assert bench.ask("supply", "VOLT?") == "0.00000E+00"
    assert bench.clock.now_ns() - began_ns == pytest.approx(1.5 * NS, abs=1e7)
    switch("garbled", "supply", 1)
    assert "#" in bench.ask("supply", "VOLT?")
    assert bench.world.switches.on == []  # both are used up
    switch("identity", "supply", "ACME,42,0,0")
    assert bench.ask("supply", "*IDN?") == "ACME,42,0,0"
    bench.world.switches.clear()
    assert bench.ask("supply", "*IDN?").startswith("HEWLETT-PACKARD,6632B")


@pytest.mark.parametrize(
    ("role", "question"),
    [
        ("rail_dmm", "READ?"), ("counter", "READ?"), ("supply", "MEAS:CURR?"), ("aux_supply", "MEAS:VOLT?"),
        ("dmm", "TARM SGL"), ("logger", "READ?"), ("chamber", "PVAR1?"),
    ],
)  # fmt: skip
def test_readings_that_are_no_numbers(bench: Bench, role: str, question: str) -> None:
    bench.send("function_generator", "OUTP ON")
    bench["counter"].timeout = bench["dmm"].timeout = 20_000
    if role == "logger":
        bench.send("logger", "ROUT:SCAN (@101)")
    if role == "dmm":
        bench.send("dmm", "PRESET NORM", "END ALWAYS", "DCI 0.1", "TARM HOLD")
    bench.world.switches.switch("nan", role)
    bench.world.switches.switch("overload", role, 1)
    first, second, third = (bench.ask(role, question).strip() for _ in range(3))
    assert first in {"+9.91000000E+37", "NAN"}
    assert float(second) in {9.9e37, 1e38}
    assert abs(float(third)) < 1e9


def test_a_trip_queues_a_fault_and_a_dropped_output_tells_nothing(bench: Bench) -> None:
    for fault, queued, set_point in (("trip", "502", 1e-3), ("calibrator_drops", "0", 0.0)):
        bench.send("switch", ":CLOS (@1!1!1)")
        bench.send("calibrator", "OUT 1.0E-03 A, 0 HZ", "OPER")
        bench.clock.sleep(10.0)
        assert bench.ask("calibrator", "ISR?") == "4097"
        bench.world.switches.switch(fault)
        assert bench.ask("calibrator", "ISR?") == "4096"
        assert bench.ask("calibrator", "FAULT?") == queued
        assert float(bench.ask("calibrator", "OUT?").split(",")[0]) == set_point
        assert bench.world.wiring.loop_current_A == 0.0


def test_a_chamber_that_runs_away_is_stopped_by_stop_alone(bench: Bench) -> None:
    world = bench.world
    for operation in ("MRMP1,1.0", "SETP1,25", "RUNM"):
        bench.ask("chamber", operation)
    bench.clock.sleep(3600.0)
    world.switches.switch("chamber_runaway", 2.0)
    air = [float(world.thermal.air_degC(bench.clock.now_ns()))]
    for operation in ("SETP1,20", "HOLD", "RESM"):
        bench.clock.sleep(60.0)
        bench.ask("chamber", operation)
        air.append(float(world.thermal.air_degC(bench.clock.now_ns())))
    assert [b - a for a, b in pairwise(air)] == pytest.approx([2.0] * 3, abs=0.01)
    assert float(bench.ask("chamber", "PVAR1?")) == pytest.approx(air[-1], abs=0.5)
    assert bench.ask("chamber", "STOP") == "0"
    bench.clock.sleep(3600.0)
    assert float(world.thermal.air_degC(bench.clock.now_ns())) < air[-1]


def test_a_runaway_ends_with_its_fault_and_a_chamber_falls_short(bench: Bench) -> None:
    for operation in ("MRMP1,1.0", "SETP1,25", "RUNM"):
        bench.ask("chamber", operation)
    bench.world.switches.switch("chamber_runaway", 2.0)
    bench.clock.sleep(600.0)
    bench.world.switches.switch("chamber_runaway", "off")
    bench.clock.sleep(7200.0)
    assert float(bench.world.thermal.air_degC(bench.clock.now_ns())) == pytest.approx(25.0, abs=1e-6)
    for operation in ("MRMP1,1.0", "SETP1,30", "RUNM"):
        bench.ask("chamber", operation)
    bench.world.switches.switch("chamber_shortfall", 3)
    bench.clock.sleep(7200.0)
    assert float(bench.world.thermal.air_degC(bench.clock.now_ns())) == pytest.approx(27.0, abs=1e-6)


def test_a_lost_reference_is_in_the_questionable_status(bench: Bench) -> None:
    bench.send("counter", "ROSC:SOUR EXT")
    assert int(bench.ask("counter", "STAT:QUES:EVEN?")) == 0
    bench.world.switches.switch("reference_lost")
    assert int(bench.ask("counter", "STAT:QUES:EVEN?")) == 1 << 10
    bench.world.switches.switch("reference_lost", "off")
    assert int(bench.ask("counter", "STAT:QUES:EVEN?")) == 0


@pytest.mark.parametrize(
    ("words", "code", "hint"),
    [
        (("mutt", "dmm"), "B-SIM-010", "did you mean 'mute'"),
        (("table_stall", 1), "B-SIM-010", "use one of: bit_errors"),  # a fault of an instrument that is not there
        (("mute", "dmmm"), "B-SIM-011", "did you mean 'dmm'"),
        (("mute",), "B-SIM-011", "use one of: calibrator"),
        (("drop", "dmm", 0.1), "B-SIM-011", "use one of: port_a, port_b"),
        (("drop", "port_a", 1.5), "B-SIM-012", "number from 0 to 1"),
        (("drop", "port_a", "nan"), "B-SIM-012", "number from 0 to 1"),
        (("drop", "port_a"), "B-SIM-012", "bench sim fault"),
        (("late", "dmm", 1, 2.5), "B-SIM-012", "whole number"),
        (("late", "dmm", 1, 2, 3), "B-SIM-012", "bench sim fault"),
        (("stuck", "port_a", "xyz"), "B-SIM-012", "hexadecimal"),
        (("identity", "dmm", "\n"), "B-SIM-012", "printable"),
        (("trip", "now"), "B-SIM-012", "bench sim fault"),
    ],
)
def test_mistakes_are_one_clear_error(bench: Bench, words: tuple[Any, ...], code: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        bench.world.switches.switch(*words)
    assert caught.value.code == code
    assert hint in str(caught.value)
    assert bench.world.switches.on == []


def test_a_random_schedule_is_the_same_for_a_seed_and_every_entry_is_possible(bench: Bench) -> None:
    arguments = (36_000.0, tuple(DRIVERS), ("port_a", "port_b"), 60.0)
    entries = random_schedule(7, *arguments)
    assert entries == random_schedule(7, *arguments)
    assert entries != random_schedule(8, *arguments)
    assert 500 < len(entries) < 700
    assert {entry.name for entry in entries} == set(DRAWS)
    schedule(bench.world, entries)
    bench.clock.sleep(40_000.0)  # an entry that is not possible would raise here
    bench.world.switches.clear()
    assert bench.world.switches.on == []
    assert not bench.world.faults.link("port_a").active


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


def test_link_faults_have_their_rates_and_are_each_links_own() -> None:
    n, length = 200_000, 57
    faults = LinkFaults(6, "port_a", bit_error_rate=1e-4, drop_rate=0.01, duplicate_rate=0.02)
    copies = faults.copies(0, n)
    assert (copies == 0).mean() == pytest.approx(0.01, rel=0.1)
    assert (copies == 2).mean() == pytest.approx(0.02 * 0.99, rel=0.1)
    bits = np.unpackbits(faults.flips(0, n, length)).sum()
    assert bits / (n * length * 8) == pytest.approx(1e-4, rel=0.02)
    a, b, other = (LinkFaults(seed, name, drop_rate=0.5) for seed, name in ((1, "a"), (1, "b"), (2, "a")))
    assert not np.array_equal(a.copies(0, 1000), b.copies(0, 1000))
    assert not np.array_equal(a.copies(0, 1000), other.copies(0, 1000))
    faults = LinkFaults(1, "port_a")
    assert not faults.active
    assert np.array_equal(faults.copies(0, 100), np.ones(100))
    assert not faults.flips(0, 100, 57).any()
    faults.silent = True
    assert faults.active
    assert not faults.copies(0, 100).any()


def test_coming_trip_bounds_the_quiet_time(bench: Bench) -> None:
    seen = []
    trip_calibrator(bench.world, 100 * NS)
    bench.clock.every(40.0, lambda: seen.append(bench.clock.quiet_until_ns()))
    bench.clock.sleep_until_ns(150 * NS)
    assert seen == [100 * NS, 100 * NS, 150 * NS]


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
