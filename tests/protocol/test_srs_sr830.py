"""Exact exchanges of the lock-in amplifier."""

from __future__ import annotations

from typing import Any

import pytest
from known_drivers import IDENTIFY, NO_EVENT
from scripted import BUS_ERROR, CLEAR, POLL, SILENT, TIMEOUT, Scripts, make, refused, scripted

from bench.model.clock import NS
from bench.model.errors import InputError
from instruments.srs_sr830 import SENSITIVITIES_V, TIME_CONSTANTS_S

START = IDENTIFY["srs_sr830"]
FIXED = ("FMOD 0", "RSLP 1", "HARM 1", "ISRC 0", "IGND 0", "ICPL 1", "ILIN 0", "RMOD 0")
QUIET = (b"LIAS?\n", b"0\n")


def order(command: str) -> list[tuple[Any, Any]]:
    """A setting that is accepted."""
    return [(f"{command}\n".encode(), None), *NO_EVENT]


def told(settings: tuple[str, ...]) -> list[tuple[Any, Any]]:
    """Each setting read back."""
    pairs = (setting.split(" ") for setting in settings)
    return [(f"{name}?\n".encode(), f"{value}\n".encode()) for name, value in pairs]


def configured(*chosen: str) -> list[tuple[Any, Any]]:
    """The whole set-up with these sensitivity, slope, time constant and synchronous filter."""
    orders = [pair for setting in (*FIXED, *chosen) for pair in order(setting)]
    for quantity in (1, 2):
        orders += [*order(f"OEXP {quantity},0,0"), (f"OEXP? {quantity}\n".encode(), b"0.00,0\n")]
    return [*orders, *told((*FIXED, *chosen)), QUIET]


def phased(phase: str, back: bytes) -> list[tuple[Any, Any]]:
    return [*order(f"PHAS {phase}"), (b"PHAS?\n", back), QUIET]


CHOSEN = ("SENS 26", "OFSL 3", "OFLT 10", "SYNC 1")


def test_a_set_up_a_phase_and_a_reading() -> None:
    reading = [(b"SNAP? 1,2,9\n", b"0.664867,-0.240767,1.0002\n"), QUIET]
    with scripted("srs_sr830", [*START, *configured(*CHOSEN), *phased("-270", b"90.00\n"), *reading]) as lock_in:
        lock_in.configure(1.0, 24, 1.0, "on")
        lock_in.set_phase(-270.0)
        assert lock_in.measure() == {
            "x_V": 0.664867, "y_V": -0.240767, "frequency_Hz": 1.0002, "overload": False, "unlocked": False,
        }  # fmt: skip


def test_voltages_and_sensitivity_are_those_before_the_divider() -> None:
    script = [*START, *configured("SENS 23", "OFSL 0", "OFLT 12", "SYNC 0")]
    script += [(b"SNAP? 1,2,9\n", b"0.0664867,-0.0240767,1.0\n"), QUIET]
    with scripted("srs_sr830", script, divider=10) as lock_in:
        lock_in.configure(10.0, 6, 1.0, "off")
        found = lock_in.measure()
    assert found["x_V"] == pytest.approx(0.664867, rel=1e-12)
    assert found["y_V"] == pytest.approx(-0.240767, rel=1e-12)


@pytest.mark.parametrize(
    ("status", "overload", "unlocked"),
    [(1, True, False), (2, True, False), (4, True, False), (8, False, True), (13, True, True), (112, False, False)],
)
def test_status_bits_are_values_of_the_reading(status: int, overload: bool, unlocked: bool) -> None:
    script = [*START, (b"SNAP? 1,2,9\n", b"0,0,0\n"), (b"LIAS?\n", b"%d\n" % status)]
    with scripted("srs_sr830", script) as lock_in:
        found = lock_in.measure()
    assert (found["overload"], found["unlocked"]) == (overload, unlocked)


