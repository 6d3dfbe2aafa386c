"""Every rung of the recovery ladder, by exact bus events; and which commands are sent a second time, and when."""

from __future__ import annotations

from typing import Any

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from scripted import BUS_ERROR, CLEAR, POLL, SILENT, TIMEOUT, Scripts, make, refused, scripted

from bench.model.errors import InstrumentError
from instruments.commands import Setting

START = IDENTIFY["hp_6632b"]
QUESTION = b"MEAS:VOLT?\n"
VOLTS = (QUESTION, b"+1.00000E+01\n")
MUTE = [(QUESTION, TIMEOUT), *SILENT]
DEAD_QUEUE = [(b"SYST:ERR?\n", TIMEOUT), *SILENT]
GONE = VisaIOError(StatusCode.error_resource_not_found)
OTHER = b"HEWLETT-PACKARD,6632B,US00000009,A.01.01\n"


def notes(driver: Any) -> list[str]:
    """What the transcript says beside commands and replies."""
    return [text for _, _, text, _ in driver.test_log.lines if text.startswith("<")]


# --- questions ---------------------------------------------------------------------------------------------------


def test_an_instrument_that_hears_no_poll_is_reopened_at_once_or_its_interface_cleared() -> None:
    again = Scripts([[(CLEAR, None), *START, VOLTS]])
    supply = make("hp_6632b", [*START, (QUESTION, TIMEOUT), (POLL, BUS_ERROR)], rungs={"reopen": again})
    assert supply.measure_voltage() == 10.0
    assert supply.test_resource.closed
    assert supply.test_resource.events == again.leftovers() == []
    assert supply.test_clock.now_ns() == 500_000_000
    assert notes(supply)[-4:] == ["<close>", "<pause>", "<open>", "<device clear>"]
    script = [*START, *MUTE, *DEAD_QUEUE, (CLEAR, None), VOLTS]
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
    again = Scripts([[(CLEAR, None), *START, VOLTS]])
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


# --- commands in doubt -------------------------------------------------------------------------------------------

CONFIGURE = {"voltage": 15.0, "current_limit": 1.5, "over_voltage": 18.0}
REST = [
    *after(b"CURR:PROT:STAT ON\n"), *after(b"OUTP:PROT:DEL 0.08\n"),
    *after(b"VOLT:PROT 1.8E+01\n"), *after(b"VOLT 1.5E+01\n"),
    (b"CURR?\n", b"1.5\n"), (b"VOLT:PROT?\n", b"18.0\n"), (b"VOLT?\n", b"15.0\n"),
]  # fmt: skip
SET, SILENT_QUEUE = (b"CURR 1.5E+00\n", None), [(b"SYST:ERR?\n", TIMEOUT), *SILENT]


def test_a_command_in_doubt_that_took_effect_is_not_sent_again() -> None:
    with scripted("hp_6632b", [*START, SET, *SILENT_QUEUE, (b"CURR?\n", b"1.5\n"), *REST]) as supply:
        supply.configure(**CONFIGURE)
        assert "<CURR 1.5E+00 took effect: 1.5 reads back>" in notes(supply)


def test_a_command_without_effect_is_sent_again_once_and_not_a_third_time() -> None:
    before = (b"CURR?\n", b"0.7\n")
    script = [*START, (TIMEOUT, None), *SILENT, before, SET, NO_ERROR, (b"CURR?\n", b"1.5\n"), *REST]
    with scripted("hp_6632b", script) as supply:
        supply.seen["CURR?"] = 0.7
        supply.configure(**CONFIGURE)
        assert "<CURR 1.5E+00 is sent again: it had no effect>" in notes(supply)
    before = (b"CURR?\n", b"0.7\n")
    script = [*START, SET, *SILENT_QUEUE, before, SET, *SILENT_QUEUE, before]
    with scripted("hp_6632b", script) as supply:
        supply.seen["CURR?"] = 0.7
        with refused("B-INST-011", r"0\.7 reads back"):
            supply.configure(**CONFIGURE)


