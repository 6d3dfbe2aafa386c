"""PyVISA backend @bench: pyvisa-sim's own promises, and what live instruments add to them."""

import time
from pathlib import Path

import pytest
import pyvisa
from pyvisa.constants import AccessModes, StatusCode
from pyvisa.errors import VisaIOError
from pyvisa_sim.devices import Device
from sim_bench import ADDRESSES, DRIVERS, Bench, open_bench

from sim_instruments.bus.backend import BenchVisaLibrary

NS = 1_000_000_000


def test_simulators_do_not_hide_attributes_of_the_pyvisa_sim_device() -> None:
    plain = {name for name in vars(Device("plain", b";")) if name.startswith("_")}
    plain |= {name for name in vars(Device) if name.startswith("_match")}
    with open_bench() as bench:
        for device in bench.world.instruments.values():
            shadowed = {name for cls in type(device).__mro__ for name in vars(cls) if cls.__module__[:3] == "sim"}
            assert not plain & shadowed, type(device)
            assert isinstance(device._channels, dict)
            assert isinstance(device._error_queues, dict)


def test_each_instrument_is_at_its_address_and_nowhere_else(bench: Bench) -> None:
    assert set(bench.manager.list_resources()) == set(ADDRESSES.values())
    for role in DRIVERS:
        question = {"dmm": "ID?", "chamber": "IDEN?"}.get(role, "*IDN?")
        assert DRIVERS[role].rpartition("_")[2].upper()[:4] in bench.ask(role, question).upper()
    assert type(bench.manager.visalib) is BenchVisaLibrary
    assert bench.world.id not in bench["calibrator"].query("*IDN?")
    assert bench["switch"].resource_name == ADDRESSES["switch"]
    for resource in ("GPIB0::29::INSTR", "GPIB0::INTFC"):
        with pytest.raises(VisaIOError) as caught:
            bench.manager.open_resource(resource)
        assert caught.value.error_code == StatusCode.error_resource_not_found


def test_what_is_no_open_world_opens_nothing() -> None:
    with open_bench() as bench:
        library = bench.manager.visalib
    manager = pyvisa.ResourceManager(library)
    with pytest.raises(VisaIOError) as caught:
        manager.open_resource(ADDRESSES["switch"])
    assert caught.value.error_code == StatusCode.error_resource_not_found
    manager.close()
    with pytest.raises(FileNotFoundError):
        pyvisa.ResourceManager("w0@bench")


def test_timeouts_and_latencies_pass_on_the_clock_of_the_world(bench: Bench) -> None:
    bench["calibrator"].timeout = 2000
    before_ns, real_s = bench.clock.now_ns(), time.perf_counter()
    with pytest.raises(VisaIOError) as caught:
        bench["calibrator"].read()
    assert caught.value.error_code == StatusCode.error_timeout
    assert bench.clock.now_ns() - before_ns == 2 * NS
    assert time.perf_counter() - real_s < 1.0
    before_ns = bench.clock.now_ns()
    bench.ask("calibrator", "ISR?")
    assert bench.clock.now_ns() - before_ns == 4_000_000


def test_the_serial_poll_shows_messages_errors_and_service_requests(bench: Bench) -> None:
    switch = bench["switch"]
    assert switch.read_stb() == 0
    switch.write(":CLOS (@1!1!11)")
    assert switch.read_stb() == 4
    switch.write("SYST:ERR?")
    assert switch.read_stb() == 16
    assert switch.read() == '-222,"Parameter data out of range"'
    assert switch.read_stb() == 0
    bench.send("supply", "*CLS", "*SRE 4", "NONSENSE")
    assert bench["supply"].read_stb() == 64 | 4


