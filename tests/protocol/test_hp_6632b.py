"""Exact exchanges of the supply of the unit under test."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after
from scripted import refused, scripted

from bench.model.errors import InstrumentError

START = IDENTIFY["hp_6632b"]
LIMITS = [
    *after(b"CURR 1.5E+00\n"), *after(b"CURR:PROT:STAT ON\n"), *after(b"OUTP:PROT:DEL 0.08\n"),
    *after(b"VOLT:PROT 1.8E+01\n"),
]  # fmt: skip
READ_BACK = [(b"CURR?\n", b"1.50000E+00\n"), (b"VOLT:PROT?\n", b"1.80000E+01\n"), (b"VOLT?\n", b"1.50000E+01\n")]
CONFIGURED = [*START, *LIMITS, *after(b"VOLT 1.5E+01\n"), *READ_BACK]


def test_limits_come_first_and_the_output_last() -> None:
    measured = [(b"MEAS:VOLT?\n", b"+1.49991E+01\n"), (b"MEAS:CURR?\n", b"+4.20000E-01\n")]
    off = [(b"OUTP OFF\n", None), NO_ERROR, (b"OUTP?\n", b"0\n")]
    on = [*READ_BACK, *after(b"OUTP ON\n"), (b"OUTP?\n", b"1\n"), (b"STAT:QUES:COND?\n", b"0\n")]
    with scripted("hp_6632b", [*CONFIGURED, *on, *measured, *off]) as supply:
        supply.configure(15.0, 1.5, 18.0)
        supply.output_on()
        assert supply.measure_voltage() == 14.9991
        assert supply.measure_current() == 0.42
        supply.output_off()


@pytest.mark.parametrize(("condition", "name"), [(b"1", "over-voltage"), (b"3", "over-voltage and over-current")])
def test_a_protection_that_somebody_left_latched_is_told(condition: bytes, name: str) -> None:
    on = [*READ_BACK, *after(b"OUTP ON\n"), (b"OUTP?\n", b"1\n"), (b"STAT:QUES:COND?\n", condition + b"\n")]
    off = [(b"OUTP OFF\n", None), NO_ERROR, (b"OUTP?\n", b"0\n")]
    with scripted("hp_6632b", [*CONFIGURED, *on, *off]) as supply:
        supply.configure(15.0, 1.5, 18.0)
        with refused("B-INST-018", name):
            supply.output_on()


def test_no_output_without_limits_that_protect_and_that_the_model_has() -> None:
    with scripted("hp_6632b", []) as supply, refused("B-INST-010"):
        supply.output_on()
    with scripted("hp_6632b", []) as supply, refused("B-INST-008", "not above voltage"):
        supply.configure(15.0, 1.5, 15.0)
    with scripted("hp_6632b", []) as supply, refused("B-INST-008", r"28\.0 V is above 20\.475"):
        supply.configure(28.0, 1.5, 22.0)


def test_limits_with_an_error_stop_before_the_voltage_and_do_not_count_as_set() -> None:
    error = [(b"SYST:ERR?\n", b'-222,"Data out of range"\n'), NO_ERROR]
    with scripted("hp_6632b", [*START, (b"CURR 1.5E+00\n", None), *error]) as supply:
        with refused("B-INST-005", "-222"):
            supply.configure(15.0, 1.5, 18.0)
        assert not supply.kept
    error = [(b"SYST:ERR?\n", b'-222,"Data out of range"\n'), NO_ERROR]
    with scripted("hp_6632b", [*CONFIGURED, (b"CURR 1.0E+00\n", None), *error]) as supply:
        supply.configure(15.0, 1.5, 18.0)
        with pytest.raises(InstrumentError):
            supply.configure(15.0, 1.0, 18.0)
        with refused("B-INST-010"):
            supply.output_on()


def test_an_output_that_stays_on_or_off_is_noticed() -> None:
    with scripted("hp_6632b", [*CONFIGURED, *READ_BACK, *after(b"OUTP ON\n"), (b"OUTP?\n", b"0\n")]) as supply:
        supply.configure(15.0, 1.5, 18.0)
        with refused("B-INST-011"):
            supply.output_on()
    stays_on = [*START, (b"OUTP OFF\n", None), NO_ERROR, (b"OUTP?\n", b"1\n")]
    with scripted("hp_6632b", stays_on) as supply, refused("B-INST-009"):
        supply.make_safe()
