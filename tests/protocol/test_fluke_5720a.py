"""Exact exchanges of the calibrator."""

import pytest
from known_drivers import IDENTIFY, MAKE_SAFE, after
from scripted import CLEAR, SILENT, TIMEOUT, refused, scripted

from bench.model.errors import InstrumentError

NO_FAULT = (b"FAULT?\n", b"0\n")
ON_NOT_SETTLED, ON_SETTLED, STANDBY = (b"ISR?\n", b"1\n"), (b"ISR?\n", b"4097\n"), (b"ISR?\n", b"4096\n")
START = IDENTIFY["fluke_5720a"]
OUT_10_MA = [
    *after(b"RANGELCK OFF\n", NO_FAULT),
    *after(b"OUT 1.0E-02 A, 0 HZ\n", NO_FAULT),
    (b"OUT?\n", b"1.000000E-02,A,0E+00\n"),
]
READY = [NO_FAULT, (b"OUT?\n", b"1.000000E-02,A,0E+00\n"), STANDBY]
ALTERED = [(256, "OFFSET active"), (512, "SCALE active"), (768, "OFFSET and SCALE active")]


def test_one_point_from_standby_to_standby() -> None:
    operate = [*READY, (b"OPER\n", None), ON_NOT_SETTLED, ON_NOT_SETTLED, ON_SETTLED, NO_FAULT]
    script = [*START, *MAKE_SAFE["fluke_5720a"], *OUT_10_MA, *operate, ON_SETTLED, *MAKE_SAFE["fluke_5720a"]]
    with scripted("fluke_5720a", script) as calibrator:
        identity = calibrator.identify()
        assert (identity.model, identity.serial) == ("5720A", "7005201")
        calibrator.standby()
        calibrator.output(0.01)
        calibrator.operate()
        assert calibrator.test_clock.now_ns() == 500_000_000
        assert calibrator.operating() is True
        calibrator.standby()


@pytest.mark.parametrize(
    ("current", "sent", "reply"),
    [
        (3e-5, b"OUT 3.0E-05 A, 0 HZ\n", b"3.00000E-05,A,0.0\n"),
        (0.1234567, b"OUT 1.234567E-01 A, 0 HZ\n", b"1.234567E-01,A,0\n"),
        (0.0, b"OUT 0.0E+00 A, 0 HZ\n", b"0E+00,A,0E+00\n"),
        (2.2, b"OUT 2.2E+00 A, 0 HZ\n", b"2.2E+00,A,0E+00\n"),
    ],
)
def test_currents_are_sent_in_full_and_in_ampere(current: float, sent: bytes, reply: bytes) -> None:
    script = [*START, *after(b"RANGELCK ON\n", NO_FAULT), *after(sent, NO_FAULT), (b"OUT?\n", reply)]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(current, range="locked")


@pytest.mark.parametrize("reply", [b"1.1E-02,A,0\n", b"0,A,0\n", b"-1.0E-02,A,0\n"])
def test_a_wrong_set_point_is_noticed(reply: bytes) -> None:
    script = [*START, *OUT_10_MA[:-1], (b"OUT?\n", reply)]
    wrong = pytest.raises(InstrumentError, match="reads back")
    with scripted("fluke_5720a", script) as calibrator, wrong as caught:
        calibrator.output(0.01)
    assert caught.value.code == "B-INST-011"


@pytest.mark.parametrize(
    ("current", "sent", "near", "far"),
    [
        (3e-5, b"3.0E-05", b"3.000005E-05", b"3.00002E-05"),
        (1e-3, b"1.0E-03", b"1.0000005E-03", b"1.000002E-03"),
        (0.1, b"1.0E-01", b"1.0000005E-01", b"1.000002E-01"),
        (1.0, b"1.0E+00", b"1.0000005E+00", b"1.000002E+00"),
    ],
)
def test_read_back_agrees_within_one_step_of_the_range(current: float, sent: bytes, near: bytes, far: bytes) -> None:
    setting = [*after(b"RANGELCK OFF\n", NO_FAULT), *after(b"OUT " + sent + b" A, 0 HZ\n", NO_FAULT)]
    script = [*START, *setting, (b"OUT?\n", near + b",A,0\n"), *setting, (b"OUT?\n", far + b",A,0\n")]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(current)
        with refused("B-INST-011"):
            calibrator.output(current)
        with refused("B-INST-010"):
            calibrator.operate()


@pytest.mark.parametrize("reply", [b"1.0E-02,V,0\n", b"1.0E-02,A,50\n", b"1.0E-02\n"])
def test_another_function_is_not_taken_for_a_dc_current(reply: bytes) -> None:
    once = [(b"OUT?\n", reply), (CLEAR, None)]
    script = [*START, *OUT_10_MA[:-1], *once, NO_FAULT, *once, NO_FAULT, *once]
    with scripted("fluke_5720a", script) as calibrator, refused("B-INST-004"):
        calibrator.output(0.01)


def test_faults_are_read_to_the_end_and_then_explained() -> None:
    faults = [(b"FAULT?\n", b"503\n"), (b"FAULT?\n", b"301\n"), NO_FAULT]
    explained = [(b"EXPLAIN? 503\n", b'"Over current limit"\n'), (b"EXPLAIN? 301\n", b'"No such range"\n')]
    script = [*START, (b"RANGELCK OFF\n", None), *faults, *explained]
    with scripted("fluke_5720a", script) as calibrator, refused("B-INST-005") as caught:
        calibrator.output(0.01)
    assert "503 Over current limit; 301 No such range" in caught.value.message