def test_a_lost_status_counts_as_an_overload_and_a_lost_snapshot_is_asked_again() -> None:
    """Reading clears it: a second answer tells nothing of what came before the first."""
    script = [*START, (b"SNAP? 1,2,9\n", b"0.1,0.2,1\n"), (b"LIAS?\n", TIMEOUT), (POLL, 0), (CLEAR, None), QUIET]
    with scripted("srs_sr830", script) as lock_in:
        found = lock_in.measure()
    assert found["overload"] is True
    reply = b"0.1,0.2,1\n"
    script = [*START, (b"SNAP? 1,2,9\n", TIMEOUT), *SILENT, *NO_EVENT, (b"SNAP? 1,2,9\n", reply), QUIET]
    with scripted("srs_sr830", script) as lock_in:
        assert lock_in.measure()["overload"] is False


@pytest.mark.parametrize("reply", [b"0.1,0.2\n", b"0.1,0.2,1,4\n", b"a,b,c\n"])
def test_a_snapshot_of_another_form_is_no_reading(reply: bytes) -> None:
    again = [(CLEAR, None), *NO_EVENT, (b"SNAP? 1,2,9\n", reply)]
    script = [*START, (b"SNAP? 1,2,9\n", reply), *again, *again, (CLEAR, None)]
    with scripted("srs_sr830", script) as lock_in, refused("B-INST-004"):
        lock_in.measure()


def test_locked_asks_for_what_is_and_not_for_what_was() -> None:
    was, is_still = (b"LIAS?\n", b"8\n"), (b"LIAS?\n", b"8\n")
    with scripted("srs_sr830", [*START, was, QUIET, was, is_still]) as lock_in:
        assert lock_in.locked() is True
        assert lock_in.test_clock.now_ns() == NS // 2
        assert lock_in.locked() is False


@pytest.mark.parametrize(
    ("phase", "sent", "back"),
    [(0.0, "0", b"0.00\n"), (-180.0, "-180", b"-180.00\n"), (-180.0, "-180", b"180.00\n"), (541.0, "541", b"-179.00\n"),
     (33.123456, "33.123456", b"33.12\n"), (-360.0, "-360", b"-0.01\n")],
)  # fmt: skip
def test_phases_go_out_with_every_digit_and_read_back_but_for_turns(phase: float, sent: str, back: bytes) -> None:
    with scripted("srs_sr830", [*START, *phased(sent, back)]) as lock_in:
        lock_in.set_phase(phase)
        assert lock_in.phase_deg == phase


def test_what_reads_back_different_is_noticed() -> None:
    orders = configured("SENS 0", "OFSL 0", "OFLT 0", "SYNC 0")
    place = orders.index((b"OFLT?\n", b"0\n"))
    script = [*START, *orders[:place], (b"OFLT?\n", b"2\n")]
    with scripted("srs_sr830", script) as lock_in, refused("B-INST-011", r"OFLT\?"):
        lock_in.configure(1e-5, 6, 2e-9, "off")
    assert lock_in.kept == ()
    orders = configured(*CHOSEN)
    place = orders.index((b"OEXP? 1\n", b"0.00,0\n"))
    script = [*START, *orders[:place], (b"OEXP? 1\n", b"0.00,1\n")]
    with scripted("srs_sr830", script) as lock_in, refused("B-INST-011", "expand"):
        lock_in.configure(1.0, 24, 1.0, "on")
    script = [*START, *order("PHAS 90"), (b"PHAS?\n", b"90.03\n")]
    with scripted("srs_sr830", script) as lock_in, refused("B-INST-011", r"90\.03"):
        lock_in.set_phase(90.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((2.0, 24, 1.0, "on"), "time_constant 2.0 s is none of its settings; the nearest is 3 s"),
        ((1.0, 24, 0.6, "on"), "sensitivity 0.6 V is none of its settings; the nearest is 0.5 V"),
        ((1.0, 24, 10.0, "on"), "sensitivity 10.0 V is none of its settings; the nearest is 1 V"),
    ],
)
def test_what_is_not_in_its_lists_is_refused_with_the_nearest(arguments: tuple[Any, ...], message: str) -> None:
    with scripted("srs_sr830", []) as lock_in, refused("B-INST-008", message):
        lock_in.configure(*arguments)


