"""Exact exchanges of the logger."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after, slow
from scripted import CLEAR, scripted

from bench.model.errors import InputError, InstrumentError

START = IDENTIFY["agilent_34970a"]
SCAN = [*START, *after(b"ROUT:SCAN (@101,102)\n")]


def test_scan() -> None:
    with scripted(
        "agilent_34970a", [*SCAN, *slow(b"READ?\n", b"+2.31230000E+01,-9.98700000E+00\n"), NO_ERROR]
    ) as logger:
        assert logger.scan() == [23.123, -9.987]


def test_other_channels_and_thermocouples() -> None:
    start = [*START[:2], *after(b"CONF:TEMP TC,K,(@203)\n"), *after(b"UNIT:TEMP C,(@203)\n")]
    script = [*start, *after(b"ROUT:SCAN (@203)\n"), *slow(b"READ?\n", b"+2.5E+01\n"), NO_ERROR]
    with scripted("agilent_34970a", script, channels=[203], thermocouple="K") as logger:
        assert logger.scan() == [25.0]


def test_an_open_thermocouple() -> None:
    script = [*SCAN, *slow(b"READ?\n", b"+2.3E+01,+9.90000000E+37\n")]
    with scripted("agilent_34970a", script) as logger, pytest.raises(InstrumentError) as caught:
        logger.scan()
    assert caught.value.code == "B-INST-007"


def test_missing_readings() -> None:
    once = [*slow(b"READ?\n", b"+2.3E+01\n"), (CLEAR, None)]
    script = [*SCAN, *once, NO_ERROR, *once, NO_ERROR, *once]
    due = pytest.raises(InstrumentError, match="2 readings are due")
    with scripted("agilent_34970a", script) as logger, due as caught:
        logger.scan()
    assert caught.value.code == "B-INST-004"


@pytest.mark.parametrize(
    "options", [{"channels": []}, {"channels": [1]}, {"channels": ["101"]}, {"channels": 101}, {"thermocouple": "TT"}]
)
def test_options(options: dict[str, object]) -> None:
    with pytest.raises(InputError) as caught, scripted("agilent_34970a", [], **options):
        pass
    assert caught.value.code == "B-INST-020"
