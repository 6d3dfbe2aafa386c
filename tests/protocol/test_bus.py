"""The bus seen through a driver: time limits, transcript, and every rung of the recovery ladder by exact events."""

import threading
from typing import Any

import pytest
from exchanges import IDENTIFY, NO_ERROR, Call, Row, does, exchange, gives, refuses, row, slow
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from scripted import BUS_ERROR, CLEAR, POLL, SILENT, TIMEOUT, ScriptedResource, Scripts, make, refused, scripted

from bench.model.clock import VirtualClock
from bench.model.errors import ExitStatus, InstrumentError
from instruments.bus import BusSession, bus_lock
from instruments.commands import Setting

VOLTS = (b"MEAS:VOLT?\n", b"+1.00000E+01\n")
START = IDENTIFY["hp_6632b"]


def test_a_late_reply_is_cleared_and_read_again_unless_the_queue_is_dead_too() -> None:
    script = [*START, (b"MEAS:VOLT?\n", TIMEOUT), *SILENT, NO_ERROR, VOLTS]
    with scripted("hp_6632b", script) as supply:
        assert supply.measure_voltage() == 10.0
    script = [*START, (b"MEAS:VOLT?\n", TIMEOUT), *SILENT, (b"SYST:ERR?\n", TIMEOUT), *SILENT]
    with scripted("hp_6632b", script) as supply, refused("B-INST-001", "MEAS:VOLT"):
        supply.measure_voltage()


def test_three_tries_then_the_time_out_is_reported() -> None:
    once = [(b"MEAS:VOLT?\n", TIMEOUT), *SILENT]
    with (
        scripted("hp_6632b", [*START, *once, NO_ERROR, *once, NO_ERROR, *once]) as supply,
        refused("B-INST-001", r"no answer to 'MEAS:VOLT\?' within 1 s \(serial poll: 0\)") as caught,
    ):
        supply.measure_voltage()
    assert caught.value.where == "unit_of_test (GPIB0::4::INSTR)"
    assert caught.value.exit_status == ExitStatus.SAFE_AFTER_FAULT


def test_garbage_is_read_again_and_then_refused() -> None:
    with scripted("hp_6632b", [*START, (b"MEAS:VOLT?\n", b"ERROR\n"), (CLEAR, None), NO_ERROR, VOLTS]) as supply:
        assert supply.measure_voltage() == 10.0
    once = [(b"MEAS:VOLT?\n", b"nan\n"), (CLEAR, None)]
    script = [*START, *once, NO_ERROR, (b"MEAS:VOLT?\n", b"\xff\n"), (CLEAR, None), NO_ERROR, *once]
    with scripted("hp_6632b", script) as supply, refused("B-INST-004", "finite number is due"):
        supply.measure_voltage()


DC_VOLTS = [*IDENTIFY["agilent_34401a"], (b"ROUT:TERM?\n", b"FRON\n"), (b"CONF:VOLT:DC\n", None), NO_ERROR]


@pytest.mark.parametrize("reply", [b"-9.90000000E+37\n", b"9.91E37\n"])
def test_overload_is_an_error_and_not_retried(reply: bytes) -> None:
    script = [
        *IDENTIFY["agilent_34401a"],
        (b"ROUT:TERM?\n", b"FRON\n"),
        (b"CONF:VOLT:DC\n", None),
        NO_ERROR,
        *slow(b"READ?\n", reply),
    ]
    with scripted("agilent_34401a", script) as meter, refused("B-INST-007", "overload"):
        meter.measure_voltage()


def test_an_error_queue_without_an_end_is_given_up() -> None:
    endless = [(b"SYST:ERR?\n", b'-222,"Data out of range"\n')] * 33
    with scripted("hp_6632b", [START[0], *endless]) as supply, refused("B-INST-006"):
        supply.identify()


