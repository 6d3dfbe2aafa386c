"""Simulated instruments by their commands: what manuals promise, forms that public drivers use, what is refused.

A row is a dialogue: `` | `` stands between its lines, ``@supply`` turns to an instrument, ``QUESTION -> REPLY`` is
exact but for what ``...`` leaves out, ``QUESTION ~ 5.0 0.01`` a number within a tolerance, ``!-113`` the next error of
the queue, ``stb&4 -> 4`` a serial poll, ``wait 2.5`` seconds of bench time; anything else is sent.
Sources: the manuals named in ``instruments/*.yaml``.
"""

from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa
from sim_bench import ADDRESS, DRIVERS, Bench, open_bench, simulated, timed_out

from sim_instruments.fluke_5720a import parse_value

SCPI_ROLES = [role for role in DRIVERS if role not in ("calibrator", "dmm", "chamber")]


def talk(bench: Bench, dialogue: str, role: str = "") -> None:
    """Go through a dialogue line by line."""
    for line in dialogue.split(" | "):
        question, arrow, reply = line.partition(" -> ")
        asked, about, numbers = line.partition(" ~ ")
        if line.startswith("@"):
            role = line[1:]
        elif line.startswith("wait "):
            bench.clock.sleep(float(line[5:]))
        elif line.startswith("!"):
            assert bench.ask(role, "SYST:ERR?").partition(",")[0] in (line[1:], f"+{line[1:]}"), dialogue
        elif line.startswith("stb&"):
            assert bench[role].read_stb() & int(question[4:]) == int(reply), dialogue
        elif arrow:
            told = bench.ask(role, question).rstrip("\r\n")
            assert (told[: len(reply) - 3] + "..." if reply.endswith("...") else told) == reply, dialogue
        elif about:
            value, _, tolerance = numbers.partition(" ")
            wanted = pytest.approx(float(value), abs=float(tolerance) if tolerance else None)
            assert float(bench.ask(role, asked)) == wanted, (dialogue, asked)
        else:
            bench.send(role, line)