def test_a_refused_setting_is_told_with_its_registers() -> None:
    script = [*START, (b"FMOD 0\n", None), (b"*ESR?\n", b"48\n"), (b"ERRS?\n", b"64\n")]
    with scripted("srs_sr830", script) as lock_in, refused("B-INST-005") as caught:
        lock_in.configure(1.0, 24, 1.0, "on")
    assert "execution error; command error; DSP failure" in str(caught.value)


def test_the_lists_are_those_of_the_manual() -> None:
    assert (len(SENSITIVITIES_V), SENSITIVITIES_V[0], SENSITIVITIES_V[8], SENSITIVITIES_V[26]) == (27, 2e-9, 1e-6, 1.0)
    assert (len(TIME_CONSTANTS_S), TIME_CONSTANTS_S[0], TIME_CONSTANTS_S[10], TIME_CONSTANTS_S[19]) == (
        20, 1e-5, 1.0, 3e4,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("option", "value"),
    [("reference", "index_c"), ("input", "bfg"), ("demodulation", "triangle"), ("divider", 0), ("divider", "10")],
)
def test_wrong_options(option: str, value: object) -> None:
    with pytest.raises(InputError, match=option) as caught, scripted("srs_sr830", [], **{option: value}):
        pass
    assert caught.value.code == "B-INST-020"


def reopened(answers: list[tuple[Any, Any]]) -> Any:
    """An amplifier, set up and at -90 degrees, whose bus fails once; ``answers`` follow the reopening."""
    script = [*START, *configured(*CHOSEN), *phased("-90", b"-90.00\n"), (b"SNAP? 1,2,9\n", BUS_ERROR)]
    lock_in = make("srs_sr830", script, rungs={"reopen": Scripts([[START[0], (CLEAR, None), *answers]])})
    lock_in.configure(1.0, 24, 1.0, "on")
    lock_in.set_phase(-90.0)
    return lock_in


def test_after_a_reopening_settings_and_phase_must_still_stand() -> None:
    """It was off for a moment: set as after power-on, its readings would be of another phase."""
    settings = told((*FIXED, *CHOSEN))
    other = [(b"SENS?\n", b"20\n") if question == b"SENS?\n" else (question, answer) for question, answer in settings]
    for answers, named in (
        ([*START[1:], *other[: len(FIXED) + 1]], r"SENS\?"),
        ([*START[1:], *settings, (b"PHAS?\n", b"0.00\n")], r"PHAS\?"),
    ):
        lock_in = reopened(answers)
        with refused("B-INST-011", named):
            lock_in.measure()


def test_another_amplifier_after_a_reopening_has_nothing_set() -> None:
    lock_in = reopened([(b"*IDN?\n", b"Stanford_Research_Systems,SR830,s/n50001,ver1.07\n")])
    with refused("B-INST-016"):
        lock_in.measure()
    assert (lock_in.kept, lock_in.phase_deg) == ((), None)


def test_a_phase_that_did_not_arrive_is_sent_again() -> None:
    lost = [(b"PHAS 180\n", None), (b"*ESR?\n", TIMEOUT), (POLL, 0), (CLEAR, None)]
    again = [*order("PHAS 180"), *[(b"PHAS?\n", b"180.00\n")] * 2, QUIET]
    script = [*START, *phased("90", b"90.00\n"), *lost, (b"PHAS?\n", b"90.00\n"), *again]
    with scripted("srs_sr830", script) as lock_in:
        lock_in.set_phase(90.0)
        lock_in.set_phase(180.0)


def test_a_phase_beyond_its_range_is_refused_before_anything_is_sent() -> None:
    for phase_deg in (730.0, -360.01):
        with scripted("srs_sr830", []) as lock_in, refused("B-INST-008"):
            lock_in.set_phase(phase_deg)