def test_every_text_is_in_the_transcript_with_clock_time() -> None:
    with scripted("hp_6632b", [*START, (b"MEAS:VOLT?\n", TIMEOUT), *SILENT, NO_ERROR, VOLTS]) as supply:
        supply.test_clock.sleep(2.5)
        supply.measure_voltage()
        lines = supply.test_log.lines
    texts = [line[1:3] for line in lines]
    assert texts[0] == ("tx", "*IDN?")
    assert texts[1] == ("rx", "HEWLETT-PACKARD,6632B,US36001234,A.01.01")
    assert ("tx", "<device clear>") in texts
    assert texts[-1] == ("rx", "+1.00000E+01")
    assert {(line[0], line[3]) for line in lines} == {("unit_of_test", 2_500_000_000)}


def test_every_call_has_a_time_limit_from_the_first_on() -> None:
    """A clear may be the first one after reopening; the resource's own limit is longer than a step may be silent."""
    resource = ScriptedResource([(CLEAR, None)])
    BusSession(resource, "dmm", VirtualClock(), lambda *_: None).clear()  # type: ignore[arg-type]
    assert resource.timeout is not None
    assert 0 < resource.timeout <= 1500
    reading = [*slow(b"READ?\n", b"+5.0E+00\n"), NO_ERROR]
    with scripted(
        "agilent_34401a",
        [*DC_VOLTS, *reading],
    ) as meter:
        meter.measure_voltage()
        resource = meter.test_resource
        meter.close()
    assert resource.closed
    assert set(resource.timeouts_ms) == {1000}


def test_one_lock_per_bus_and_another_thread_waits_for_it() -> None:
    assert bus_lock("GPIB0::4::INSTR") is bus_lock("GPIB0::22::INSTR")
    assert bus_lock("GPIB0::4::INSTR") is not bus_lock("GPIB1::4::INSTR")
    assert bus_lock("TCPIP0::a::INSTR") is not bus_lock("TCPIP0::b::INSTR")
    supply = make("hp_6632b", [*START, VOLTS])
    with bus_lock("GPIB0::9::INSTR"):
        thread = threading.Thread(target=supply.measure_voltage)
        thread.start()
        thread.join(0.05)
        assert thread.is_alive()
        assert len(supply.test_resource.events) == 9
    thread.join(5)
    assert not thread.is_alive()
    assert supply.test_resource.events == []


QUESTION = b"MEAS:VOLT?\n"
LADDER_VOLTS = (QUESTION, b"+1.00000E+01\n")
MUTE = [(QUESTION, TIMEOUT), *SILENT]
DEAD_QUEUE = [(b"SYST:ERR?\n", TIMEOUT), *SILENT]
GONE = VisaIOError(StatusCode.error_resource_not_found)
OTHER = b"HEWLETT-PACKARD,6632B,US00000009,A.01.01\n"


def notes(driver: Any) -> list[str]:
    """What the transcript says beside commands and replies."""
    return [text for _, _, text, _ in driver.test_log.lines if text.startswith("<")]


def test_an_instrument_that_hears_no_poll_is_reopened_at_once_or_its_interface_cleared() -> None:
    again = Scripts([[(CLEAR, None), *START, LADDER_VOLTS]])
    supply = make("hp_6632b", [*START, (QUESTION, TIMEOUT), (POLL, BUS_ERROR)], rungs={"reopen": again})
    assert supply.measure_voltage() == 10.0
    assert supply.test_resource.closed
    assert supply.test_resource.events == again.leftovers() == []
    assert supply.test_clock.now_ns() == 500_000_000
    assert notes(supply)[-4:] == ["<close>", "<pause>", "<open>", "<device clear>"]
    script = [*START, *MUTE, *DEAD_QUEUE, (CLEAR, None), LADDER_VOLTS]
    supply = make("hp_6632b", script, rungs={"interface_clear": lambda: None})
    assert supply.measure_voltage() == 10.0
    assert supply.test_resource.events == []