def test_a_stale_reply_is_dropped_and_told(bench: Bench) -> None:
    bench["switch"].write("*IDN?")
    bench["switch"].clear()
    assert bench["switch"].read_stb() == 0
    assert bench.ask("switch", "SYST:ERR?") == '0,"No error"'
    bench["supply"].write("*IDN?")
    assert bench.ask("supply", "VOLT?") == "0.00000E+00"
    assert bench.ask("supply", "SYST:ERR?") == '-410,"Query INTERRUPTED"'
    with pytest.raises(VisaIOError):
        bench["supply"].read()
    assert bench.ask("supply", "SYST:ERR?") == '-420,"Query UNTERMINATED"'


def test_messages_and_replies_are_joined_and_read_in_parts(bench: Bench) -> None:
    bench["supply"].send_end = False
    bench["supply"].write_raw(b"VO")
    bench["supply"].write_raw(b"LT?\n")
    assert bench["supply"].read() == "0.00000E+00"
    assert bench.ask("supply", "VOLT 5;CURR 1;VOLT?;CURR?") == "5.00000E+00;1.00000E+00"
    assert bench["supply"].read_stb() == 0
    assert bench.ask("calibrator", "ISR?;FAULT?;*STB?") == "4096;0;0"
    assert bench["calibrator"].read_stb() == 0
    counter = bench["counter"]
    counter.write("*IDN?")
    assert counter.read_bytes(7) == b"Agilent"
    assert counter.read_raw().endswith(b"-35\n")
    counter.read_termination = ","
    counter.write("*IDN?")
    assert [counter.read(), counter.read()] == ["Agilent Technologies", "53230A"]


def test_exclusive_lock_keeps_another_session_out(bench: Bench) -> None:
    first = bench["calibrator"]
    second = bench.manager.open_resource(ADDRESSES["calibrator"], read_termination="\n")
    first.lock_excl()
    first.lock_excl()
    before_ns = bench.clock.now_ns()
    for use in (lambda: second.query("ISR?"), second.clear, second.read_stb, lambda: second.lock_excl(1500)):
        with pytest.raises(VisaIOError) as caught:
            use()
        assert caught.value.error_code == StatusCode.error_resource_locked
    assert bench.clock.now_ns() - before_ns == 1.5 * NS
    first.unlock()
    with pytest.raises(VisaIOError):
        second.query("ISR?")
    first.unlock()
    assert second.query("ISR?") == "4096"
    with pytest.raises(VisaIOError) as caught:
        first.unlock()
    assert caught.value.error_code == StatusCode.error_session_not_locked


def test_a_shared_lock_is_shared_by_key_and_given_back_by_closing(bench: Bench) -> None:
    holder = bench.manager.open_resource(ADDRESSES["switch"], access_mode=AccessModes.exclusive_lock)
    with pytest.raises(VisaIOError):
        bench["switch"].query("*IDN?")
    holder.close()
    assert bench.ask("switch", "*IDN?").startswith("KEITHLEY")
    others = [bench.manager.open_resource(ADDRESSES["switch"], read_termination="\n") for _ in range(2)]
    key = bench["switch"].lock(requested_key=None)
    assert others[0].lock(requested_key=key) == key
    with pytest.raises(VisaIOError):
        others[1].query("*IDN?")
    bench["switch"].close()
    others[0].close()
    assert others[1].query("*IDN?").startswith("KEITHLEY")


def test_pyvisa_sim_devices_still_refuse_what_only_live_ones_can(tmp_path: Path) -> None:
    plain = tmp_path / "plain.yaml"
    plain.write_text(
        'spec: "1.1"\ndevices:\n  d:\n    eom: {GPIB INSTR: {q: "\\n", r: "\\n"}}\n    error: ERROR\n'
        '    dialogues: [{q: "?IDN", r: "plain"}]\nresources:\n  GPIB0::3::INSTR: {device: d}\n'
    )
    manager = pyvisa.ResourceManager(f"{plain}@bench")
    resource = manager.open_resource("GPIB0::3::INSTR", read_termination="\n", write_termination="\n")
    assert resource.query("?IDN") == "plain"
    with pytest.raises(VisaIOError) as caught:
        resource.read_stb()
    assert caught.value.error_code == StatusCode.error_nonsupported_operation
    manager.close()