HEADERS = ("VOLT", "volt", "VOLTage", ":VOLT", ":SOURce:VOLTage:LEVel", "SOUR:VOLT", "VOLT:LEV")
BAD_NUMBERS = (("", -109), ("five", -104), ("nan", -222), ("1e9", -222))
BAD_POINTS = {"(@1!5!1)": -222, "(@1!1!11)": -222, "(@2!1!1)": -222, "(@1!1)": -102, "1!1!1": -104, "": -109}
GENERATOR = [
    ("SOUR1:FREQ 2.5 kHz", "SOURce1:FREQuency?", 2500.0), ("FREQ 3MHZ", "FREQ?", 3e6), ("FREQ 1E3HZ", "FREQ1?", 1000.0),
    ("OUTP:LOAD INF;:VOLT 2 VPP", "SOUR:VOLT?", 2.0), ("VOLT:OFFS 100 mV", "VOLT:OFFS?", 0.1),
    ("OUTP1 ON", "OUTPUT1:STAT?", 1.0), ("FUNC SQU;FUNC:SQU:DCYC 40", "FUNC:SQU:DCYC?", 40.0),
    ("BURS:STAT 1", "SOUR1:BURS:STAT?", 1.0), ("AM:STAT ON;:FM:STAT ON", "AM:STAT?", 0.0),
    ("FUNC SIN;:VOLT 1 VRMS", "VOLT?", 2.8284), ("FUNC SQU;:VOLT:UNIT VRMS;:VOLT 1", "VOLT?", 1.0),
    ("FUNC SIN;:VOLT 0 DBM", "VOLT?", 0.6325),  # 1 mW in 50 ohm: 0.2236 V RMS
    ("OUTP:LOAD 50;:VOLT:UNIT DBM;:OUTP:LOAD INF;:VOLT 4", "VOLT?", 4.0), ("BURS:NCYC INF", "BURS:NCYC?", 9.9e37),
]  # fmt: skip
NOT_BY_GENERATOR = [
    ("FREQ 1 V", -131), ("FREQ 1 qHz", -131), ("FUNC:SQU:DCYC 40 V", -138), ("SOUR2:FREQ 1", -113),
    ("OUTP:LOAD INF;:VOLT:UNIT DBM", -221), ("VOLT 25 DBM", -222), ("PULS:PER 1E-3;WIDT 2E-3", -222),
    ("FUNC DC;:BURS:STAT ON", -221), ("SWE:STAT ON;:FUNC NOIS", -221), ("FUNC SQU;FUNC:SQU:DCYC 80;:FREQ 6E7", -221),
]  # fmt: skip
TEN_MHZ = "@function_generator | FUNC SQU | OUTP:LOAD INF | FREQ 1.0E+07 | VOLT 5 | OUTP ON"
TRIPS = (("VOLT:PROT 16", "1"), ("CURR:PROT:STAT ON | CURR 0.3", "2"))
JUNCTION = "SENS:TEMP:TRAN:TC:RJUN"
CALIBRATOR_FAULTS = [
    ("OUT 3 A, 0 HZ", 705), ("OUT 1.0E-02 A, 50 HZ", 704), ("OUT ten A", 703), ("OUT 1 HZ", 707), ("NONSENSE", 702),
    ("RANGELCK MAYBE", 701), ("EXPLAIN? 9999", 703), ("LIMIT -1 A, 1 A", 704),
]  # fmt: skip
ROUTED = "@switch | :CLOS (@1!1!1) | @calibrator"
OPEN_CIRCUIT = "OUT 1.0E-02 A, 0 HZ | OPER | ISR? -> 4096 | stb&8 -> 8 | FAULT? -> 501"
OPEN_CIRCUIT += ' | EXPLAIN? 501 -> "Compliance Voltage Exceeded" | stb&8 -> 0'
SENT = "INBUF ON|CSB|OFORMAT ASCII|TERM 2|MFORMAT ASCII|QFORMAT NUM|SETACV SYNC|ACBAND 10,1.2e6|ACV AUTO|LFILTER ON|"
SENT += "FUNC DCV,AUTO|OHMF 10E3|OCOMP 1|APER 0.6|NPLC 0.0005|AZERO 1|FIXEDZ OFF|DISP MSG,'A B'|DISP 0|MATH NULL|"
SENT += "MATH 0,0|MEM OFF|SSDC 0.1|SWEEP 1E-8,500|SLOPE POS|SSRC EXT|ARANGE OFF|DELAY 0|NRDGS 1,1|LFREQ LINE|DCI 1E-6|"
SENT += "RANGE 0.01;RES 0.00001|TRIG SYN|TARM HOLD|TRIG AUTO|END 2|RQS 0|EMASK 32767|LOCK OFF|SMATH SCALE 2|MMATH OFF"
ASKED = "ID RANGE ARANGE NPLC APER TARM TRIG END OFORMAT MFORMAT MEM ISCALE AZERO DISP MSIZE TEMP LFREQ LINE NDIG OCOMP"
ASKED = " | ".join(f"{word}? -> ..." for word in f"{ASKED} DELAY INBUF MATH REV OPT STB CALNUM QFORMAT".split())
MOST_FAULTS = " | ".join([*["NONSENSE"] * 7, *["OUT x A"] * 13, *["FAULT? -> 702"] * 7, *["FAULT? -> 703"] * 8])