def test_the_ladder_to_its_top(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three tries, two reopenings after 0.5 s and 1 s, the interface clear, and a last try."""
    cleared: list[int] = []
    silent_again = [(CLEAR, None), (b"*IDN?\n", TIMEOUT), *SILENT]
    again = Scripts([silent_again, GONE, [(CLEAR, None), *START, *MUTE]])
    script = [*START, *MUTE, NO_ERROR, *MUTE, NO_ERROR, *MUTE]
    supply = make("hp_6632b", script, rungs={"reopen": again, "interface_clear": lambda: cleared.append(1)})
    monkeypatch.setattr("instruments.ladder.CLIMB_S", 9.0)
    with refused("B-INST-001", r"no answer to 'MEAS:VOLT\?'"):
        supply.measure_voltage()
    assert supply.test_resource.events == again.leftovers() == []
    assert cleared == [1]
    assert supply.test_clock.now_ns() == 1_500_000_000
    pauses = [line[3] for line in supply.test_log.lines if line[2] == "<pause>"]
    assert pauses == [0, 500_000_000, 1_000_000_000]  # no longer than half a second without a sign of life
    assert [note for note in notes(supply) if note in ("<open>", "<interface clear>", "<close>")] == [
        "<close>", "<open>", "<close>", "<open>", "<interface clear>", "<close>", "<open>",
    ]  # fmt: skip


def test_a_broken_bus_is_reopened_without_another_try_and_garbage_is_no_reason() -> None:
    again = Scripts([[(CLEAR, None), *START, LADDER_VOLTS]])
    supply = make("hp_6632b", [*START, (QUESTION, BUS_ERROR)], rungs={"reopen": again})
    assert supply.measure_voltage() == 10.0
    assert again.leftovers() == []
    once = [(QUESTION, b"?#\n"), (CLEAR, None)]
    script = [*START, *once, NO_ERROR, *once, NO_ERROR, *once]
    supply = make("hp_6632b", script, rungs={"reopen": Scripts([]), "interface_clear": lambda: pytest.fail("no")})
    with refused("B-INST-004"):
        supply.measure_voltage()


@pytest.mark.parametrize("reply", [OTHER, b"ACME,9999,0,1\n"])
def test_another_instrument_after_reopening_gets_no_other_command(reply: bytes) -> None:
    again = Scripts([[(CLEAR, None), (b"*IDN?\n", reply)]])
    supply = make("hp_6632b", [*START, (QUESTION, BUS_ERROR)], rungs={"reopen": again})
    supply.kept = (Setting("CURR?", 1.0, 0.005, "A"),)
    with refused("B-INST-016", "US36001234"):
        supply.measure_voltage()
    assert again.leftovers() == []
    with refused("B-INST-010"):
        supply.output_on()


def test_a_setting_that_was_lost_meanwhile_ends_the_recovery() -> None:
    lost = [(b"CURR?\n", b"5.12000E-01\n")]
    again = Scripts([[(CLEAR, None), *START, *lost]])
    supply = make("hp_6632b", [*START, (QUESTION, BUS_ERROR)], rungs={"reopen": again})
    supply.kept = (Setting("CURR?", 1.0, 0.005, "A"),)
    with refused("B-INST-011", "CURR"):
        supply.measure_voltage()


def test_nothing_is_asked_while_an_old_reply_may_still_come() -> None:
    """Neither a device clear nor the question who is there gets through: the next question is not asked at all."""
    broken = [(CLEAR, TIMEOUT), (CLEAR, TIMEOUT), (b"*IDN?\n", TIMEOUT)]
    with scripted("hp_6632b", [*START, (QUESTION, TIMEOUT), (POLL, 16), *broken, *broken]) as supply:
        with refused("B-INST-001", "MEAS:VOLT"):
            supply.measure_voltage()
        with refused("B-INST-001", "an earlier question may still come"):
            supply.raw("VOLT?")


CURR = "CURR 1.5E+00"
REST = "INIT:CONT:SEQ1? -> 0 | ABOR! | CURR:PROT:STAT? -> 1 | OUTP:RI:MODE? -> OFF | OUTP:PROT:DEL 0.08! | "
REST += "VOLT? -> 19 | VOLT 1.5E+01! | VOLT:PROT 1.8E+01! | CURR? -> 1.5 | VOLT? -> 15.0 | VOLT:PROT? -> 18.0"
NO_QUEUE = "SYST:ERR? -> <timeout> | <silent>"
CONFIGURE = (15.0, 1.5, 18.0)
DONE = does("configure", *CONFIGURE)


def not_done(code: str, match: str) -> Call:
    return refuses(code, match, "configure", *CONFIGURE)


@pytest.mark.parametrize(
    ("script", "seen", "call", "note"),
    [
        (f"{CURR} | {NO_QUEUE} | CURR? -> 1.5 | {REST}", None, DONE, "<CURR 1.5E+00 took effect: 1.5 reads back>"),
        (f"<timeout> | <silent> | CURR? -> 0.7 | {CURR}! | CURR? -> 1.5 | {REST}", 0.7, DONE,
         "<CURR 1.5E+00 is sent again: it had no effect>"),
        (f"{CURR} | {NO_QUEUE} | CURR? -> 0.7 | {CURR} | {NO_QUEUE} | CURR? -> 0.7", 0.7,
         not_done("B-INST-011", r"0\.7 reads back"), ""),  # it is not sent a third time
        *[(f"{CURR} | {NO_QUEUE} | CURR? -> 0.7", seen, not_done("B-INST-011", r"0\.7 reads back"), "")
          for seen in (None, 0.2)],  # neither what was nor what is wanted
        (f'{CURR} | {NO_QUEUE} | CURR? -> 0.7 | {CURR} | SYST:ERR? -> -222,"Data out of range" | <ok>', 0.7,
         not_done("B-INST-005", "-222"), ""),
        (f"{CURR} | {NO_QUEUE} | CURR? -> <timeout> | <silent> | {NO_QUEUE}", None,
         not_done("B-INST-001", "SYST:ERR"), ""),
    ],
)  # fmt: skip
def test_a_command_in_doubt_is_read_back_and_sent_again_once_if_it_had_no_effect(
    script: str, seen: float | None, call: Call, note: str
) -> None:
    with scripted("hp_6632b", exchange("hp_6632b", f"<start> | {script}")) as supply:
        supply.seen["CURR?"] = seen
        call.on(supply)
        assert not note or note in notes(supply)


SET = does("identify"), does("__setattr__", "programmed_A", 0.01)
OPERATE = "<start> | <ok> | OUT? -> 1.0E-02,A,0 | ISR? -> 4096 | CUR_POST? -> NORMAL | <timeout> | <silent> | "
TRIP = 'ISR? -> 4096 | FAULT? -> 501 | <ok> | EXPLAIN? 501 -> "Compliance" | STBY'
DEAD = "ISR? -> <timeout> | <silent> | FAULT? -> <timeout> | <silent> | STBY"
NO_POST = "CUR_POST? -> <timeout> | <silent>"
UNKNOWN = f'{NO_POST} | FAULT? -> 1302 | <ok> | EXPLAIN? 1302 -> "Unknown command"'
CLOSE = f"<start> | :OPEN ALL! | :CLOS:STAT? -> (@) | :CLOS (@1!1!3) | {NO_QUEUE} | "
CLOSED = ":CLOS:STAT? -> (@1!1!3)"
FREE = "IDEN? -> Thermotron 8800 1.0 | <ok> | MODE? -> 2 | <ok> | CCHR1? -> C | OPTN? -> 0"
RUN = f"{FREE} | RUNM -> <timeout> | <silent> | "
RUNS = "MODE? -> 16 | STAT? -> 16"
SET_UP = "TERM? -> 1 | LFREQ LINE! | PRESET NORM! | INBUF ON! | DCI 1.0E-01! | NPLC 100! | NDIG 8! | TRIG HOLD!"
LOST = f"{SET_UP.partition('NPLC')[0]}NPLC 100 | ERRSTR? -> <timeout> | <silent>"
ROWS = [
    row("fluke_5720a", "OPER that took effect", f"{OPERATE}ISR? -> 1 | ISR? -> 4097 | <ok>", *SET, does("operate")),
    row("fluke_5720a", "OPER from standby without a fault",
        f"{OPERATE}ISR? -> 4096 | <ok> | OPER | ISR? -> 1 | ISR? -> 4097 | <ok>", *SET, does("operate")),
    row("fluke_5720a", "OPER of one that tripped", f"{OPERATE}{TRIP}",
        *SET, refuses("B-INST-013", "Compliance", "operate")),
    row("fluke_5720a", "OPER of one that is dead", f"{OPERATE}{DEAD}", *SET, refuses("B-INST-001", "OPER", "operate")),
    row("fluke_5720a", "standby is sent again until it reads back",
        "<start> | <timeout> | <silent> | ISR? -> 4097 | STBY! | ISR? -> 4096", does("standby")),
    row("fluke_5720a", "a register that is garbled is asked again",
        "<start:2> | ISR? -> 4O96 | <clear> | <ok> | ISR? -> 4096 | CUR_POST? -> NORMAL", does("identify")),
    row("fluke_5720a", "a question that it does not know", f"<start:3> | {UNKNOWN} | {UNKNOWN} | {NO_POST}",
        refuses("B-INST-001", r"no answer to 'CUR_POST.*\); it reports 1302 Unknown command\. Next: look", "identify")),
    row("keithley_7002", "a relay that closed", f"{CLOSE}{CLOSED} | {CLOSED}", does("route", 3, 1)),
    row("keithley_7002", "a relay that did not", f"{CLOSE}:CLOS:STAT? -> (@) | :CLOS (@1!1!3)! | {CLOSED} | {CLOSED}",
        does("route", 3, 1)),
    row("keithley_7002", "another relay", f"{CLOSE}:CLOS:STAT? -> (@1!1!4)",
        refuses("B-INST-011", "1!1!4", "route", 3, 1)),
    row("thermotron_3800", "a chamber that runs", f"{RUN}{RUNS} | {RUNS}", does("run"), dialect="8800"),
    row("thermotron_3800", "a chamber that does not", f"{RUN}MODE? -> 2 | RUNM -> 0 | <ok> | {RUNS} | {RUNS}",
        does("run"), dialect="8800"),
    row("hp_3458a", "the set-up of a meter begins again from its preset",
        f"<start> | {LOST} | {SET_UP} | RANGE? -> 1.0E-01", gives(0.1, "configure_current", 0.1)),
]  # fmt: skip


@pytest.mark.parametrize("case", ROWS, ids=lambda case: case.claim)
def test_what_is_in_doubt_is_looked_at(case: Row) -> None:
    case.play()


def test_in_a_hurry_the_first_silence_is_told_and_afterwards_the_session_gets_into_step() -> None:
    script = "<start> | STBY | FAULT? -> <timeout> | STBY"
    with scripted("fluke_5720a", exchange("fluke_5720a", script)) as calibrator:
        calibrator.identify()
        calibrator.test_resource.timeouts_ms.clear()
        with calibrator.quick(0.4), refused("B-INST-001"):
            calibrator.make_safe()
        assert set(calibrator.test_resource.timeouts_ms) == {400}
    script = "<who> | STBY | FAULT? -> <timeout> | STBY | <clear> | <who> | STBY! | ISR? -> 4096"
    with scripted("fluke_5720a", exchange("fluke_5720a", script)) as calibrator:
        with calibrator.quick(0.4), pytest.raises(InstrumentError):
            calibrator.make_safe()
        calibrator.make_safe()


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("fluke_5720a", b"STBY\n"),
        ("keithley_7002", b":OPEN ALL\n"),
        ("hp_6632b", b"OUTP OFF\nOUT 0\n"),  # in the one or the other of its languages
        ("agilent_e3631a", b"OUTP OFF\n"),
        ("agilent_33250a", b"OUTP OFF\n"),
        ("thermotron_3800", b"HOLD\n"),
    ],
)
def test_a_mute_instrument_that_nobody_has_identified_hears_the_safe_command(name: str, command: bytes) -> None:
    script = [(IDENTIFY[name][0][0], TIMEOUT), *((line, None) for line in command.splitlines(keepends=True))]
    with scripted(name, script) as driver, driver.quick(0.4), refused("B-INST-001"):
        driver.make_safe()


def test_the_reply_to_the_question_of_a_controller_that_is_gone_is_not_an_identity() -> None:
    script = [(b"*IDN?\n", b"1.0E-02,A,0\n"), (CLEAR, None), *IDENTIFY["fluke_5720a"]]
    with scripted("fluke_5720a", script) as calibrator:
        assert calibrator.identify().model == "5720A"
