"""Simulated instruments one by one: what their manuals promise, forms that public drivers use, declared hazards."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from sim_bench import DRIVERS, Bench, open_bench
from simulated_alone import ADDRESS, simulated

SCPI_ROLES = [role for role in DRIVERS if role not in ("calibrator", "dmm", "chamber")]


def error(bench: Bench, role: str) -> int:
    return int(bench.ask(role, "SYST:ERR?").split(",")[0])


# --- what all SCPI models share --------------------------------------------------------------------------------------


@pytest.mark.parametrize("role", SCPI_ROLES)
def test_error_queue_is_real(bench: Bench, role: str) -> None:
    assert error(bench, role) == 0
    bench.send(role, "NONSENSE 1", "*ESE 400")
    assert [error(bench, role) for _ in range(3)] == [-113, -222, 0]


@pytest.mark.parametrize("role", SCPI_ROLES)
def test_full_error_queue_says_overflow_in_its_last_place(bench: Bench, role: str) -> None:
    length = bench.world.instruments[role].queue_length
    bench.send(role, *["NONSENSE"] * (length + 5))
    numbers = [error(bench, role) for _ in range(length + 1)]
    assert numbers == [-113] * (length - 1) + [-350, 0]


@pytest.mark.parametrize(
    "header", ["VOLT", "volt", "VOLTage", ":VOLT", ":SOURce:VOLTage:LEVel", "SOUR:VOLT", "VOLT:LEV"]
)
def test_short_long_and_optional_forms_of_a_header(bench: Bench, header: str) -> None:
    assert bench.ask("supply", f"{header} 5", "VOLT?") == "5.00000E+00"
    assert error(bench, "supply") == 0


@pytest.mark.parametrize("header", ["VOLTA", "VOL", "VOLT:LEVE", "SOURC:VOLT", "VOLT?:LEV"])
def test_forms_between_short_and_long_are_unknown(bench: Bench, header: str) -> None:
    bench.send("supply", f"{header} 5")
    assert error(bench, "supply") == -113


def test_headers_go_on_from_the_last_node_and_events_are_collected(bench: Bench) -> None:
    bench.send("counter", "FREQ:GATE:SOUR TIME;TIME 2.5")
    assert error(bench, "counter") == 0
    assert float(bench.ask("counter", "FREQ:GATE:TIME?")) == 2.5
    bench.send("supply", "VOLT:PROT 21;*ESE 4;:VOLT 9")
    assert error(bench, "supply") == 0
    assert bench.ask("supply", "VOLT:PROT?;:VOLT?;*ESE?") == "2.10000E+01;9.00000E+00;4"
    assert bench.ask("supply", "*ESR?") == "128"
    bench.send("supply", "NONSENSE", "VOLT 1e9", "*OPC")
    assert bench.ask("supply", "*ESR?") == str(32 | 16 | 1)
    assert bench.ask("supply", "*ESR?") == "0"


@pytest.mark.parametrize(("parameter", "number"), [("", -109), ("five", -104), ("nan", -222), ("1e9", -222)])
def test_bad_numbers_are_refused_and_leave_the_setting(bench: Bench, parameter: str, number: int) -> None:
    bench.send("supply", "VOLT 5", f"VOLT {parameter}")
    assert error(bench, "supply") == number
    assert bench.ask("supply", "VOLT?") == "5.00000E+00"


# --- switch ----------------------------------------------------------------------------------------------------------


def test_crosspoints_are_closed_opened_and_told(bench: Bench) -> None:
    bench.send("switch", ":CLOS (@1!1!3)", ":CLOS (@1!2!3)", ":CLOS (@1!1!10)")
    assert bench.ask("switch", ":CLOS:STAT?") == "(@1!1!3,1!1!10,1!2!3)"
    bench.send("switch", ":OPEN (@1!1!3)")
    assert bench.ask("switch", ":ROUT:CLOS:STAT?") == "(@1!1!10,1!2!3)"
    bench.send("switch", ":OPEN ALL")
    assert bench.ask("switch", ":CLOS:STAT?") == "(@)"
    bench.send("switch", ":CLOS (@1!1!9:1!2!1, 1!4!4)")
    assert bench.ask("switch", ":CLOS:STAT?") == "(@1!1!9,1!1!10,1!2!1,1!4!4)"
    assert bench.ask("switch", ":CLOS? (@1!1!1,1!1!9)") == "0,1"
    assert bench.ask("switch", ":OPEN? (@1!1!1,1!1!9)") == "1,0"


@pytest.mark.parametrize(
    ("points", "number"),
    [("(@1!5!1)", -222), ("(@1!1!11)", -222), ("(@2!1!1)", -222), ("(@1!1)", -102), ("1!1!1", -104), ("", -109)],
)
def test_bad_crosspoints_move_nothing(bench: Bench, points: str, number: int) -> None:
    bench.send("switch", ":CLOS (@1!1!1)", f":CLOS {points}")
    assert error(bench, "switch") == number
    assert bench.ask("switch", ":CLOS:STAT?") == "(@1!1!1)"


def test_card_in_another_slot() -> None:
    with open_bench(instruments={"switch": {"slot": 4}}) as bench:
        bench.send("switch", ":CLOS (@4!1!2)")
        assert bench.unit.inputs[2] is not None
        bench.send("switch", ":CLOS (@1!1!3)")
        assert error(bench, "switch") == -222


# --- multimeter 3458A ------------------------------------------------------------------------------------------------


def test_end_is_off_at_power_on_so_a_reply_never_ends(bench: Bench) -> None:
    dmm = bench["dmm"]
    dmm.read_termination = None
    dmm.write("ID?")
    with pytest.raises(VisaIOError) as caught:
        dmm.read()
    assert caught.value.error_code == StatusCode.error_timeout
    assert bench.ask("dmm", "END ALWAYS", "ID?") == "HP3458A\r\n"


def test_reading_of_100_cycles_with_autozero_takes_four_seconds(bench: Bench) -> None:
    dmm = bench["dmm"]
    bench.send("dmm", "PRESET NORM", "INBUF ON", "END ALWAYS", "DCI 0.1", "NPLC 100", "NDIG 8", "AZERO ON", "TRIG HOLD")
    assert dmm.read_stb() == 16
    began_ns = bench.clock.now_ns()
    bench.send("dmm", "TRIG SGL")
    assert dmm.read_stb() & 128 == 0
    dmm.timeout = 10_000
    dmm.read()
    assert bench.clock.now_ns() - began_ns == pytest.approx(4e9, abs=1e7)


def test_without_its_input_buffer_the_meter_holds_the_bus_until_its_reading_is_done(bench: Bench) -> None:
    dmm = bench["dmm"]
    bench.send("dmm", "PRESET NORM", "END ALWAYS", "DCI 0.1", "NPLC 100", "TRIG HOLD", "TRIG SGL")
    dmm.timeout = 1000
    with pytest.raises(VisaIOError) as caught:
        dmm.read_stb()
    assert caught.value.error_code == StatusCode.error_timeout


def test_over_120_percent_of_range_is_overload(bench: Bench) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", "OUT 1.3E-02 A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)
    assert float(bench.ask("dmm", "END ALWAYS;DCI 0.01;NPLC 1;TRIG HOLD", "TRIG SGL;RANGE?")) > 0
    bench.send("dmm", "TRIG SGL")
    assert float(bench["dmm"].read()) == 1e38
    bench.send("dmm", "DCI 0.1", "TRIG SGL")
    assert float(bench["dmm"].read()) == pytest.approx(0.013, rel=1e-4)


def test_errors_of_the_multimeter(bench: Bench) -> None:
    bench.send("dmm", "END ALWAYS", "NONSENSE", "NPLC lots", "DCI 5")
    assert bench["dmm"].read_stb() & 32
    texts = [bench.ask("dmm", "ERRSTR?").strip() for _ in range(4)]
    assert texts == [
        '103,"SYNTAX ERROR"',
        '105,"UNDEFINED PARAMETER RECEIVED"',
        '106,"PARAMETER OUT OF RANGE"',
        '0,"NO ERROR"',
    ]
    assert bench["dmm"].read_stb() & 32 == 0


def test_trigger_arm_on_hold_takes_no_reading(bench: Bench) -> None:
    bench.send("dmm", "END ALWAYS", "TARM HOLD", "TRIG SGL")
    with pytest.raises(VisaIOError):
        bench["dmm"].read()


# --- function generator and counter ----------------------------------------------------------------------------------


def drive_10_MHz(bench: Bench) -> None:
    bench.send("function_generator", "FUNC SQU", "OUTP:LOAD INF", "FREQ 1.0E+07", "VOLT 5", "OUTP ON")


def test_frequency_reaches_the_unit_with_an_error_within_3_ppm() -> None:
    errors_ppm = []
    for seed in range(50):
        with open_bench(seed=seed) as bench:
            drive_10_MHz(bench)
            errors_ppm.append((bench.unit.fg[-1][1] / 1e7 - 1) * 1e6)
    assert max(abs(e) for e in errors_ppm) <= 3.0
    assert max(errors_ppm) > 1.5
    assert min(errors_ppm) < -1.5


def test_a_frequency_reaches_the_unit_at_the_amplitude_of_its_load(bench: Bench) -> None:
    drive_10_MHz(bench)
    assert bench.unit.fg[-1][1] > 0
    bench.send("function_generator", "VOLT 0.4")
    assert bench.unit.fg[-1][1] == 0.0
    bench.send("function_generator", "VOLT 5", "OUTP OFF")
    assert bench.unit.fg[-1][1] == 0.0
    generator = bench.world.instruments["function_generator"]
    bench.send("function_generator", "OUTP:LOAD 50", "VOLT 1")
    assert generator.open_amplitude_V == 2.0
    bench.send("function_generator", "OUTP:LOAD INF")
    assert float(bench.ask("function_generator", "VOLT?")) == 2.0
    bench.send("function_generator", "VOLT 1")
    assert generator.open_amplitude_V == 1.0
    bench.send("function_generator", "APPL:SQU 12345678, 2, 0")
    assert bench.ask("function_generator", "FREQ?") == "+1.2345678000000E+07"
    assert bench.ask("function_generator", "OUTP?") == "1"


@pytest.mark.parametrize("command", ["FREQ 90E6", "VOLT 21", "FREQ 0"])
def test_generator_refuses_what_it_cannot(bench: Bench, command: str) -> None:
    drive_10_MHz(bench)
    bench.send("function_generator", command)
    assert error(bench, "function_generator") == -222
    assert float(bench.ask("function_generator", "FREQ?")) == 1e7
    assert float(bench.ask("function_generator", "VOLT?")) == 5.0


def test_a_counter_reads_the_true_frequency_after_its_gate_or_no_number_late(bench: Bench) -> None:
    bench["counter"].timeout = 5000
    assert float(bench.ask("counter", "FREQ:GATE:TIME 1", "READ?")) == 9.91e37
    assert bench.clock.now_ns() > 2e9
    drive_10_MHz(bench)
    bench["counter"].timeout = 5000
    bench.send("counter", "ROSC:SOUR EXT", 'FUNC "FREQ 1"', "FREQ:GATE:TIME 1")
    began_ns = bench.clock.now_ns()
    frequency_Hz = float(bench.ask("counter", "READ?"))
    assert bench.clock.now_ns() - began_ns == pytest.approx(1e9, abs=1e7)
    assert frequency_Hz == pytest.approx(bench.unit.fg[-1][1], rel=6e-9)


# --- supplies, logger, rail meter ------------------------------------------------------------------------------------


def test_a_supply_powers_the_unit_up_to_its_20_volts(bench: Bench) -> None:
    bench.send("supply", "CURR 2", "VOLT:PROT 20", "VOLT 18", "OUTP ON")
    assert bench.unit.power[-1][1:] == (True, 18.0)
    assert float(bench.ask("supply", "MEAS:VOLT?")) == pytest.approx(18.0, abs=0.01)
    assert float(bench.ask("supply", "MEAS:CURR?")) == pytest.approx(1.25, abs=2e-3)
    bench.send("supply", "VOLT 19")
    assert bench.unit.power[-1][1:] == (True, 19.0)
    bench.send("supply", "OUTP OFF")
    assert bench.unit.power[-1][1:] == (False, 0.0)
    bench.send("supply", "VOLT 28")
    assert error(bench, "supply") == -222


@pytest.mark.parametrize("commands", [("VOLT 11", "OUTP ON"), ("CURR 1.2", "VOLT 18", "OUTP ON"), ("VOLT 18",)])
def test_unit_stays_off_without_enough_voltage_or_current(bench: Bench, commands: tuple[str, ...]) -> None:
    bench.send("supply", "CURR 2", *commands)
    assert [on for _, on, _ in bench.unit.power if on] == []


@pytest.mark.parametrize(("trip", "condition"), [(("VOLT:PROT 16",), "1"), (("CURR:PROT:STAT ON", "CURR 0.3"), "2")])
def test_protection_latches_until_cleared(bench: Bench, trip: tuple[str, ...], condition: str) -> None:
    bench.send("supply", "CURR 2", *trip, "VOLT 18", "OUTP ON")
    bench.clock.sleep(0.1)  # the delay of the protection
    assert bench.ask("supply", "STAT:QUES:COND?") == condition
    bench.send("supply", "CURR 2", "VOLT:PROT 20")
    assert abs(float(bench.ask("supply", "MEAS:VOLT?"))) < 0.01
    bench.send("supply", "OUTP:PROT:CLE")
    assert bench.unit.power[-1][1] is True
    assert bench.ask("supply", "STAT:QUES:COND?") == "0"


def test_selected_rail_is_hidden_state_and_ranges_differ(bench: Bench) -> None:
    bench.send("aux_supply", "INST:NSEL 2", "VOLT 15", "INST:SEL N25V", "VOLT -15", "INST:NSEL 1", "VOLT 15")
    assert error(bench, "aux_supply") == -222
    bench.send("aux_supply", "APPL P6V, 5.0, 1.0", "OUTP ON")
    assert [float(bench.ask("aux_supply", f"MEAS:VOLT? {rail}")) for rail in ("P6V", "P25V", "N25V")] == (
        pytest.approx([5.0, 15.0, -15.0], abs=0.01)
    )
    assert bench.ask("aux_supply", "INST?") == "P6V"
    assert float(bench.ask("aux_supply", "MEAS:CURR?")) == pytest.approx(0.2, abs=1e-3)


def test_the_rail_meter_reads_the_first_rail_and_nothing_before_a_measurement(bench: Bench) -> None:
    bench.send("rail_dmm", "FETC?")
    assert error(bench, "rail_dmm") == -230
    bench.send("rail_dmm", "INIT")
    assert abs(float(bench.ask("rail_dmm", "FETC?"))) < 1e-3
    bench.send("rail_dmm", "CONF:VOLT:DC")
    assert abs(float(bench.ask("rail_dmm", "READ?"))) < 1e-3
    bench.send("aux_supply", "APPL P6V, 5.0, 1.0", "OUTP ON")
    assert float(bench.ask("rail_dmm", "READ?")) == pytest.approx(5.0, abs=0.005)
    assert float(bench.ask("rail_dmm", "CONF:VOLT:DC 1", "READ?")) == 9.9e37


def test_thermocouples_hang_in_the_laboratory_the_chamber_and_on_the_unit(bench: Bench) -> None:
    bench.world.thermal.ramp(50.0, 5.0, 0)
    bench.clock.sleep(1200.0)
    readings = bench.ask("logger", "CONF:TEMP TC,T,(@101:103)", "UNIT:TEMP C,(@101:103)", "READ?").split(",")
    now_ns = bench.clock.now_ns()
    true = [float(f(now_ns)) for f in (bench.world.thermal.lab_degC, bench.world.thermal.air_degC)]
    true.append(float(bench.world.thermal.unit_degC(now_ns)))
    assert [float(r) for r in readings] == pytest.approx(true, abs=1.0)
    assert true[1] - true[2] > 10


def test_a_thermocouple_with_a_fixed_junction_is_wrong_and_a_plain_channel_reads_a_voltage(bench: Bench) -> None:
    junction = "SENS:TEMP:TRAN:TC:RJUN"
    bench.send("logger", f"{junction}:TYPE FIX,(@101)", f"{junction} 0.0,(@101)", "CONF:TEMP TC,T,(@101:103)")
    assert bench.ask("logger", f"{junction}:TYPE? (@101:103)") == "FIX,INT,INT"
    assert bench.ask("logger", f"{junction}? (@101)") == "+0.00000000E+00"
    assert float(bench.ask("logger", "ROUT:SCAN (@101)", "READ?")) == pytest.approx(0.0, abs=1.0)
    bench.send("logger", f"{junction} 30.0,(@101)")
    assert float(bench.ask("logger", "READ?")) == pytest.approx(30.0, abs=1.0)
    bench.send("logger", f"{junction}:TYPE EXT,(@101)")
    assert float(bench.ask("logger", "READ?")) == 9.9e37
    bench.send("logger", f"{junction}:TYPE INT,(@101)")
    assert float(bench.ask("logger", "READ?")) == pytest.approx(23.0, abs=1.0)
    for wrong, number in ((f"{junction} 81,(@101)", -222), (f"{junction}:TYPE ICE,(@101)", -224)):
        bench.send("logger", wrong)
        assert error(bench, "logger") == number
    assert abs(float(bench.ask("logger", "ROUT:SCAN (@105)", "READ?"))) < 1e-3
    bench.send("logger", "ROUT:SCAN (@121)")
    assert error(bench, "logger") == -222


# --- chamber ---------------------------------------------------------------------------------------------------------


def test_3800_misses_what_comes_in_the_second_after_an_operation(bench: Bench) -> None:
    bench.send("chamber", "MRMP1,0.5", "SETP1,-10")
    bench.clock.sleep(1.0)
    assert bench.ask("chamber", "MRMP1?") == "0.5"
    assert bench.ask("chamber", "SETP1?") == "23.0"


@pytest.mark.parametrize(
    ("operation", "completion"),
    [("MRMP1,0.5", "0"), ("SETP1,-10", "0"), ("RUNM", "0"), ("SETP1,-99", "5"), ("HOLD", "2"), ("NONS", "1")],
)
def test_8800_answers_every_operation(operation: str, completion: str) -> None:
    with open_bench(instruments={"chamber": {"dialect": "8800"}}) as bench:
        assert bench.ask("chamber", operation) == completion


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


def test_chains_and_snapshots_of_the_sr830(lock_in: Any) -> None:
    lock_in.write("OUTX1;PHAS45.00;SENS22")
    lock_in.write("PHAS?;SENS?")
    assert [lock_in.read(), lock_in.read()] == ["45.00", "22"]
    lock_in.write("*CLS")
    assert len(lock_in.query("SNAP?1,2,5,8,10,11").split(",")) == 6
    for wrong in ("SNAP?1", "SNAP?1,12"):
        lock_in.write(wrong)
        assert int(lock_in.query("*ESR?")) & 16


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
