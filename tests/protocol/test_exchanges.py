"""Exact exchanges of each driver, one row each: what it sends, what it makes of the reply, what it refuses.

How a row is read stands in ``tests/support/simulated/exchanges.py``; the pages of the manuals in the tables of the
models (``instruments/*.yaml``), in which every command of a row must stand.
"""

import threading
from unittest.mock import ANY

import pytest
from exchanges import Row, does, exchange, gives, refuses, row
from scripted import make, scripted

from bench.model.errors import InputError
from instruments.keithley_7002 import read_closed
from instruments.krohn_hite_3988 import Display, read_display

NS = 1_000_000_000
ROWS: list[Row] = []


NAME = "agilent_33250a"
PLAIN = "BURS:STAT? -> 0 | SWE:STAT? -> 1 | SWE:STAT OFF! | SWE:STAT? -> 0"
PLAIN += "".join(f" | {mode}:STAT? -> 0" for mode in ("AM", "FM", "FSK")) + " | FUNC:SQU:DCYC? -> +5.0000000000000E+01"
PLAIN += " | VOLT:OFFS? -> +0.0000000000000E+00 | FUNC? -> SIN"
BROUGHT = f"{PLAIN} | FUNC SQU! | FUNC? -> SQU | OUTP:LOAD? -> +9.9000000000000E+37 | VOLT:UNIT? -> VPP"
BROUGHT += " | VOLT:RANG:AUTO? -> 1 | OUTP:POL? -> NORM"
SQUARE = f"<start> | {BROUGHT} | FREQ 1.2345678E+07! | VOLT 2.5E+00!"
BACK = "FREQ? -> +1.234567800000E+07 | VOLT? -> +2.500000000000E+00"
ON_OFF = "OUTP ON! | OUTP? -> 1 | OUTP OFF! | OUTP? -> 0"
CONFLICT = f'<start> | {PLAIN} | FUNC SQU | SYST:ERR? -> -221,"Settings conflict" | <ok>'
ROWS += [
    row(NAME, "a frequency goes out with every digit", f"{SQUARE} | {BACK} | {BROUGHT} | {BACK} | {ON_OFF}",
        does("square", 12_345_678, 2.5), does("output_on"), does("output_off")),
    row(NAME, "a rounded frequency is noticed", f"{SQUARE} | FREQ? -> +1.23457E+07",
        refuses("B-INST-011", "12345678", "square", 12_345_678.0, 2.5)),
    row(NAME, "no output without a waveform", "", refuses("B-INST-010", "", "output_on")),
    row(NAME, "an error is told", CONFLICT, refuses("B-INST-005", "-221 Settings conflict", "square", 1e7, 2.5)),
]  # fmt: skip


NAME = "agilent_34401a"
FRONT = "ROUT:TERM? -> FRON"
VOLTS, OHMS = f"<start> | {FRONT} | CONF:VOLT:DC!", f"<start> | {FRONT} | CONF:FRES 1.0E+03! | FRES:NPLC 10!"
DOUBT = f"<start> | {FRONT} | CONF:FRES 1.0E+02 | SYST:ERR? -> <timeout> | <silent> | "
DOUBT += 'CONF? -> "FRES +1.000000E+02,+1.000000E-04"'
ROWS += [
    row(NAME, "an error of a reading is told",
        f'{VOLTS} | READ? ~> +5.0E+00 | SYST:ERR? -> +531,"Insufficient memory" | <ok>',
        refuses("B-INST-005", "531", "measure_voltage")),
    row(NAME, "rear terminals are not measured", "<start> | ROUT:TERM? -> REAR",
        refuses("B-INST-019", "terminals: .*REAR", "measure_voltage")),
    row(NAME, "open leads are no resistance", f"{OHMS} | READ? ~> +9.90000000E+37",
        refuses("B-INST-007", "", "measure_resistance", 1000.0, 10)),
    *[row(NAME, f"{range_ohm} ohm over {cycles} cycles is not sent", "",
          refuses("B-INST-008", "", "measure_resistance", range_ohm, cycles))
      for range_ohm, cycles in ((10.0, 10), (2e8, 10), (1000.0, 2), (1000.0, 0.02))],
    row(NAME, "a configuration in doubt is read back and not sent again",
        f"{DOUBT} | FRES:NPLC 1! | READ? ~> +1.0E+02 | <ok>", gives(100.0, "measure_resistance", 100.0, 1)),
]  # fmt: skip


