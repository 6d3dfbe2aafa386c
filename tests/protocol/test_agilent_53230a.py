"""Exact exchanges of the counter."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after, slow
from scripted import POLL, SILENT, refused, scripted

from bench.model.errors import InstrumentError

START = IDENTIFY["agilent_53230a"]
GATE_1_S = [*after(b'FUNC "FREQ 1"\n'), *after(b"FREQ:GATE:SOUR TIME\n"), *after(b"FREQ:GATE:TIME 1.0E+00\n")]


def test_frequency_with_every_digit_and_no_call_as_long_as_the_gate() -> None:
    reading = [*slow(b"READ?\n", b"+1.000000012345E+07\n"), NO_ERROR]
    with scripted("agilent_53230a", [*START, *GATE_1_S, *reading]) as counter:
        assert counter.measure_frequency(1.0) == 10000000.12345
        assert max(counter.test_resource.timeouts_ms) == 1000
        assert counter.test_clock.now_ns() == 250_000_000


def test_a_reading_that_never_comes_or_says_no_signal_is_none() -> None:
    once = [(b"READ?\n", None), *[(POLL, 0)] * 13, *SILENT]
    script = [*START, *GATE_1_S, *once, NO_ERROR, *once, NO_ERROR, *once]
    late = pytest.raises(InstrumentError, match=r"'READ\?' within 3 s")
    with scripted("agilent_53230a", script) as counter, late as caught:
        counter.measure_frequency(1.0)
    assert caught.value.code == "B-INST-001"
    assert counter.test_clock.now_ns() == 9_000_000_000
    script = [*START, *GATE_1_S, *slow(b"READ?\n", b"+9.91E+37\n")]
    with scripted("agilent_53230a", script) as counter, refused("B-INST-007"):
        counter.measure_frequency(1.0)


@pytest.mark.parametrize(
    ("source", "events", "locked"), [(b"EXT", b"0", True), (b"EXT", b"1024", False), (b"INT", b"0", False)]
)
def test_reference(source: bytes, events: bytes, locked: bool) -> None:
    script = [*START, (b"ROSC:SOUR?\n", source + b"\n"), (b"STAT:QUES:EVEN?\n", b"+" + events + b"\n")]
    with scripted("agilent_53230a", script) as counter:
        assert counter.reference_locked() is locked


def test_a_counter_without_its_reference_is_not_prepared() -> None:
    error = (b"SYST:ERR?\n", b'+1111,"External reference not found"\n')
    with scripted("agilent_53230a", [*START[:3], error, NO_ERROR, *START]) as counter:
        with refused("B-INST-005", "External reference"):
            counter.identify()
        assert counter.identity is None
        assert counter.identify().model == "53230A"