@pytest.mark.parametrize("known", [None, 0.2])
def test_a_state_that_is_neither_is_an_error(known: float | None) -> None:
    with scripted("hp_6632b", [*START, SET, *SILENT_QUEUE, (b"CURR?\n", b"0.7\n")]) as supply:
        supply.seen["CURR?"] = known
        with refused("B-INST-011", r"0\.7 reads back"):
            supply.configure(**CONFIGURE)


def test_a_refusal_or_a_silence_at_the_second_sending_is_the_error() -> None:
    refusal = [(b"SYST:ERR?\n", b'-222,"Data out of range"\n'), NO_ERROR]
    with scripted("hp_6632b", [*START, SET, *SILENT_QUEUE, (b"CURR?\n", b"0.7\n"), SET, *refusal]) as supply:
        supply.seen["CURR?"] = 0.7
        with refused("B-INST-005", "-222"):
            supply.configure(**CONFIGURE)
    unread = [(b"CURR?\n", TIMEOUT), *SILENT, *DEAD_QUEUE]
    in_doubt = pytest.raises(InstrumentError, match="SYST:ERR")
    with scripted("hp_6632b", [*START, SET, *SILENT_QUEUE, *unread]) as supply, in_doubt as caught:
        supply.configure(**CONFIGURE)
    assert caught.value.code == "B-INST-001"


NO_FAULT, ON, SETTLED = (b"FAULT?\n", b"0\n"), (b"ISR?\n", b"1\n"), (b"ISR?\n", b"4097\n")
STANDBY, OUT_IS_10_MA = (b"ISR?\n", b"4096\n"), (b"OUT?\n", b"1.0E-02,A,0\n")
READY = [*IDENTIFY["fluke_5720a"], NO_FAULT, OUT_IS_10_MA, STANDBY]


def operated(script: list[Any]) -> Any:
    calibrator = make("fluke_5720a", [*READY, (TIMEOUT, None), *SILENT, *script])
    calibrator.identify()
    calibrator.programmed_A = 0.01
    try:
        calibrator.operate()
    finally:
        assert calibrator.test_resource.events == []
    return calibrator


def test_oper_in_doubt_is_sent_again_only_from_standby_without_a_fault() -> None:
    operated([ON, SETTLED, NO_FAULT])
    operated([STANDBY, NO_FAULT, (b"OPER\n", None), ON, SETTLED, NO_FAULT])
    trip = [STANDBY, (b"FAULT?\n", b"501\n"), NO_FAULT, (b"EXPLAIN? 501\n", b'"Compliance"\n')]
    with refused("B-INST-013", "Compliance"):
        operated([*trip, (b"STBY\n", None)])
    dead = [(b"ISR?\n", TIMEOUT), *SILENT, (b"FAULT?\n", TIMEOUT), *SILENT]
    with refused("B-INST-001", "OPER"):
        operated([*dead, (b"STBY\n", None)])


CLOSE, NONE_CLOSED, CLOSED = (
    (b":CLOS (@1!1!3)\n", None),
    (b":CLOS:STAT?\n", b"(@)\n"),
    (b":CLOS:STAT?\n", b"(@1!1!3)\n"),
)
OPENED = [*IDENTIFY["keithley_7002"], *after(b":OPEN ALL\n"), NONE_CLOSED]


@pytest.mark.parametrize("looks", [[CLOSED], [NONE_CLOSED, CLOSE, NO_ERROR, CLOSED]])
def test_a_relay_in_doubt_is_looked_at(looks: list[Any]) -> None:
    with scripted("keithley_7002", [*OPENED, CLOSE, *SILENT_QUEUE, *looks, CLOSED]) as switch:
        switch.route(3, 1)


def test_a_relay_in_doubt_that_is_another_one_is_an_error() -> None:
    script = [*OPENED, CLOSE, *SILENT_QUEUE, (b":CLOS:STAT?\n", b"(@1!1!4)\n")]
    other = pytest.raises(InstrumentError, match="1!1!4")
    with scripted("keithley_7002", script) as switch, other as caught:
        switch.route(3, 1)
    assert caught.value.code == "B-INST-011"


