"""Exact exchanges of the multimeter."""

import pytest
from known_drivers import IDENTIFY, after
from scripted import POLL, READ, refused, scripted

NO_ERROR = (b"ERRSTR?\n", b'0,"NO ERROR"\r\n')
START = IDENTIFY["hp_3458a"]


def configured(range_text: bytes) -> list[tuple[bytes, bytes | None]]:
    commands = (
        b"PRESET NORM\n", b"INBUF ON\n", b"END ALWAYS\n", b"DCI " + range_text + b"\n", b"NPLC 100\n", b"NDIG 8\n",
    )  # fmt: skip
    setting = [pair for command in (*commands, b"AZERO ON\n", b"TRIG HOLD\n") for pair in after(command, NO_ERROR)]
    return [*setting, (b"RANGE?\n", b" " + range_text + b"\r\n")]


def test_one_reading_is_triggered_and_awaited_by_serial_poll() -> None:
    waiting = [(POLL, 16)] * 3
    script = [*START, *configured(b"1.0E-01"), (b"TRIG SGL\n", None), *waiting, (POLL, 144)]
    script += [(READ, b" 1.000012345E-01\r\n"), NO_ERROR]
    with scripted("hp_3458a", script) as meter:
        assert meter.identify().model == "3458A"
        assert meter.configure_current(0.1) == 0.1
        assert meter.measure_current() == 0.1000012345
        assert meter.test_clock.now_ns() == 750_000_000
        assert max(meter.test_resource.timeouts_ms) <= 1000


@pytest.mark.parametrize(
    ("largest", "sent"),
    [(0.12, b"1.0E-01"), (0.2, b"1.0E+00"), (1.05, b"1.0E+00"), (3e-5, b"1.0E-04"), (1e-9, b"1.0E-07")],
)
def test_the_smallest_range_that_holds(largest: float, sent: bytes) -> None:
    with scripted("hp_3458a", [*START, *configured(sent)]) as meter:
        meter.configure_current(largest)


def test_a_range_that_was_not_taken_and_errors_of_a_command_are_told() -> None:
    script = [*START, *configured(b"1.0E-03")[:-1], (b"RANGE?\n", b" 1.0E-02\r\n")]
    with scripted("hp_3458a", script) as meter, refused("B-INST-011", "RANGE"):
        meter.configure_current(1e-3)
    errors = [(b"ERRSTR?\n", b'105,"INVALID PARAMETER -- X"\r\n'), NO_ERROR]
    with (
        scripted("hp_3458a", [*START, (b"PRESET NORM\n", None), *errors]) as meter,
        refused("B-INST-005", "105 INVALID PARAMETER -- X"),
    ):
        meter.configure_current(0.1)


def test_overload_and_no_reading_within_15_s() -> None:
    script = [*START, (b"TRIG SGL\n", None), (POLL, 128), (READ, b" 1.0E+38\r\n")]
    with scripted("hp_3458a", script) as meter, refused("B-INST-007"):
        meter.measure_current()
    script = [*START, (b"TRIG SGL\n", None), *[(POLL, 16)] * 61]
    with scripted("hp_3458a", script) as meter, refused("B-INST-012"):
        meter.measure_current()


def test_it_tells_how_far_it_has_drifted_from_its_last_autocalibration() -> None:
    script = [*START, (b"TEMP?\n", b" 3.72000000E+01\r\n"), (b"CAL? 175\n", b'3.65E+01,"acal dcv temp"\r\n')]
    with scripted("hp_3458a", script) as meter:
        found, limit, unit, _ = meter.self_calibration()
    assert found == pytest.approx(0.7)
    assert (limit, unit) == (1.0, "degC")