DIALOGUES = {
    **{f"errors of the {role}": f"@{role} | !0 | NONSENSE 1 | *ESE 400 | !-113 | !-222 | !0" for role in SCPI_ROLES},
    **{f"header {header}": f"@supply | {header} 5 | VOLT? -> 5.00000E+00 | !0" for header in HEADERS},
    **{f"no header {header}": f"@supply | {header} 5 | !-113"
       for header in ("VOLTA", "VOL", "VOLT:LEVE", "SOURC:VOLT", "VOLT?:LEV")},
    "headers go on from the last node": "@counter | FREQ:GATE:SOUR TIME;TIME 2.5 | !0 | FREQ:GATE:TIME? ~ 2.5",
    "a measurement of another channel, and back": "@counter | CONF:FREQ 10E6,1E-3,(@2) | FUNC? -> \"FREQ 2\" | "
        "MEAS:FREQ? (@1) ~ 9.91e37 | FUNC? -> \"FREQ 1\" | MEAS:FREQ? (@9) | !-224",
    "messages are joined and events collected": "@supply | VOLT:PROT 21;*ESE 4;:VOLT 9 | !0 | "
        "VOLT:PROT?;:VOLT?;*ESE? -> 2.10000E+01;9.00000E+00;4 | *ESR? -> 128 | NONSENSE | VOLT 1e9 | *OPC | "
        "*ESR? -> 49 | *ESR? -> 0",
    **{f"bad number {text!r}": f"@supply | VOLT 5 | VOLT {text} | !{number} | VOLT? -> 5.00000E+00"
       for text, number in BAD_NUMBERS},
    "options and version": "@counter | *OPT? -> 0 | @supply | SYST:VERS? -> 1999.0",
    "crosspoints are closed, opened and told": "@switch | :CLOS (@1!1!3) | :CLOS (@1!2!3) | :CLOS (@1!1!10) | "
        ":CLOS:STAT? -> (@1!1!3,1!1!10,1!2!3) | :OPEN (@1!1!3) | :ROUT:CLOS:STAT? -> (@1!1!10,1!2!3) | :OPEN ALL | "
        ":CLOS:STAT? -> (@) | :CLOS (@1!1!9:1!2!1, 1!4!4) | :CLOS:STAT? -> (@1!1!9,1!1!10,1!2!1,1!4!4) | "
        ":CLOS? (@1!1!1,1!1!9) -> 0,1 | :OPEN? (@1!1!1,1!1!9) -> 1,0",
    "what is not closed, what is and in which turn": "@switch | :FCH (@1!2!3) | :CLOS (@1!2!1:1!2!3) | !-221 | *RST | "
        ":CONF:SLOT1:POLE 4 | :CLOS (@1!1!3) | :CLOS:STAT? -> (@1!1!3,1!3!3) | :CONF:SLOT1:CTYP C7011 | :CLOS (@1!1!4) "
        "| !-222 | *RST | :SCAN (@1!1!1,1!2!2) | :INIT | :CLOS:STAT? -> (@1!1!1) | wait 3 | :CLOS:STAT? -> (@1!2!2)",
    **{f"bad crosspoint {points!r}": f"@switch | :CLOS (@1!1!1) | :CLOS {points} | !{number} | :CLOS:STAT? -> (@1!1!1)"
       for points, number in BAD_POINTS.items()},
    "errors of the meter": "@dmm | END ALWAYS | NONSENSE | NPLC lots | DCI 5 | stb&32 -> 32 | "
        'ERRSTR? -> 103,"SYNTAX ERROR" | ERRSTR? -> 105,"UNDEFINED PARAMETER RECEIVED" | '
        'ERRSTR? -> 106,"PARAMETER OUT OF RANGE" | ERRSTR? -> 0,"NO ERROR" | stb&32 -> 0',
    "what public drivers of the meter send and ask": f"@dmm | END ALWAYS | {SENT.replace('|', ' | ')} | ERR? -> 0 | "
        f"{ASKED} | FUNC? -> 6,  1.00000000E-02 | NRDGS? -> 1, 1 | TERM? -> 1 | RMATH SCALE ~ 2 | CAL? 72,1 -> ... | "
        "NDIG 9 | ERR? -> 64 | ACAL DCV | stb&16 -> 0 | wait 165 | stb&16 -> 16",
    "over 120 percent of its range the meter is overloaded": f"{ROUTED} | OUT 13 MA, 0 HZ | OPER | wait 10 | @dmm | "
        "END ALWAYS;DCI 0.01;NPLC 1;TRIG HOLD | TRIG SGL ~ 1e38 | DCI 0.1 | TRIG SGL ~ 0.013 1.3e-6",
    "on hold the meter takes no reading": "@dmm | TARM HOLD | TRIG SGL | wait 9 | stb&128 -> 0",
    **{f"generator: {command}": f"@function_generator | {command} | {query} ~ {value} | !0"
       for command, query, value in GENERATOR},
    **{f"not by the generator: {command}": f"@function_generator | {command} | !{number}"
       for command, number in NOT_BY_GENERATOR},
    **{f"beyond the generator: {command}": f"{TEN_MHZ} | {command} | !-222 | FREQ? ~ 1e7 | VOLT? ~ 5"
       for command in ("FREQ 90E6", "VOLT 21", "FREQ 0")},
    "APPLy sets a waveform and switches it on":
        "@function_generator | APPL:SQU 12345678, 2, 0 | FREQ? -> +1.2345678000000E+07 | OUTP? -> 1",
    "an amplitude is that at its load": "@function_generator | OUTP:LOAD 50 | VOLT 1 | OUTP:LOAD INF | VOLT? ~ 2.0",
    "an armed trigger sets levels": "@supply | VOLT 5 | VOLT:TRIG 7 | *TRG | VOLT? ~ 5 | INIT:NAME TRAN | ABOR | "
        "*TRG | VOLT? ~ 5 | INIT:NAME TRAN | *TRG | VOLT? ~ 7 | INIT:CONT:SEQ1 ON | VOLT:TRIG 8 | *TRG | VOLT? ~ 8",
    **{f"{trip} latches until it is cleared": f"@supply | CURR 2 | {trip} | VOLT 18 | OUTP ON | wait 0.1 | "
        f"STAT:QUES:COND? -> {condition} | CURR 2 | VOLT:PROT 20 | MEAS:VOLT? ~ 0 0.01 | OUTP:PROT:CLE | "
        "STAT:QUES:COND? -> 0 | MEAS:VOLT? ~ 18 0.01" for trip, condition in TRIPS},
    "the selected rail is hidden, and ranges differ": "@aux_supply | INST:NSEL 2 | VOLT 15 | INST:SEL N25V | "
        "VOLT -15 | INST:NSEL 1 | VOLT 15 | !-222 | APPL P6V, 5.0, 1.0 | OUTP ON | MEAS:VOLT? P6V ~ 5 0.01 | "
        "MEAS:VOLT? P25V ~ 15 0.01 | MEAS:VOLT? N25V ~ -15 0.01 | INST? -> P6V | MEAS:CURR? ~ 0.2 0.001 | "
        "STAT:QUES:INST:ISUM1:COND? -> 2 | CURR 0.1 | STAT:QUES:INST:ISUM1:COND? -> 1",
    "the rail meter reads the first rail": "@rail_dmm | FETC? | !-230 | INIT | FETC? ~ 0 1e-3 | CONF:VOLT:DC | "
        "READ? ~ 0 1e-3 | @aux_supply | APPL P6V, 5.0, 1.0 | OUTP ON | @rail_dmm | READ? ~ 5 0.005 | CONF:VOLT:DC 1 | "
        "READ? ~ 9.9e37",
    "what is not at the terminals of the meter": "@rail_dmm | CONF:FREQ | CONF? -> \"FREQ ... | "
        "CONF:CURR:AC 1 | CONF? -> \"CURR:AC ... | CONF:VOLT:DC:RAT | CONF? -> \"VOLT:RAT ... | "
        "CONF:DIOD | CONF? -> \"DIOD\" | MEAS:CONT? ~ 9.9e37 | "
        "CONF:CURR 10 | !-222 | CONF:VOLT:DC | TRIG:COUN INF | SAMP:COUN 600 | TRIG:COUN 1 | INIT | !531 | "
        "SAMP:COUN 1 | TRIG:COUN INF | INIT | !531",
    "a thermocouple with a fixed junction is wrong": f"@logger | {JUNCTION}:TYPE INT,(@102) | "
        f"CONF:TEMP TC,T,(@101:103) | {JUNCTION}:TYPE? (@101:103) -> FIX,INT,FIX | {JUNCTION}? (@101) -> "
        f"+0.00000000E+00 | ROUT:SCAN (@101) | READ? ~ 0 1.0 | {JUNCTION} 30.0,(@101) | READ? ~ 30 1.0 | "
        f"{JUNCTION}:TYPE EXT,(@101) | READ? ~ 9.9e37 | {JUNCTION}:TYPE INT,(@101) | READ? ~ 23 1.0 | "
        f"{JUNCTION} 81,(@101) | !-222 | {JUNCTION}:TYPE ICE,(@101) | !-224",
    "open leads are overload": "@rail_dmm | MEAS:FRES? 1000 ~ 9.9e37 | @logger | MEAS:FRES? 1000,(@104) ~ 9.9e37",
    **{f"channel {channel} senses": f"@logger | CONF:FRES 100,(@{channel}) | !308 | CONF:RES 100,(@{channel}) | !0"
       for channel in (111, 120, 320)},
    "a channel is configured anew": "@logger | ROUT:SCAN (@121) | !-222 | MEAS:VOLT:DC? 10,(@106) ~ 0 1e-3 | "
        "CALC:SCAL:OFFS 5;STAT ON | READ? ~ 5 1e-3 | FRES:NPLC 1 | !-221 | MEAS:TEMP? TC,T,(@106) ~ 0 1 | "
        "UNIT:TEMP F | READ? ~ 32 2 | ROUT:CHAN:DEL 2;DEL:AUTO? -> 0 | CONF:RES (@106) | ROUT:CHAN:DEL:AUTO? -> 1",
    "nothing is set while a scan runs": "@logger | INIT | !113 | ROUT:SCAN (@102,101) | ROUT:SCAN? -> #210(@101,102) | "
        "TRIG:SOUR BUS | READ? | !-214 | TRIG:SOUR TIM;TIM 2;COUN 3 | INIT | CONF:RES (@101) | !261 | READ? | !261 | "
        "TRIG:COUN? ~ 3 | ABOR | TRIG:COUN 1 | INIT | FETC? -> ... | INST:DMM OFF | CONF:VOLT:DC (@101) | !225",
    "a 3800 misses what comes in the second after an operation":
        "@chamber | MRMP1,0.5 | SETP1,-10 | wait 1 | MRMP1? -> 0.5 | SETP1? -> 23.0",
    "the calibrator at power-on": "@calibrator | ISR? -> 4096 | FAULT? -> 0 | OUT? -> 0.0000000E+00,V,0.00E+00 | "
        "RANGELCK? -> OFF",
    "zero into an open circuit stays on": "@calibrator | OUT 0 A, 0 HZ | OPER | wait 5 | ISR? -> 4097",
    "it settles in its time, and later in another range":
        f"{ROUTED} | OUT 1.0E-03 A, 0 HZ | OPER | ISR? -> 1 | wait 2.98 | ISR? -> 1 | wait 0.02 | ISR? -> 4097 | "
        "OUT 2.0E-03 A, 0 HZ | wait 3.1 | ISR? -> 4097 | OUT 1.0E-02 A, 0 HZ | wait 3.1 | ISR? -> 1 | wait 2 | "
        "ISR? -> 4097",
    "an open circuit trips": f"@calibrator | {OPEN_CIRCUIT}",
    "the auxiliary terminals are an open circuit": f"{ROUTED} | CUR_POST AUX | {OPEN_CIRCUIT}",
    "a voltage into the current input trips":
        f"{ROUTED} | OUT 5 V, 0 HZ | OPER | ISR? -> 4096 | FAULT? -> 503 | FAULT? -> 0",
    **{f"fault of {command}": f"@calibrator | OUT 1.0E-03 A, 0 HZ | {command} | FAULT? -> {fault} | FAULT? -> 0 | "
       "OUT? -> 1.0000000E-03,A,0.00E+00" for command, fault in CALIBRATOR_FAULTS},
    "an entry limit is kept": "@calibrator | LIMIT 0.25 A, -0.25 A | OUT 0.3 A, 0 HZ | FAULT? -> 705 | FAULT? -> 0 | "
        "OUT 0.2 A, 0 HZ | FAULT? -> 0 | LIMIT? -> 2.500E-01,-2.500E-01",
    "faults are queued to fifteen and lost with the status":
        f"@calibrator | {MOST_FAULTS} | FAULT? -> 601 | FAULT? -> 0 | NONSENSE | *CLS | FAULT? -> 0",
    "high voltage is inhibited while a fault is queued": "@calibrator | OUT 22 V, 0 HZ | NONSENSE | OPER | "
        "ISR? -> 4096 | FAULT? -> 702 | FAULT? -> 708 | FAULT? -> 0 | OPER | ISR? -> 4097",
    "a locked range is not exceeded": "@calibrator | OUT 1.0E-02 A, 0 HZ | RANGELCK ON | OUT 0 A, 0 HZ | "
        "OUT 1.0E-01 A, 0 HZ | FAULT? -> 706 | FAULT? -> 0 | OUT? -> 0.0000000E+00,A,0.00E+00",
    "a set-point has the steps of its range":
        "@calibrator | OUT 1.00000012345E-03 A, 0 HZ | OUT? -> 1.0000000E-03,A,0.00E+00",
}  # fmt: skip


