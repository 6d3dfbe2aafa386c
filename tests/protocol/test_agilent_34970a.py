"""Exact exchanges of the logger."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after, slow
from scripted import CLEAR, refused, scripted

from bench.model.errors import InputError, InstrumentError

START = IDENTIFY["agilent_34970a"]
SCAN = [*START, *after(b"ROUT:SCAN (@101,102)\n")]


def test_scans_of_these_and_other_channels_and_thermocouples() -> None:
    with scripted(
        "agilent_34970a", [*SCAN, *slow(b"READ?\n", b"+2.31230000E+01,-9.98700000E+00\n"), NO_ERROR]
    ) as logger:
        assert logger.scan() == [23.123, -9.987]
    start = [*START[:8], *after(b"CONF:TEMP TC,K,(@203)\n"), *after(b"UNIT:TEMP C,(@203)\n")]
    junction = (b"TEMP:TRAN:TC:RJUN:TYPE? (@203)\n", b"INT\n")
    script = [*start, junction, *after(b"ROUT:SCAN (@203)\n"), *slow(b"READ?\n", b"+2.5E+01\n"), NO_ERROR]
    with scripted("agilent_34970a", script, channels=[203], thermocouple="K") as logger:
        assert logger.scan() == [25.0]


JUNCTION, FIXED = b"TEMP:TRAN:TC:RJUN:TYPE? (@101,102)\n", b"INT,FIX\n"
TO_INTERNAL = after(b"TEMP:TRAN:TC:RJUN:TYPE INT,(@101,102)\n")


def test_a_reference_junction_that_somebody_fixed_is_the_internal_one_again_or_refused() -> None:
    script = [*START[:-1], (JUNCTION, FIXED), *TO_INTERNAL, (JUNCTION, b"INT, INT\n")]
    with scripted("agilent_34970a", script) as logger:
        logger.identify()
    script = [*START[:-1], (JUNCTION, FIXED), *TO_INTERNAL, (JUNCTION, FIXED)]
    with scripted("agilent_34970a", script) as logger, refused("B-INST-011", "'INT,FIX', but 'INT,INT' was set"):
        logger.identify()


def test_an_open_thermocouple_or_a_missing_reading_is_no_scan() -> None:
    script = [*SCAN, *slow(b"READ?\n", b"+2.3E+01,+9.90000000E+37\n")]
    with scripted("agilent_34970a", script) as logger, refused("B-INST-007"):
        logger.scan()
    once = [*slow(b"READ?\n", b"+2.3E+01\n"), (CLEAR, None)]
    script = [*SCAN, *once, NO_ERROR, *once, NO_ERROR, *once]
    due = pytest.raises(InstrumentError, match="2 readings are due")
    with scripted("agilent_34970a", script) as logger, due as caught:
        logger.scan()
    assert caught.value.code == "B-INST-004"


@pytest.mark.parametrize(
    "options",
    [
        {"channels": []},
        {"channels": [1]},
        {"channels": ["101"]},
        {"channels": 101},
        {"thermocouple": "TT"},
        {"thermocouple": ""},
        {"thermocouple": "none"},
    ],
)
def test_options(options: dict[str, object]) -> None:
    with pytest.raises(InputError) as caught, scripted("agilent_34970a", [], **options):
        pass
    assert caught.value.code == "B-INST-020"


def four_wires(start: list[tuple[bytes, bytes | None]]) -> list[tuple[bytes, bytes | None]]:
    settings = [b"CONF:FRES 1.0E+02,(@103)\n", b"FRES:NPLC 10,(@103)\n", b"ROUT:SCAN (@103)\n"]
    return [*start, *(pair for setting in settings for pair in after(setting))]


def test_resistance_of_one_channel_and_not_of_open_leads() -> None:
    script = [*four_wires(START), *slow(b"READ?\n", b"+1.00003270E+02\n"), NO_ERROR]
    with scripted("agilent_34970a", script) as logger:
        assert logger.measure_resistance(103, 100.0, 10) == 100.00327
    script = [*four_wires(START), *slow(b"READ?\n", b"+9.90000000E+37\n")]
    with scripted("agilent_34970a", script) as logger, refused("B-INST-007"):
        logger.measure_resistance(103, 100.0, 10)


@pytest.mark.parametrize("channel", [100, 111, 120, 411])
def test_a_channel_that_senses_for_another_is_not_sent(channel: int) -> None:
    with scripted("agilent_34970a", []) as logger, refused("B-INST-008"):
        logger.measure_resistance(channel, 100.0, 10)


@pytest.mark.parametrize("thermocouple", [103, 113])
def test_a_channel_of_a_thermocouple_is_not_taken_for_a_resistance(thermocouple: int) -> None:
    with scripted("agilent_34970a", [], channels=[thermocouple]) as logger, refused("B-INST-008"):
        logger.measure_resistance(103, 100.0, 10)


def test_a_unit_without_thermocouples() -> None:
    """Nothing is configured for them, and there is nothing to scan."""
    script = [*four_wires(START[:8]), *slow(b"READ?\n", b"+1.0E+02\n"), NO_ERROR]
    with scripted("agilent_34970a", script, thermocouple="none", channels=[]) as logger:
        assert logger.measure_resistance(103, 100.0, 10) == 100.0
        with refused("B-INST-008"):
            logger.scan()
