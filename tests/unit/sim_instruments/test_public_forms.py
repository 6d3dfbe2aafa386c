"""Forms of commands that manuals allow and public drivers use, and our own drivers do not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa
from sim_bench import Bench
from simulated_alone import ADDRESS, simulated


@pytest.mark.parametrize(
    ("command", "query", "value"),
    [
        ("SOUR1:FREQ 2.5 kHz", "SOURce1:FREQuency?", 2500.0),
        ("FREQ 3MHZ", "FREQ?", 3e6),
        ("FREQ 1E3HZ", "FREQ1?", 1000.0),
        ("OUTP:LOAD INF;:VOLT 2 VPP", "SOUR:VOLT?", 2.0),
        ("VOLT:OFFS 100 mV", "VOLT:OFFS?", 0.1),
        ("OUTP1 ON", "OUTPUT1:STAT?", 1.0),
        ("FUNC SQU;FUNC:SQU:DCYC 40", "FUNC:SQU:DCYC?", 40.0),
        ("BURS:STAT 1", "SOUR1:BURS:STAT?", 1.0),
        ("AM:STAT ON;:FM:STAT ON", "AM:STAT?", 0.0),
        ("FUNC SIN;:VOLT 1 VRMS", "VOLT?", 2.8284),
        ("FUNC SQU;:VOLT:UNIT VRMS;:VOLT 1", "VOLT?", 1.0),
        ("FUNC SIN;:VOLT 0 DBM", "VOLT?", 0.6325),  # 1 mW in 50 ohm: 0.2236 V RMS
        ("OUTP:LOAD 50;:VOLT:UNIT DBM;:OUTP:LOAD INF;:VOLT 4", "VOLT?", 4.0),
        ("BURS:NCYC INF", "BURS:NCYC?", 9.9e37),
    ],
)
def test_a_generator_takes_suffixes_units_and_modes(bench: Bench, command: str, query: str, value: float) -> None:
    bench.send("function_generator", command)
    assert float(bench.ask("function_generator", query)) == pytest.approx(value)
    assert bench.ask("function_generator", "SYST:ERR?").startswith("+0")


@pytest.mark.parametrize(
    ("command", "number"),
    [
        ("FREQ 1 V", "-131"),
        ("FREQ 1 qHz", "-131"),
        ("FUNC:SQU:DCYC 40 V", "-138"),
        ("SOUR2:FREQ 1", "-113"),
        ("OUTP:LOAD INF;:VOLT:UNIT DBM", "-221"),
        ("VOLT 25 DBM", "-222"),
    ],
)
def test_what_a_generator_refuses_it_refuses_with_its_code(bench: Bench, command: str, number: str) -> None:
    bench.send("function_generator", command)
    assert bench.ask("function_generator", "SYST:ERR?").startswith(number)


def test_a_multimeter_is_configured_for_what_is_not_at_its_terminals(bench: Bench) -> None:
    for function, text in (
        ("FREQ", '"FREQ '),
        ("CURR:AC 1", '"CURR:AC '),
        ("DIOD", '"DIOD"'),
        ("VOLT:DC:RAT", '"VOLT:RAT '),
    ):
        bench.send("rail_dmm", f"CONF:{function}")
        assert bench.ask("rail_dmm", "CONF?").startswith(text)
    assert float(bench.ask("rail_dmm", "MEAS:CONT?")) == 9.9e37
    bench.send("rail_dmm", "CONF:CURR 10")
    assert bench.ask("rail_dmm", "SYST:ERR?").startswith("-222")
    bench.send("rail_dmm", "CONF:VOLT:DC", "TRIG:COUN INF", "SAMP:COUN 600", "TRIG:COUN 1", "INIT")
    assert bench.ask("rail_dmm", "SYST:ERR?").startswith("+531")
    bench.send("rail_dmm", "SAMP:COUN 1", "TRIG:COUN INF", "INIT")
    assert bench.ask("rail_dmm", "SYST:ERR?").startswith("+531")


def test_a_trigger_sets_the_levels_of_the_supply_only_when_it_is_armed(bench: Bench) -> None:
    bench.send("supply", "VOLT 5", "VOLT:TRIG 7", "*TRG")
    assert float(bench.ask("supply", "VOLT?")) == 5.0
    bench.send("supply", "INIT:NAME TRAN", "ABOR", "*TRG")
    assert float(bench.ask("supply", "VOLT?")) == 5.0
    bench.send("supply", "INIT:NAME TRAN", "*TRG")
    assert float(bench.ask("supply", "VOLT?")) == 7.0


def test_every_scpi_model_tells_options_and_version(bench: Bench) -> None:
    assert bench.ask("counter", "*OPT?") == "0"
    assert bench.ask("supply", "SYST:VERS?") == "1999.0"


@pytest.fixture
def lock_in() -> Iterator[Any]:
    with simulated("srs_sr830") as world:
        visa = pyvisa.ResourceManager(world.visa_library)
        yield visa.open_resource(ADDRESS, read_termination="\n", write_termination="\n")
        visa.close()


def test_each_answer_of_a_chain_of_the_sr830_has_its_own_terminator(lock_in: Any) -> None:
    lock_in.write("OUTX1;PHAS45.00;SENS22")
    lock_in.write("PHAS?;SENS?")
    assert [lock_in.read(), lock_in.read()] == ["45.00", "22"]


@pytest.mark.parametrize(
    ("message", "reply"),
    [
        ("SRAT 4;SRAT?", "4"), ("SLVL0.5;SLVL?", "0.500"), ("DDEF1,1,0;DDEF?1", "1,0"), ("*STB?", "0"),
        ("AUXV 2,-1.5;AUXV? 2", "-1.500"), ("FMOD 1;FREQ 137.5;FREQ?", "137.5"), ("OAUX?1", "0"),
        ("HARM 2;HARM?", "2"),
    ],
)  # fmt: skip
def test_settings_of_the_sr830_that_public_drivers_use(lock_in: Any, message: str, reply: str) -> None:
    lock_in.write("*CLS")
    assert lock_in.query(message) == reply
    assert int(lock_in.query("*ESR?")) & 0b110000 == 0


def test_a_snapshot_of_the_sr830_takes_two_to_six_of_eleven_quantities(lock_in: Any) -> None:
    lock_in.write("*CLS")
    assert len(lock_in.query("SNAP?1,2,5,8,10,11").split(",")) == 6
    for wrong in ("SNAP?1", "SNAP?1,12"):
        lock_in.write(wrong)
        assert int(lock_in.query("*ESR?")) & 16