@pytest.mark.parametrize("name", DIALOGUES)
def test_a_dialogue(bench: Bench, name: str) -> None:
    talk(bench, DIALOGUES[name])


@pytest.mark.parametrize(
    ("operation", "completion"),
    [("MRMP1,0.5", "0"), ("SETP1,-10", "0"), ("RUNM", "0"), ("SETP1,-99", "5"), ("HOLD", "2"), ("NONS", "1")],
)
def test_8800_answers_every_operation(operation: str, completion: str) -> None:
    with open_bench(instruments={"chamber": {"dialect": "8800"}}) as bench:
        talk(bench, f"@chamber | {operation} -> {completion}")


@pytest.mark.parametrize("role", SCPI_ROLES)
def test_a_full_error_queue_says_overflow_in_its_last_place(bench: Bench, role: str) -> None:
    length = bench.world.instruments[role].queue_length
    talk(bench, " | ".join([*["NONSENSE"] * (length + 5), *["!-113"] * (length - 1), "!-350", "!0"]), role)


def test_a_card_in_another_slot() -> None:
    with open_bench(instruments={"switch": {"slot": 4}}) as bench:
        talk(bench, "@switch | :CLOS (@4!1!2)")
        assert bench.unit.inputs[2] is not None
        talk(bench, "@switch | :CLOS (@1!1!3) | !-222")