NAME = "agilent_34970a"
JUNCTION = "TEMP:TRAN:TC:RJUN:TYPE? (@101,102)"
CONFIGURED = "<start> | CONF:TEMP TC,T,(@101,102)! | UNIT:TEMP? (@101,102) -> C,C | ZERO:AUTO? (@101,102) -> 1,1"
KEPT = (
    "UNIT:TEMP? (@203) -> K | UNIT:TEMP C,(@203)! | UNIT:TEMP? (@203) -> C | "
    "ZERO:AUTO? (@203) -> 0 | ZERO:AUTO ON,(@203)! | ZERO:AUTO? (@203) -> 1"
)
FIXED = f"{CONFIGURED} | {JUNCTION} -> FIX,FIX | TEMP:TRAN:TC:RJUN:TYPE INT,(@101,102)!"
CHECKED = (
    "TEMP:TRAN:TC:CHEC? (@101,102) -> 0,1 | TEMP:TRAN:TC:CHEC ON,(@101,102)! | TEMP:TRAN:TC:CHEC? (@101,102) -> 1, 1"
)
SCAN = f"{CONFIGURED} | {JUNCTION} -> INT,INT | TEMP:TRAN:TC:CHEC? (@101,102) -> 1,1"
TYPE_K = f"CONF:TEMP TC,K,(@203)! | {KEPT} | TEMP:TRAN:TC:RJUN:TYPE? (@203) -> INT | TEMP:TRAN:TC:CHEC? (@203) -> 1"
FOUR_WIRES = "CONF:FRES 1.0E+02,(@103)! | FRES:NPLC 10,(@103)!"
DOUBT = "CONF:FRES 1.0E+02,(@103) | SYST:ERR? -> <timeout> | <silent> | ROUT:SCAN? -> #16(@103)"
ONE_SHORT = "READ? ~> +2.3E+01 | <clear>"
ROWS += [
    row(NAME, "another channel and thermocouple", f"<start> | {TYPE_K} | READ? ~> +2.5E+01 | <ok>",
        gives([25.0], "scan"), channels=[203], thermocouple="K"),
    row(NAME, "junctions become internal, open thermocouples looked for",
        f"{FIXED} | {JUNCTION} -> INT, INT | {CHECKED} | READ? ~> +2.3E+01,+9.90000000E+37",
        refuses("B-INST-007", "", "scan")),
    row(NAME, "one that stays fixed is refused", f"{FIXED} | {JUNCTION} -> INT,FIX | {JUNCTION} -> INT,FIX",
        refuses("B-INST-011", "'INT,FIX' after 'TEMP.*: reference junction", "scan")),
    row(NAME, "without its multimeter it is refused", "<start:2> | INST:DMM? -> 0",
        refuses("B-INST-019", "internal multimeter.*INST:DMM ON", "identify")),
    row(NAME, "what was configured is not configured again",
        f'<start> | {DOUBT} | CONF? (@103) -> "FRES +1.0E+02,+1.0E-05" | FRES:NPLC 10,(@103)! | READ? ~> +1E+02 | <ok>',
        gives(100.0, "measure_resistance", 103, 100.0, 10)),
    row(NAME, "a missing reading is no scan", f"{SCAN} | {ONE_SHORT} | <ok> | {ONE_SHORT} | <ok> | {ONE_SHORT}",
        refuses("B-INST-004", "2 readings are due", "scan")),
    row(NAME, "open leads are no resistance", f"<start> | {FOUR_WIRES} | READ? ~> +9.90000000E+37",
        refuses("B-INST-007", "", "measure_resistance", 103, 100.0, 10)),
    *[row(NAME, f"channel {channel} senses for another and is not sent", "",
          refuses("B-INST-008", "", "measure_resistance", channel, 100.0, 10)) for channel in (100, 111, 120, 411)],
    *[row(NAME, f"no resistance where channel {channel} has a thermocouple", "",
          refuses("B-INST-008", "", "measure_resistance", 103, 100.0, 10), channels=[channel])
      for channel in (103, 113)],
    row(NAME, "without thermocouples nothing is configured and nothing scanned",
        f"<start> | {FOUR_WIRES} | READ? ~> +1.0E+02 | <ok>",
        gives(100.0, "measure_resistance", 103, 100.0, 10), refuses("B-INST-008", "", "scan"),
        thermocouple="none", channels=[]),
]  # fmt: skip


