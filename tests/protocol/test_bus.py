"""Time limits, transcript and the recovery ladder, seen through a driver."""

import threading

import pytest
from exchanges import IDENTIFY, NO_ERROR, slow
from scripted import CLEAR, SILENT, TIMEOUT, ScriptedResource, make, refused, scripted

from bench.model.clock import VirtualClock
from bench.model.errors import ExitStatus
from instruments.bus import BusSession, bus_lock

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


@pytest.mark.parametrize("reply", [b"+9.90000000E+37\n", b"9.91E37\n"])
def test_overload_is_an_error_and_not_retried(reply: bytes) -> None:
    script = [*IDENTIFY["agilent_34401a"], (b"CONF:VOLT:DC\n", None), NO_ERROR, *slow(b"READ?\n", reply)]
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
        "agilent_34401a", [*IDENTIFY["agilent_34401a"], (b"CONF:VOLT:DC\n", None), NO_ERROR, *reading]
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
        assert len(supply.test_resource.events) == 6
    thread.join(5)
    assert not thread.is_alive()
    assert supply.test_resource.events == []