def test_end_is_off_at_power_on_so_a_reply_never_ends(bench: Bench) -> None:
    bench["dmm"].read_termination = None
    bench["dmm"].write("ID?")
    assert timed_out(bench["dmm"].read)
    talk(bench, "@dmm | END ALWAYS | ID? -> HP3458A")


def test_a_reading_of_100_cycles_with_autozero_takes_four_seconds(bench: Bench) -> None:
    dmm = bench["dmm"]
    talk(bench, "@dmm | PRESET NORM | INBUF ON | END ALWAYS | DCI 0.1 | NPLC 100 | NDIG 8 | AZERO ON | TRIG HOLD")
    assert dmm.read_stb() == 16
    began_ns = bench.clock.now_ns()
    talk(bench, "@dmm | TRIG SGL | stb&128 -> 0")
    dmm.timeout = 10_000
    dmm.read()
    assert bench.clock.now_ns() - began_ns == pytest.approx(4e9, abs=1e7)


def test_without_its_buffer_the_meter_holds_the_bus(bench: Bench) -> None:
    talk(bench, "@dmm | PRESET NORM | END ALWAYS | DCI 0.1 | NPLC 100 | TRIG HOLD | TRIG SGL")
    bench["dmm"].timeout = 1000
    assert timed_out(bench["dmm"].read_stb)