NAME = "agilent_53230a"
GATE = '<start> | FUNC? -> "FREQ" | FREQ:GATE:TIME 1.0E+00!'
NEVER = " | ".join(["READ?", *["<poll 0>"] * 13, "<silent>"])
NO_REFERENCE = '<start:3> | SYST:ERR? -> +1111,"External reference not found" | <ok> | <start>'
ROWS += [
    row(NAME, "a frequency has every digit", f"{GATE} | READ? ~> +1.000000012345E+07 | <ok>",
        gives(10000000.12345, "measure_frequency", 1.0), leaves={"test_clock.now_ns": NS // 4}),
    row(NAME, "a reading that never comes", f"{GATE} | {NEVER} | <ok> | {NEVER} | <ok> | {NEVER}",
        refuses("B-INST-001", r"'READ\?' within 3 s", "measure_frequency", 1.0),
        leaves={"test_clock.now_ns": 9 * NS}),
    row(NAME, "without a signal there is none", f"{GATE} | READ? ~> +9.91E+37",
        refuses("B-INST-007", "", "measure_frequency", 1.0)),
    *[row(NAME, f"reference {source}, events {events}",
          f"<start> | ROSC:SOUR? -> {source} | STAT:QUES:EVEN? -> +{events}", gives(locked, "reference_locked"))
      for source, events, locked in (("EXT", 0, True), ("EXT", 1024, False), ("INT", 0, False))],
    row(NAME, "without its reference it is not prepared", NO_REFERENCE,
        refuses("B-INST-005", "External reference", "identify"), does("identify")),
]  # fmt: skip


NAME = "agilent_e3631a"
SET = "CURR? -> +5.00000000E-01 | VOLT? -> -1.50000000E+01"
RAIL_3 = "<start> | INST:NSEL 3! | CURR 5.0E-01! | VOLT -1.5E+01!"
NOUGHT = "VOLT 0.0E+00! | VOLT? -> +0.00000000E+00"
OTHERS = f"INST:NSEL 1! | {NOUGHT} | INST:NSEL 2! | {NOUGHT} | INST:NSEL 3! | {SET} | OUTP ON! | OUTP? -> 1"
ROWS += [
    row(NAME, "the other rails are at nought before it is on",
        f"{RAIL_3} | {SET} | {OTHERS} | INST:NSEL 2! | MEAS:VOLT? -> +1.50012000E+01",
        does("configure", 3, -15.0, 0.5), does("output_on"), gives(15.0012, "measure_voltage", 2)),
    *[row(NAME, f"rail {rail} does not take {voltage} V, {limit} A", "",
          refuses("B-INST-008", f"rail {rail} takes", "configure", rail, voltage, limit))
      for rail, voltage, limit in
      ((1, 6.181, 1.0), (1, -0.001, 1.0), (2, 15.0, 1.031), (3, 0.001, 0.5), (2, -0.001, 0.5), (3, -15.0, 1.031))],
    *[row(NAME, f"rail {rail} takes {voltage}",
          f"<start> | INST:NSEL {rail}! | CURR {limit}E+00! | VOLT {voltage}! | CURR? -> {limit} | VOLT? -> {voltage}",
          does("configure", rail, float(voltage), limit))
      for rail, voltage, limit in
      ((1, "6.18E+00", 5.15), (1, "0.0E+00", 5.15), (2, "2.575E+01", 1.03), (3, "-2.575E+01", 1.03))],
    row(NAME, "no output before a rail is set", "", refuses("B-INST-010", "", "output_on")),
    row(NAME, "a lost set-point is noticed", f"{RAIL_3} | CURR? -> 0.5 | VOLT? -> -1.20000000E+01",
        refuses("B-INST-011", "", "configure", 3, -15.0, 0.5), leaves={"configured": {}}),
]  # fmt: skip


NAME = "hp_3458a"
SET_UP = "<start> | TERM? -> 1 | LFREQ LINE! | PRESET NORM! | INBUF ON! | DCI {}! | NPLC 100! | NDIG 8! | TRIG HOLD!"
READY = SET_UP + " | RANGE? ->  {}"
SINGLE = "TRIG SGL | <poll 16> | <poll 16> | <poll 16> | <poll 144> | <read>  1.000012345E-01 | <ok>"
ROWS += [
    row(NAME, "a reading is triggered and awaited by serial poll", f"{READY.format('1.0E-01', '1.0E-01')} | {SINGLE}",
        gives(0.1, "configure_current", 0.1), gives(0.1000012345, "measure_current"),
        leaves={"test_clock.now_ns": 3 * NS // 4, "identity.model": "3458A"}),
    *[row(NAME, f"{largest} A is within {sent}", READY.format(sent, sent), does("configure_current", largest))
      for largest, sent in
      ((0.2, "1.0E+00"), (1.05, "1.0E+00"), (3e-5, "1.0E-04"), (1e-9, "1.0E-07"),
       *((float(f"1.2e-{at}"), f"1.0E-0{at}") for at in range(1, 8)),
       *((float(f"1.201e-{at}"), f"1.0E-0{at - 1}") for at in range(2, 8)))],
    row(NAME, "a range that was not taken is noticed", READY.format("1.0E-03", "1.0E-02"),
        refuses("B-INST-011", "RANGE", "configure_current", 1e-3)),
    row(NAME, "an error is told", f'{SET_UP.partition("! | INB")[0]} | ERRSTR? -> 105,"INVALID PARAMETER -- X" | <ok>',
        refuses("B-INST-005", "105 INVALID PARAMETER -- X", "configure_current", 0.1)),
    row(NAME, "an overload is no reading", "<start> | TRIG SGL | <poll 128> | <read>  1.0E+38",
        refuses("B-INST-007", "", "measure_current")),
    row(NAME, "no reading within 15 s", " | ".join(["<start>", "TRIG SGL", *["<poll 16>"] * 61]),
        refuses("B-INST-012", "", "measure_current")),
    row(NAME, "how far it has drifted from its last autocalibration",
        '<start> | TEMP? ->  3.72000000E+01 | CAL? 175 -> 3.65E+01,"acal dcv temp"',
        gives((pytest.approx(0.7), 1.0, "degC", ANY), "self_calibration")),
]  # fmt: skip


NAME = "hp_6632b"
LIMITS = "CURR 1.5E+00! | INIT:CONT:SEQ1? -> 0 | ABOR! | CURR:PROT:STAT? -> 1 | OUTP:RI:MODE? -> LIVE"
LIMITS += " | OUTP:RI:MODE LATC! | OUTP:RI:MODE? -> LATC | OUTP:PROT:DEL 0.08! | VOLT? -> 5.0 | VOLT:PROT 1.8E+01!"
BACK = "CURR? -> 1.50000E+00 | VOLT:PROT? -> 1.80000E+01 | VOLT? -> 1.50000E+01"
CONFIGURED = f"<start> | {LIMITS} | VOLT 1.5E+01! | {BACK}"
ON, OFF = f"{CONFIGURED} | {BACK} | STAT:QUES:COND? -> 0 | OUTP ON!", "OUTP OFF! | OUTP? -> 0"
OUT_OF_RANGE = 'SYST:ERR? -> -222,"Data out of range" | <ok>'
CONFIGURE = does("configure", 15.0, 1.5, 18.0)
ROWS += [
    row(NAME, "limits come first and the output last",
        f"{ON} | OUTP? -> 1 | STAT:QUES:COND? -> 0 | MEAS:VOLT? -> +1.49991E+01 | MEAS:CURR? -> +4.20000E-01 | {OFF}",
        CONFIGURE, does("output_on"), gives(14.9991, "measure_voltage"), gives(0.42, "measure_current"),
        does("output_off"), leaves={"test_clock.now_ns": 90_000_000}),  # so long before its protections are asked
    *[row(NAME, f"protection {condition} that trips", f"{ON} | OUTP? -> 1 | STAT:QUES:COND? -> "
          f"{condition} | {OFF}", CONFIGURE, refuses("B-INST-018", what, "output_on"))
      for condition, what in ((1, "over-voltage"), (3, "over-voltage and over-current"))],
    row(NAME, "one that was left latched", f"{CONFIGURED} | {BACK} | STAT:QUES:COND? -> 512", CONFIGURE,
        refuses("B-INST-019", "inhibited output.*OUTP:PROT:CLE", "output_on")),
    row(NAME, "no output without limits", "", refuses("B-INST-010", "", "output_on")),
    row(NAME, "no limits that do not protect", "",
        refuses("B-INST-008", "not above voltage", "configure", 15.0, 1.5, 15.0),
        refuses("B-INST-008", r"28\.0 V is above 20\.475", "configure", 28.0, 1.5, 22.0)),
    row(NAME, "limits with an error stop before the voltage", f"<start> | CURR 1.5E+00 | {OUT_OF_RANGE}",
        refuses("B-INST-005", "-222", "configure", 15.0, 1.5, 18.0), leaves={"kept": ()}),
    row(NAME, "limits with an error do not count as set", f"{CONFIGURED} | CURR 1.0E+00 | {OUT_OF_RANGE}",
        CONFIGURE, refuses("B-INST-005", "", "configure", 15.0, 1.0, 18.0), refuses("B-INST-010", "", "output_on")),
    row(NAME, "an output that stays off is noticed", f"{ON} | OUTP? -> 0", CONFIGURE,
        refuses("B-INST-011", "", "output_on")),
    row(NAME, "an output that stays on is not safe", "<who> | OUTP OFF! | OUTP? -> 1",
        refuses("B-INST-009", "", "make_safe")),
]  # fmt: skip


NAME = "keithley_7002"
OPENED = "<start> | :OPEN ALL! | :CLOS:STAT? -> (@)"
QUEUE = 'SYST:ERR? -> -222,"Parameter data out of range" | SYST:ERR? -> -410,"x" | <ok>'
NO_LIST = ":CLOS:STAT? -> ERROR | <clear>"
ROWS += [
    *[row(NAME, f"channel {channel}, polarity {polarity} of slot {slot}",
          f"{OPENED} | :CLOS (@{point})! | :CLOS:STAT? -> (@{point})", does("route", channel, polarity),
          leaves={"test_clock.now_ns": NS // 2}, slot=slot)  # twice 250 ms for the relays
      for channel, polarity, slot, point in
      ((3, 1, 1, "1!1!3"), (3, -1, 1, "1!2!3"), (10, -1, 4, "4!2!10"), (1, 1, 10, "10!1!1"))],
    row(NAME, "a card is one of those that are wired", f"{OPENED} | :CLOS (@3!1!2)! | :CLOS:STAT? -> (@3!1!2)",
        does("route", 2, 1, 3), slot=[1, 3]),
    *[row(NAME, f"card {card} is none of them", "", refuses("B-INST-008", "", "route", 2, 1, card), slot=[1, 3])
      for card in (2, None)],
    *[row(NAME, f"another {found} than the route, after a reopening",
          f"{OPENED} | :CLOS (@1!1!3)! | :CLOS:STAT? -> (@1!1!3) | :CLOS:STAT? -> {found}", does("route", 3, 1),
          refuses("B-INST-015", "1!1!3 was verified", "_recheck")) for found in ("(@1!2!3)", "(@)")],
    row(NAME, "a relay that stays closed stops the second route", "<start> | :OPEN ALL! | :CLOS:STAT? -> (@1!2!7)",
        refuses("B-INST-015", "1!2!7", "route", 3, 1)),
    row(NAME, "a relay that stays closed is not safe", "<who> | :OPEN ALL! | :CLOS:STAT? -> (@1!1!3)",
        refuses("B-INST-009", "", "make_safe")),
    *[row(NAME, f"{found} is opened again", f"{OPENED} | :CLOS (@1!1!3)! | :CLOS:STAT? -> {found} | :OPEN ALL",
          refuses("B-INST-015", "", "route", 3, 1))
      for found in ("(@)", "(@1!1!3,1!2!3)", "(@1!1!4)", "(@1!1!3:1!1!4)")],
    row(NAME, "its error queue is read to the end", f"{OPENED} | :CLOS (@1!1!3) | {QUEUE}",
        refuses("B-INST-005", "-222 Parameter data out of range; -410 x", "route", 3, 1)),
    row(NAME, "what is no list of crosspoints", f"<start> | {NO_LIST} | <ok> | {NO_LIST} | <ok> | {NO_LIST}",
        refuses("B-INST-004", "", "closed")),
]  # fmt: skip


NAME = "krohn_hite_3988"
SENT = "CH 1;IG 0;OG 0;DC | CH 1;{0} | CH 2;IG 0;OG 0;DC | CH 2;{1}"
BAND = SENT.format("HP;BU;F 5.0E-01", "LP;BU;F 2.0E+00")
SHOWN = "CH 1 -> 00 .5000E+0 01.1 00 DC  | CH 2 -> 00 2.000E+0 02.1 00 DC "
ALONE = "CH 1 -> 00 .5000E+0 01.1 00 DC "
BY_PASSED = "CH 1 -> 00 byP      01.1 00 DC  | CH 2 -> 00 byP      02.1 00 DC*"
ROWS += [
    row(NAME, "a band of two octaves", f"<start> | {ALONE} | {BAND} | {SHOWN}", does("configure", 1.0),
        leaves={"wanted": (0.5, 2.0), "identity.firmware": "V3.5"}),
    row(NAME, "by-pass", f"<start> | {SENT.format('BY', 'BY')} | {BY_PASSED}", does("bypass"),
        leaves={"wanted": (None, None)}),
    row(NAME, "channels that are set together are refused", f"<start> | {ALONE[:-1]}*",
        refuses("B-INST-019", "(?s)all channels together.*front panel", "configure", 1.0)),
    *[row(NAME, f"{what} reads back different", f"<start> | {ALONE} | {BAND} | CH 1 -> {shown} ",
          refuses("B-INST-011", "channel 1", "configure", 1.0), leaves={"wanted": None})
      for what, shown in (
          ("its cutoff", "00 .6000E+0 01.1 00 DC"), ("its input gain", "10 .5000E+0 01.1 00 DC"),
          ("its output gain", "00 .5000E+0 01.1 06 DC"), ("its coupling", "00 .5000E+0 01.1 00 AC"),
          ("the channel", "00 .5000E+0 02.1 00 DC"), ("by-pass", "00 byP      01.1 00 DC"),
          ("a kilohertz", "00 .5000E+3 01.1 00 DC"))],
]  # fmt: skip


NAME = "leica_nivel_220"
IN_RANGE = "G P ~> \x16\x02C1N1 OK\x03"
MEASURED = [
    ("\x16\x02C1N1 X:+0.206 Y:-0.040 T:+23.8\x03", (0.206, -0.04, 23.8)),
    ("\x16\x02C1N1 X:-1.243 Y:0.587 T: 23.3\x03", (-1.243, 0.587, 23.3)),
    ("\x02Ñ\x16\x02C1N1 X:+0.206 Y:-0.040 T:+23.8\x03", (0.206, -0.04, 23.8)),  # behind the checksum of the last
]
NOT_MEASURED = {
    "no frame": "C1N1 X:+0.206 Y:-0.040 T:+23.8\x03",
    "another sensor": "\x16\x02C1N2 X:+0.206 Y:-0.040 T:+23.8\x03",
    "half a value": "\x16\x02C1N1 X:+0.206 Y:-0.0 T:\x03",
    "a value too few": "\x16\x02C1N1 X:+0.206 T:+23.8\x03",
    "an overload": "\x16\x02C1N1 X:+9.91E37 Y:-0.040 T:+23.8\x03",
}
ROWS += [
    *[row(NAME, f"measurement {number}", f"<start> | {IN_RANGE} | G A ~> {reply}",
          gives({"x_mrad": x, "y_mrad": y, "temperature_degC": degC}, "measure"))
      for number, (reply, (x, y, degC)) in enumerate(MEASURED)],
    row(NAME, "who it is", "<start>", does("identify"), gives([], "drain_errors"),
        leaves={"identity.serial": "000005", "identity.firmware": "1.0"}),
    row(NAME, "raw signals and another mode are set right", "<start:1> | RS C ~> \x16\x02C1N1 OFF\x03 | S C ON | "
        "RS C ~> \x16\x02C1N1 ON\x03 | RS M ~> \x16\x02C1N1 PRE\x03 | S M CONT | RS M ~> \x16\x02C1N1 CONT\x03 | "
        "R N ~> \x16\x02C1N1 008\x03", does("identify")),
    row(NAME, "it is out of its range", "<start> | G P ~> \x16\x02C1N1 F\x03",
        refuses("B-INST-019", "working range.*level the sensor", "measure")),
    *[row(NAME, f"{what} is no measurement", " | ".join(["<start>", IN_RANGE, *[f"G A ~> {reply}", "<clear>"] * 3]),
          refuses("B-INST-004", "", "measure")) for what, reply in NOT_MEASURED.items()],
]  # fmt: skip


NAME = "thermotron_3800"
BACK = "MRMP1? -> 0.5 | SETP1? -> -10.0"
START_8800, FREE = "IDEN? -> 8800 Chamber Controller | <ok>", "MODE? -> 2 | <ok>"
FREE_8800 = f"{FREE} | CCHR1? -> C | OPTN? -> 2"
SET = does("set_temperature", -10.0, 0.5)
OTHER_SET_POINT = f"<start> | {FREE} | MRMP1,0.5! | SETP1,-10! | MRMP1? -> 0.5 | SETP1? -> 23.0"
ALARMS = ["low deviation alarm", "high deviation alarm", "low process limit alarm", "high process limit alarm"]
ROWS += [
    row(NAME, "a 3800 answers nothing and gets more than a second",
        f"<start> | {FREE} | MRMP1,0.5! | SETP1,-10! | {BACK} | {FREE} | RUNM! | MODE? -> 16 | PVAR1? -> 22.87",
        SET, does("run"), gives(22.87, "measure_air"), leaves={"test_clock.now_ns": 3_600_000_000}),
    row(NAME, "completions of an 8800 are read",
        f"{START_8800} | {FREE_8800} | MRMP1,0.5 -> 0 | <ok> | SETP1,-10 -> 0 | <ok> | {BACK} | HOLD -> 0 | <ok> | "
        "MODE? -> 16 | STAT? -> 32 | STOP -> 0 | MODE? -> 2 | XYZ -> 0",
        SET, does("hold"), does("stop"), gives("0", "raw", "XYZ"), leaves={"test_clock.now_ns": 0}, dialect="8800"),
    row(NAME, "a refusal of an 8800 is told", f"{START_8800} | {FREE_8800} | RUNM -> 3",
        refuses("B-INST-005", "completion 3", "run"), dialect="8800"),
    row(NAME, "the stop of a stopped 8800 is none", f"{START_8800} | STOP -> 5 | MODE? -> 2", does("stop"),
        dialect="8800"),
    row(NAME, "process alarms stop and deviation alarms do not",
        "<start> | HOLD | ALRM1? -> 1 | MODE? -> 24 | HOLD | ALRM1? -> 34", does("hold"),
        refuses("B-INST-005", "high process limit alarm", "hold")),
    row(NAME, "every alarm has its name", "<start> | ALRM1? -> 51 | ALRM1? -> 2", does("identify"),
        gives(ALARMS, "drain_errors"), gives(ALARMS[1:2], "drain_errors")),
    row(NAME, "one that does not run is noticed", " | ".join(["<start>", FREE, "RUNM!", *["MODE? -> 2"] * 7]),
        refuses("B-INST-011", "", "run")),
    *[row(NAME, f"one that stays in mode {mode} is not stopped",
          " | ".join(["<start>", "STOP", *[f"MODE? -> {mode}"] * 7]), refuses("B-INST-009", "", "stop"))
      for mode in (16, 1, 24)],
    row(NAME, "a set-point that did not arrive is noticed", OTHER_SET_POINT,
        refuses("B-INST-011", "SETP1", "set_temperature", -10.0, 0.5)),
    *[row(NAME, f"mode {mode} is not overwritten", f"<start> | MODE? -> {mode}",
          refuses("B-INST-019", "program|calibration", action, *given))
      for mode in (1, 9, 34, 64, 128) for action, *given in (("run",), ("set_temperature", -10.0, 0.5))],
    *[row(NAME, f"{told} is not right", f"{START_8800} | {FREE} | {told}", refuses("B-INST-019", match, "run"),
          dialect="8800") for told, match in (("CCHR1? -> F", "scale"), ("CCHR1? -> C | OPTN? -> 9", "product"))],
    row(NAME, "the other dialect is another instrument", "IDEN? -> 3800 REV 3 | <clear> | IDEN? -> 3800 REV 3",
        refuses("B-INST-002", "3800 REV 3", "identify"), dialect="8800"),
]  # fmt: skip


NAME = "fluke_5720a"
BACK = "OUT? -> 1.000000E-02,A,0E+00"
UNLOCKED = "RANGELCK OFF!"
OUT = f"<start> | {UNLOCKED} | OUT 1.0E-02 A, 0 HZ!"
SET = f"{OUT} | {BACK}"
READY = f"{SET} | <ok> | {BACK} | ISR? -> 4096 | CUR_POST? -> NORMAL"
ON, SETTLED, STANDBY = "ISR? -> 1", "ISR? -> 4097", "ISR? -> 4096"
OUTPUT, OPERATE = does("output", 0.01), does("operate")
OTHER = "OUT? -> {0} | <clear>"
FAULTS = 'FAULT? -> 503 | FAULT? -> 301 | <ok> | EXPLAIN? 503 -> "Over current limit" | EXPLAIN? 301 -> "No such range"'
TRIPPED = f'{STANDBY} | FAULT? -> 505 | <ok> | EXPLAIN? 505 -> "Output tripped to standby"'
KEYS = [(256, "OFFSET active"), (512, "SCALE active"), (768, "OFFSET active.*SCALE active"), (8, "BOOST active")]
OTHERS = [(16, "RCOMP"), (64, "phase shift"), (128, "phase lock"), (1024, "wideband"), (1 << 14, "another")]
OTHERS += [(1 << 15, "another")]
CURRENTS = [
    (3e-5, "3.0E-05", "3.00000E-05,A,0.0"), (0.1234567, "1.234567E-01", "1.234567E-01,A,0"),
    (0.0, "0.0E+00", "0E+00,A,0E+00"), (2.2, "2.2E+00", "2.2E+00,A,0E+00"),
]  # fmt: skip
STEPS = [
    (3e-5, "3.0E-05", "3.000005E-05", "3.00002E-05"), (1e-3, "1.0E-03", "1.0000005E-03", "1.000002E-03"),
    (0.1, "1.0E-01", "1.0000005E-01", "1.000002E-01"), (1.0, "1.0E+00", "1.0000005E+00", "1.000002E+00"),
]  # fmt: skip
ROWS += [
    row(NAME, "a point from standby to standby",
        f"{READY} | OPER | {ON} | {ON} | {SETTLED} | <ok> | {SETTLED} | <safe>".replace("<start>", "<start> | <safe>"),
        does("standby"), OUTPUT, OPERATE, gives(True, "operating"), does("standby"),
        leaves={"test_clock.now_ns": NS // 2, "identity.model": "5720A", "identity.serial": "7005201"}),
    *[row(NAME, f"{current} A goes out in full and in ampere",
          f"<start> | RANGELCK ON! | OUT {sent} A, 0 HZ! | OUT? -> {reply}", does("output", current, "locked"))
      for current, sent, reply in CURRENTS],
    *[row(NAME, f"set-point {reply} is noticed", f"{OUT} | OUT? -> {reply}",
          refuses("B-INST-011", "reads back", "output", 0.01)) for reply in ("1.1E-02,A,0", "0,A,0", "-1.0E-02,A,0")],
    *[row(NAME, f"{current} A agrees within a step of its range",
          "<start> | " + " | ".join(f"{UNLOCKED} | OUT {sent} A, 0 HZ! | OUT? -> {back},A,0" for back in (near, far)),
          does("output", current), refuses("B-INST-011", "", "output", current), refuses("B-INST-010", "", "operate"))
      for current, sent, near, far in STEPS],
    *[row(NAME, f"{reply} is no direct current",
          f"{OUT} | {OTHER.format(reply)} | <ok> | {OTHER.format(reply)} | <ok> | {OTHER.format(reply)}",
          refuses("B-INST-004", "", "output", 0.01)) for reply in ("1.0E-02,V,0", "1.0E-02,A,50", "1.0E-02")],
    row(NAME, "faults are read to the end and explained", f"<start> | RANGELCK OFF | {FAULTS}",
        refuses("B-INST-005", "503 Over current limit; 301 No such range", "output", 0.01)),
    row(NAME, "nothing operates without an output", "", refuses("B-INST-010", "", "operate")),
    row(NAME, "nothing operates with a fault", f'{SET} | FAULT? -> 77 | <ok> | EXPLAIN? 77 -> "x"', OUTPUT,
        refuses("B-INST-005", "", "operate")),
    row(NAME, "nothing operates at another set-point", f"{SET} | <ok> | OUT? -> 2.0E-02,A,0", OUTPUT,
        refuses("B-INST-011", "", "operate")),
    *[row(NAME, f"one left with {keys} is refused", f"<start:2> | ISR? -> {4096 | bits}",
          refuses("B-INST-019", f"(?s){keys}.*press LOCAL, then", "identify"))
      for bits, keys in KEYS],
    row(NAME, "a garbled status is asked for again",
        "<start:2> | ISR? -> 40#6 | <clear> | <ok> | ISR? -> 4096 | CUR_POST? -> NORMAL", does("identify")),
    *[row(NAME, f"nothing operates with {keys}", f"{SET} | <ok> | {BACK} | ISR? -> {4096 | bits}", OUTPUT,
          refuses("B-INST-019", keys, "operate")) for bits, keys in KEYS + OTHERS],
    row(NAME, "guard and sense are set inside, and another function is no reason to stay away",
        "<start:2> | ISR? -> 4118 | EXTSENSE OFF! | ISR? -> 4114 | ISR? -> 4114 | EXTGUARD OFF! | ISR? -> 4112 | "
        "CUR_POST? -> NORMAL", does("identify")),
    row(NAME, "an offset that comes while it settles", f"{READY} | OPER | {ON} | ISR? -> 257 | STBY", OUTPUT,
        refuses("B-INST-019", "OFFSET", "operate")),
    row(NAME, "a scale factor that comes later", "<start> | ISR? -> 4609", refuses("B-INST-019", "SCALE", "operating")),
    row(NAME, "one that is refused is made safe all the same and not taken for prepared",
        f"<who> | STBY! | ISR? -> 4352 | <start> | {SETTLED}",
        does("make_safe"), gives(True, "operating")),
    row(NAME, "what trips ends in standby", f"{READY} | OPER | {ON} | {TRIPPED} | STBY", OUTPUT,
        refuses("B-INST-013", "Output tripped to standby", "operate")),
    row(NAME, "what never settles ends in standby", " | ".join([READY, "OPER", *[ON] * 61, "STBY"]), OUTPUT,
        refuses("B-INST-012", "", "operate"), leaves={"test_clock.now_ns": 15 * NS}),
    row(NAME, "OPER is never sent twice",
        f"{READY} | OPER | ISR? -> <timeout> | <silent> | <ok> | {SETTLED} | <ok>", OUTPUT, OPERATE),
    row(NAME, "still operating is not safe", f"<who> | STBY! | {SETTLED}", refuses("B-INST-009", "", "make_safe")),
    row(NAME, "its input buffer is not overrun", f"<start> | {'X' * 127}", does("raw", "X" * 127),
        refuses("B-INST-014", "", "raw", "X" * 128)),
    row(NAME, "how long it has been on and how old its zeros are", "<start> | ONTIME? -> 95 | CAL_DAYS? ZERO -> 12",
        gives(95 * 60, "time_on_s"), gives((12.0, 30.0, "days", ANY), "self_calibration")),
]  # fmt: skip


@pytest.mark.parametrize("case", ROWS, ids=lambda case: f"{case.name}: {case.claim}")
def test_an_exchange(case: Row) -> None:
    case.play()


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [
        *[("agilent_34970a", "channels", value) for value in ([], [1], ["101"], 101, [102, 101], [101, 101])],
        *[("agilent_34970a", "thermocouple", value) for value in ("TT", "", "none")],
        *[("keithley_7002", "slot", value) for value in (0, 11, "one", None)],
        ("thermotron_3800", "dialect", "2800"), ("srs_sr830", "reference", "index_c"), ("srs_sr830", "input", "bfg"),
        ("srs_sr830", "demodulation", "triangle"), ("srs_sr830", "divider", 0), ("srs_sr830", "divider", "10"),
        *[("pendulum_cnt_91", "clock_error_ppm", value) for value in (1001.0, "1", True, float("nan"))],
    ],
)  # fmt: skip
def test_an_option_that_the_model_has_not_is_refused(name: str, option: str, value: object) -> None:
    with pytest.raises(InputError, match=option) as caught, scripted(name, [], **{option: value}):
        pass
    assert caught.value.code == "B-INST-020"


def test_a_trip_during_the_dwell_is_seen_and_its_fault_kept() -> None:
    with scripted(
        "fluke_5720a",
        exchange("fluke_5720a", '<start> | ISR? -> 4096 | FAULT? -> 505 | <ok> | EXPLAIN? 505 -> "Tripped"'),
    ) as driver:
        assert driver.operating() is False
        assert ("rx", '"Tripped"') in [line[1:3] for line in driver.test_log.lines]


def test_two_threads_never_measure_the_wrong_rail() -> None:
    """The rail selected by one thread is still selected when it reads."""
    supply = make("agilent_e3631a", exchange("agilent_e3631a", "<start>"))
    supply.identify()
    pause = threading.Event()
    state = {"rail": 0, "reply": ""}

    def write(command: str) -> None:
        pause.wait(2e-4)  # lets the other threads try
        if command.startswith("INST:NSEL "):
            state["rail"] = int(command[-1])
        state["reply"] = f"{state['rail']}.0" if command == "MEAS:VOLT?" else '+0,"No error"'

    supply.test_resource.write = write
    supply.test_resource.read = lambda: state["reply"]
    wrong: list[float] = []

    def measure(rail: int) -> None:
        wrong.extend(found for _ in range(20) if (found := supply.measure_voltage(rail)) != rail)

    threads = [threading.Thread(target=measure, args=(rail,)) for rail in (1, 2, 3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.parametrize(("text", "closed"), [("(@)", ()), ("(@ 1!1!3, 1!2!4)", ("1!1!3", "1!2!4"))])
def test_the_list_of_closed_crosspoints(text: str, closed: tuple[str, ...]) -> None:
    assert read_closed(text) == closed


def test_the_display_of_the_filter_and_the_length_of_its_lines() -> None:
    """Its buffer holds 32 characters; a display of another form is not understood."""
    assert max(len(line) + 1 for line in BAND.split(" | ")) <= 32
    for reply in ("", "00", "KROHN-HITE V3.5", "00 .5000E+0 01.1 00", "0000"):
        with pytest.raises(ValueError, match="due"):
            read_display(reply)
    assert read_display("20 1.234E+6 02.1 06 AC*") == Display(2, 1.234e6, 20, 6, "AC")
