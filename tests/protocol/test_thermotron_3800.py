"""Exact exchanges of the chamber in both dialects."""

import pytest
from known_drivers import IDENTIFY, after
from scripted import CLEAR, refused, scripted

from bench.model.errors import InputError

NO_ALARM = (b"ALRM1?\n", b"0\n")
START = IDENTIFY["thermotron_3800"]
START_8800 = [(b"IDEN?\n", b"Thermotron 8800 1.0\n"), NO_ALARM]
HELD = (b"MODE?\n", b"24\n")
CONFIRMED = [(b"MRMP1?\n", b"0.5\n"), (b"SETP1?\n", b"-10.0\n")]


def test_3800_answers_nothing_and_gets_more_than_a_second() -> None:
    script = [*START, *after(b"MRMP1,0.5\n", NO_ALARM), *after(b"SETP1,-10\n", NO_ALARM), *CONFIRMED]
    script += [*after(b"RUNM\n", NO_ALARM), (b"MODE?\n", b"16\n"), (b"PVAR1?\n", b"22.87\n")]
    with scripted("thermotron_3800", script) as chamber:
        chamber.set_temperature(-10.0, 0.5)
        chamber.run()
        assert chamber.measure_air() == 22.87
        assert chamber.test_clock.now_ns() == 3_600_000_000


def test_8800_completions_are_read() -> None:
    script = [*START_8800, (b"MRMP1,0.5\n", b"0\n"), NO_ALARM, (b"SETP1,-10\n", b"0\n"), NO_ALARM, *CONFIRMED]
    script += [(b"HOLD\n", b"0\n"), NO_ALARM, HELD, (b"STOP\n", b"0\n"), (b"MODE?\n", b"2\n"), (b"XYZ\n", b"0\n")]
    with scripted("thermotron_3800", script, dialect="8800") as chamber:
        chamber.set_temperature(-10.0, 0.5)
        chamber.hold()
        chamber.stop()
        assert chamber.raw("XYZ") == "0"
        assert chamber.test_clock.now_ns() == 0


def test_8800_refusals_are_told_but_for_the_stop_of_a_stopped_chamber() -> None:
    with (
        scripted("thermotron_3800", [*START_8800, (b"RUNM\n", b"3\n")], dialect="8800") as chamber,
        refused("B-INST-005", "completion 3"),
    ):
        chamber.run()
    with scripted(
        "thermotron_3800", [*START_8800, (b"STOP\n", b"5\n"), (b"MODE?\n", b"2\n")], dialect="8800"
    ) as chamber:
        chamber.stop()


def test_process_alarms_stop_and_deviation_alarms_do_not() -> None:
    deviation, process = (b"ALRM1?\n", b"1\n"), (b"ALRM1?\n", b"34\n")
    with scripted(
        "thermotron_3800", [*START, *after(b"HOLD\n", deviation), HELD, *after(b"HOLD\n", process)]
    ) as chamber:
        chamber.hold()
        with refused("B-INST-005", "high process limit alarm"):
            chamber.hold()
    with scripted("thermotron_3800", [*START, (b"ALRM1?\n", b"51\n"), (b"ALRM1?\n", b"2\n")]) as chamber:
        chamber.identify()
        assert chamber.drain_errors() == [
            "low deviation alarm",
            "high deviation alarm",
            "low process limit alarm",
            "high process limit alarm",
        ]
        assert chamber.drain_errors() == ["high deviation alarm"]


def test_a_chamber_that_does_not_run_stop_or_take_its_set_point_is_noticed() -> None:
    idle = (b"MODE?\n", b"2\n")
    script = [*START, *after(b"RUNM\n", NO_ALARM), *[idle] * 7]
    with scripted("thermotron_3800", script) as chamber, refused("B-INST-011"):
        chamber.run()
    for busy in ((b"MODE?\n", b"16\n"), (b"MODE?\n", b"1\n"), (b"MODE?\n", b"24\n")):
        script = [*START, (b"STOP\n", None), *[busy] * 7]
        with scripted("thermotron_3800", script) as chamber, refused("B-INST-009"):
            chamber.stop()
    script = [*START, *after(b"MRMP1,0.5\n", NO_ALARM), *after(b"SETP1,-10\n", NO_ALARM), CONFIRMED[0]]
    with scripted("thermotron_3800", [*script, (b"SETP1?\n", b"23.0\n")]) as chamber, refused("B-INST-011", "SETP1"):
        chamber.set_temperature(-10.0, 0.5)


def test_the_other_dialect_is_another_instrument_and_a_third_is_none() -> None:
    with (
        scripted("thermotron_3800", [START[0], (CLEAR, None), START[0]], dialect="8800") as chamber,
        refused("B-INST-002", "3800 REV 3"),
    ):
        chamber.identify()
    with (
        pytest.raises(InputError, match="neither '3800' nor '8800'") as caught,
        scripted("thermotron_3800", [], dialect="2800"),
    ):
        pass
    assert caught.value.code == "B-INST-020"