def test_frequency_reaches_the_unit_with_an_error_within_3_ppm() -> None:
    errors_ppm = []
    for seed in range(50):
        with open_bench(seed=seed) as bench:
            talk(bench, TEN_MHZ)
            errors_ppm.append((bench.unit.fg[-1][1] / 1e7 - 1) * 1e6)
    assert 1.5 < max(errors_ppm) <= 3.0
    assert -3.0 <= min(errors_ppm) < -1.5


def test_a_frequency_reaches_the_unit_with_enough_amplitude_only(bench: Bench) -> None:
    talk(bench, TEN_MHZ)
    assert bench.unit.fg[-1][1] > 0
    for commands in ("VOLT 0.4", "VOLT 5 | OUTP OFF"):
        talk(bench, commands, "function_generator")
        assert bench.unit.fg[-1][1] == 0.0


def test_a_counter_without_a_signal_tells_no_number_behind_its_gate(bench: Bench) -> None:
    bench["counter"].timeout = 5000
    talk(bench, "@counter | FREQ:GATE:TIME 1 | READ? ~ 9.91e37")
    assert bench.clock.now_ns() > 2e9


def test_a_supply_powers_the_unit_up_to_its_20_volts(bench: Bench) -> None:
    measured = "OUTP ON | MEAS:VOLT? ~ 18 0.01 | MEAS:CURR? ~ 1.25 2e-3"
    talk(bench, f"@supply | CURR 2 | VOLT:PROT 20 | VOLT 18 | {measured} | VOLT 19 | OUTP OFF | VOLT 28 | !-222")
    assert [powered for _, *powered in bench.unit.power[-3:]] == [[True, 18.0], [True, 19.0], [False, 0.0]]


