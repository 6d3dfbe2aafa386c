"""Exact exchanges of the function generator."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after
from scripted import refused, scripted

from bench.model.errors import InstrumentError

START = IDENTIFY["agilent_33250a"]


LEFT_OVER = [b"BURS:STAT OFF", b"SWE:STAT OFF", b"AM:STAT OFF", b"FM:STAT OFF", b"FSK:STAT OFF", b"VOLT:OFFS 0"]


def square(frequency: bytes, amplitude: bytes) -> list[tuple[bytes, bytes | None]]:
    commands = [*LEFT_OVER, b"FUNC SQU", b"OUTP:LOAD INF", b"OUTP:POL NORM", b"FUNC:SQU:DCYC 50"]
    commands += [b"FREQ " + frequency, b"VOLT:UNIT VPP", b"VOLT " + amplitude]
    return [pair for command in commands for pair in after(command + b"\n")]


def test_12345678_hz_is_sent_with_every_digit() -> None:
    read_back = [(b"FREQ?\n", b"+1.234567800000E+07\n"), (b"VOLT?\n", b"+2.500000000000E+00\n")]
    script = [
        *START,
        *square(b"1.2345678E+07", b"2.5E+00"),
        *read_back,
        *read_back,
        *after(b"OUTP ON\n"),
        (b"OUTP?\n", b"1\n"),
    ]
    script += [(b"OUTP OFF\n", None), NO_ERROR, (b"OUTP?\n", b"0\n")]
    with scripted("agilent_33250a", script) as generator:
        generator.square(12_345_678, 2.5)
        generator.output_on()
        generator.output_off()


def test_a_rounded_frequency_an_error_and_no_waveform_are_told() -> None:
    script = [*START, *square(b"1.2345678E+07", b"2.5E+00"), (b"FREQ?\n", b"+1.23457E+07\n")]
    with scripted("agilent_33250a", script) as generator, refused("B-INST-011", "12345678"):
        generator.square(12_345_678.0, 2.5)
    with scripted("agilent_33250a", []) as generator, refused("B-INST-010"):
        generator.output_on()
    error = [(b"SYST:ERR?\n", b'-221,"Settings conflict"\n'), NO_ERROR]
    left_over = [pair for command in LEFT_OVER for pair in after(command + b"\n")]
    script = [*START, *left_over, (b"FUNC SQU\n", None), *error]
    conflict = pytest.raises(InstrumentError, match="-221 Settings conflict")
    with scripted("agilent_33250a", script) as generator, conflict as caught:
        generator.square(1e7, 2.5)
    assert caught.value.code == "B-INST-005"