def test_standby_in_doubt_is_sent_again_until_it_reads_back() -> None:
    script = [*IDENTIFY["fluke_5720a"], (TIMEOUT, None), *SILENT, SETTLED, (b"STBY\n", None), NO_FAULT, STANDBY]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.standby()


NO_ALARM, RUNS = (b"ALRM1?\n", b"0\n"), (b"MODE?\n", b"16\n")


@pytest.mark.parametrize("looks", [[RUNS], [(b"MODE?\n", b"2\n"), (b"RUNM\n", b"0\n"), NO_ALARM, RUNS]])
def test_a_chamber_operation_in_doubt_is_looked_at(looks: list[Any]) -> None:
    start = [(b"IDEN?\n", b"Thermotron 8800 1.0\n"), NO_ALARM]
    script = [*start, (b"RUNM\n", TIMEOUT), *SILENT, *looks, RUNS]
    with scripted("thermotron_3800", script, dialect="8800") as chamber:
        chamber.run()


def test_the_set_up_of_a_meter_in_doubt_begins_again_from_its_preset() -> None:
    ok = (b"ERRSTR?\n", b'0,"NO ERROR"\r\n')
    commands = [
        b"PRESET NORM", b"INBUF ON", b"END ALWAYS", b"DCI 1.0E-01", b"NPLC 100", b"NDIG 8", b"AZERO ON", b"TRIG HOLD",
    ]  # fmt: skip
    whole = [pair for command in commands for pair in after(command + b"\n", ok)]
    lost = [(b"NPLC 100\n", None), (b"ERRSTR?\n", TIMEOUT), *SILENT]
    script = [*IDENTIFY["hp_3458a"], *whole[:8], *lost, *whole, (b"RANGE?\n", b"1.0E-01\r\n")]
    with scripted("hp_3458a", script) as meter:
        assert meter.configure_current(0.1) == 0.1


# --- in a hurry --------------------------------------------------------------------------------------------------


def test_in_a_hurry_the_first_silence_is_told_and_afterwards_the_session_gets_into_step() -> None:
    script = [*IDENTIFY["fluke_5720a"], (b"STBY\n", None), (b"FAULT?\n", TIMEOUT), (b"STBY\n", None)]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.identify()
        calibrator.test_resource.timeouts_ms.clear()
        with calibrator.quick(0.4), refused("B-INST-001"):
            calibrator.make_safe()
        assert set(calibrator.test_resource.timeouts_ms) == {400}
    hurried = [(b"STBY\n", None), (b"FAULT?\n", TIMEOUT), (b"STBY\n", None)]
    later = [(b"STBY\n", None), (CLEAR, None), NO_FAULT, STANDBY]
    with scripted("fluke_5720a", [*IDENTIFY["fluke_5720a"], *hurried, *later]) as calibrator:
        with calibrator.quick(0.4), pytest.raises(InstrumentError):
            calibrator.make_safe()
        calibrator.make_safe()


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("fluke_5720a", b"STBY\n"),
        ("keithley_7002", b":OPEN ALL\n"),
        ("hp_6632b", b"OUTP OFF\n"),
        ("agilent_e3631a", b"OUTP OFF\n"),
        ("agilent_33250a", b"OUTP OFF\n"),
        ("thermotron_3800", b"HOLD\n"),
    ],
)
def test_a_mute_instrument_that_nobody_has_identified_hears_the_safe_command(name: str, command: bytes) -> None:
    script = [(IDENTIFY[name][0][0], TIMEOUT), (command, None)]
    with scripted(name, script) as driver, driver.quick(0.4), refused("B-INST-001"):
        driver.make_safe()


def test_the_reply_to_the_question_of_a_controller_that_is_gone_is_not_an_identity() -> None:
    script = [(b"*IDN?\n", b"1.0E-02,A,0\n"), (CLEAR, None), *IDENTIFY["fluke_5720a"]]
    with scripted("fluke_5720a", script) as calibrator:
        assert calibrator.identify().model == "5720A"