@pytest.mark.parametrize("commands", ["VOLT 11 | OUTP ON", "CURR 1.2 | VOLT 18 | OUTP ON", "VOLT 18"])
def test_unit_stays_off_without_enough_voltage_or_current(bench: Bench, commands: str) -> None:
    talk(bench, f"@supply | CURR 2 | {commands}")
    assert [on for _, on, _ in bench.unit.power if on] == []


def test_thermocouples_hang_in_the_laboratory_the_chamber_and_on_the_unit(bench: Bench) -> None:
    thermal = bench.world.thermal
    thermal.ramp(50.0, 5.0, 0)
    bench.clock.sleep(1200.0)
    readings = bench.ask("logger", "CONF:TEMP TC,T,(@101:103)", f"{JUNCTION}:TYPE INT,(@101:103)", "READ?").split(",")
    now_ns = bench.clock.now_ns()
    true = [float(of(now_ns)) for of in (thermal.lab_degC, thermal.air_degC, thermal.unit_degC)]
    assert [float(r) for r in readings] == pytest.approx(true, abs=1.0)
    assert true[1] - true[2] > 10


def test_operation_complete_waits_until_settled(bench: Bench) -> None:
    bench["calibrator"].timeout = 10_000
    talk(bench, "@switch | :CLOS (@1!1!1)")
    before_ns = bench.clock.now_ns()
    talk(bench, "@calibrator | OUT 1.0E-03 A, 0 HZ | OPER | *OPC? -> 1 | ISR? -> 4097")
    assert bench.clock.now_ns() - before_ns == pytest.approx(3e9, abs=2e7)


@pytest.mark.parametrize(
    ("current", "index"),
    [("0", 0), ("2.2E-4", 0), ("2.21E-4", 1), ("2.2E-3", 1), ("2.0E-2", 2), ("0.2", 3), ("0.299", 4), ("-0.2", 3)],
)
def test_the_lowest_range_that_holds_unless_it_is_locked(bench: Bench, current: str, index: int) -> None:
    calibrator = bench.world.instruments["calibrator"]
    talk(bench, f"@calibrator | OUT {current} A, 0 HZ")
    assert calibrator.range_index == index
    for lock, expected in (("ON", index), ("OFF", 0)):
        talk(bench, f"@calibrator | RANGELCK {lock} | OUT 0 A, 0 HZ")
        assert calibrator.range_index == expected


def test_reset_goes_to_standby(bench: Bench) -> None:
    talk(bench, f"{ROUTED} | OUT 1.0E-02 A, 0 HZ | OPER | wait 10 | *RST | ISR? -> 4096")
    assert bench.unit.inputs[1] == bench.world.wiring.leakage_A[0, 0]


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("1.0E-02 A", 0.01, "A"), ("10 MA", 0.01, "A"), ("10MA", 0.01, "A"), ("30 UA", 3e-5, "A"),
        ("1 MAOHM", 1e6, "OHM"), ("1 KOHM", 1e3, "OHM"), ("2 MV", 2e-3, "V"), ("3 MAV", 3e6, "V"), ("0 HZ", 0.0, "HZ"),
        ("-5", -5.0, ""),
    ],
)  # fmt: skip
def test_multipliers_ma_is_milli_only_for_amperes(text: str, value: float, unit: str) -> None:
    assert parse_value(text) == (pytest.approx(value), unit)


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