def test_operate_is_not_sent_without_an_output_with_a_fault_or_another_set_point() -> None:
    with scripted("fluke_5720a", []) as calibrator, refused("B-INST-010"):
        calibrator.operate()
    script = [*START, *OUT_10_MA, (b"FAULT?\n", b"77\n"), NO_FAULT, (b"EXPLAIN? 77\n", b'"x"\n')]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        with refused("B-INST-005"):
            calibrator.operate()
    script = [*START, *OUT_10_MA, NO_FAULT, (b"OUT?\n", b"2.0E-02,A,0\n")]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        with refused("B-INST-011"):
            calibrator.operate()


@pytest.mark.parametrize(("bits", "keys"), ALTERED)
def test_a_calibrator_left_with_an_offset_or_a_scale_factor_is_refused(bits: int, keys: str) -> None:
    with scripted("fluke_5720a", [*START[:2], (b"ISR?\n", b"%d\n" % (4096 | bits))]) as calibrator:
        with refused("B-INST-019", keys) as caught:
            calibrator.identify()
        assert f"press LOCAL, then {keys.removesuffix(' active')} at" in caught.value.next_step


@pytest.mark.parametrize(("bits", "keys"), ALTERED)
def test_operate_is_not_sent_with_an_offset_or_a_scale_factor(bits: int, keys: str) -> None:
    script = [*START, *OUT_10_MA, *READY[:-1], (b"ISR?\n", b"%d\n" % (4096 | bits))]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        with refused("B-INST-019", keys):
            calibrator.operate()


def test_an_offset_or_a_scale_factor_that_comes_later_is_seen() -> None:
    script = [*START, *OUT_10_MA, *READY, (b"OPER\n", None), ON_NOT_SETTLED, (b"ISR?\n", b"257\n"), (b"STBY\n", None)]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        with refused("B-INST-019", "OFFSET"):
            calibrator.operate()
    script = [*START, (b"ISR?\n", b"4609\n")]
    with scripted("fluke_5720a", script) as calibrator, refused("B-INST-019", "SCALE"):
        calibrator.operating()


def test_one_that_is_refused_is_made_safe_all_the_same_and_not_taken_for_prepared() -> None:
    on, off = (b"ISR?\n", b"4353\n"), (b"ISR?\n", b"4352\n")
    script = [*START[:2], on, (b"STBY\n", None), START[0], (b"STBY\n", None), NO_FAULT, off, *START, ON_SETTLED]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.make_safe()
        assert calibrator.operating() is True


def test_what_trips_or_never_settles_ends_in_standby() -> None:
    trip = [STANDBY, (b"FAULT?\n", b"505\n"), NO_FAULT, (b"EXPLAIN? 505\n", b'"Output tripped to standby"\n')]
    script = [*START, *OUT_10_MA, *READY, (b"OPER\n", None), ON_NOT_SETTLED, *trip, (b"STBY\n", None)]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        with refused("B-INST-013", "Output tripped to standby"):
            calibrator.operate()
    script = [*START, *OUT_10_MA, *READY, (b"OPER\n", None), *[ON_NOT_SETTLED] * 61, (b"STBY\n", None)]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        with refused("B-INST-012"):
            calibrator.operate()
        assert calibrator.test_clock.now_ns() == 15_000_000_000


def test_oper_is_never_sent_twice() -> None:
    script = [*START, *OUT_10_MA, *READY, (b"OPER\n", None)]
    script += [(b"ISR?\n", TIMEOUT), *SILENT, NO_FAULT, ON_SETTLED, NO_FAULT]
    with scripted("fluke_5720a", script) as calibrator:
        calibrator.output(0.01)
        calibrator.operate()


def test_a_trip_during_the_dwell_is_seen_and_its_fault_kept() -> None:
    script = [*START, STANDBY, (b"FAULT?\n", b"505\n"), NO_FAULT, (b"EXPLAIN? 505\n", b'"Tripped"\n')]
    with scripted("fluke_5720a", script) as calibrator:
        assert calibrator.operating() is False
        assert ("rx", '"Tripped"') in [line[1:3] for line in calibrator.test_log.lines]


def test_still_operating_after_standby_is_not_safe() -> None:
    with (
        scripted("fluke_5720a", [*START, (b"STBY\n", None), NO_FAULT, ON_SETTLED]) as calibrator,
        refused("B-INST-009"),
    ):
        calibrator.make_safe()


def test_the_input_buffer_is_not_overrun() -> None:
    with scripted("fluke_5720a", [*START, (b"X" * 127 + b"\n", None)]) as calibrator:
        calibrator.raw("X" * 127)
        with refused("B-INST-014"):
            calibrator.raw("X" * 128)


def test_it_tells_how_long_it_has_been_on_and_how_old_its_zeros_are() -> None:
    script = [*IDENTIFY["fluke_5720a"], (b"ONTIME?\n", b"95\n"), (b"CAL_DAYS? ZERO\n", b"12\n")]
    with scripted("fluke_5720a", script) as calibrator:
        assert calibrator.time_on_s() == 95 * 60
        assert calibrator.self_calibration()[:3] == (12.0, 30.0, "days")
