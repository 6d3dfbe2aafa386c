"""Exact exchanges of the rail multimeter."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after, slow
from scripted import scripted

from bench.model.errors import InstrumentError

START = [*IDENTIFY["agilent_34401a"], *after(b"CONF:VOLT:DC\n")]


def test_voltage() -> None:
    with scripted("agilent_34401a", [*START, *slow(b"READ?\n", b"+5.00012345E+00\n"), NO_ERROR]) as meter:
        assert meter.measure_voltage() == 5.00012345


def test_an_error_of_the_reading_is_told() -> None:
    script = [*START, *slow(b"READ?\n", b"+5.0E+00\n"), (b"SYST:ERR?\n", b'+531,"Insufficient memory"\n'), NO_ERROR]
    with scripted("agilent_34401a", script) as meter, pytest.raises(InstrumentError, match="531") as caught:
        meter.measure_voltage()
    assert caught.value.code == "B-INST-005"
