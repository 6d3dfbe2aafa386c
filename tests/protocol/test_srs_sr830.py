"""Exact exchanges of the lock-in amplifier; how a row is read stands in ``tests/support/simulated/exchanges.py``."""

from typing import Any

import pytest
from exchanges import Row, does, exchange, gives, refuses, row
from scripted import Scripts, make, refused

from bench.model.clock import NS
from instruments.srs_sr830 import SENSITIVITIES_V, TIME_CONSTANTS_S

NAME = "srs_sr830"
FIXED = ("FMOD 0", "RSLP 1", "HARM 1", "ISRC 0", "IGND 0", "ICPL 1", "ILIN 0", "RMOD 0")
CHOSEN = ("SENS 26", "OFSL 3", "OFLT 10", "SYNC 1")
ALL = *CHOSEN, *FIXED
QUIET, SNAPSHOT = "LIAS? -> 0", "SNAP? 1,2,9 -> "
EXPAND = "OEXP? 1 -> 0.00,0 | OEXP? 2 -> 0.00,0"


def orders(*settings: str) -> str:
    """Settings that are accepted."""
    return " | ".join(f"{setting}!" for setting in settings)


def told(*settings: str) -> str:
    """Settings read back."""
    return " | ".join("{}? -> {}".format(*setting.split(" ")) for setting in settings)


def configured(*chosen: str) -> str:
    """The whole set-up with these sensitivity, slope, time constant and synchronous filter."""
    return f"<start> | {told(*FIXED)} | {EXPAND} | {orders(*chosen)} | {told(*chosen)} | {QUIET}"


def phased(phase: str, back: str, *kept: str) -> str:
    return f"{FIXED_TOLD} | {told(*kept)} | PHAS {phase}! | PHAS? -> {back} | {QUIET}"


FIXED_TOLD = f"{told(*FIXED)} | {EXPAND}"
SET_UP = does("configure", 1.0, 24, 1.0, "on")
PLAIN = {"x_V": 0.664867, "y_V": -0.240767, "frequency_Hz": 1.0002, "overload": False, "unlocked": False}
DIVIDED = {"x_V": pytest.approx(0.664867, rel=1e-12), "y_V": pytest.approx(-0.240767, rel=1e-12)}
STATUS = [(1, True, False), (2, True, False), (4, True, False), (8, False, True), (13, True, True), (112, False, False)]
PHASES = [
    (0.0, "0", "0.00"), (-180.0, "-180", "-180.00"), (-180.0, "-180", "180.00"), (541.0, "541", "-179.00"),
    (33.123456, "33.123456", "33.12"), (-360.0, "-360", "-0.01"),
]  # fmt: skip
LOST = "<timeout> | <silent>"
SMALL = ("SENS 0", "OFSL 0", "OFLT 0", "SYNC 0")
NOT_LISTED = [
    ((2.0, 24, 1.0, "on"), "time_constant 2.0 s is none of its settings; the nearest is 3 s"),
    ((1.0, 24, 0.6, "on"), "sensitivity 0.6 V is none of its settings; the nearest is 0.5 V"),
    ((1.0, 24, 10.0, "on"), "sensitivity 10.0 V is none of its settings; the nearest is 1 V"),
]
IN_DOUBT = f"{FIXED_TOLD} | PHAS 180 | *ESR? -> {LOST} | PHAS? -> 90.00 | PHAS 180! | PHAS? -> 180.00 | PHAS? -> 180.00"

ROWS = [
    row(NAME, "a set-up, a phase and a reading",
        f"{configured(*CHOSEN)} | {phased('-270', '90.00', *ALL)} | {SNAPSHOT}0.664867,-0.240767,1.0002 | {QUIET}",
        SET_UP, does("set_phase", -270.0), gives(PLAIN, "measure")),
    row(NAME, "voltages and sensitivity are those before the divider",
        f"{configured('SENS 23', 'OFSL 0', 'OFLT 12', 'SYNC 0')} | {SNAPSHOT}0.0664867,-0.0240767,1.0 | {QUIET}",
        does("configure", 10.0, 6, 1.0, "off"), gives(DIVIDED, "measure"), divider=10),
    *[row(NAME, f"status {status} is in the reading", f"<start> | {SNAPSHOT}0,0,0 | LIAS? -> {status}",
          gives({"overload": overload, "unlocked": unlocked}, "measure")) for status, overload, unlocked in STATUS],
    row(NAME, "a lost status counts as an overload",  # reading clears it: a second answer tells nothing of before
        f"<start> | {SNAPSHOT}0.1,0.2,1 | LIAS? -> {LOST} | {QUIET}", gives({"overload": True}, "measure")),
    row(NAME, "a lost snapshot is asked again",
        f"<start> | {SNAPSHOT}{LOST} | <ok> | {SNAPSHOT}0.1,0.2,1 | {QUIET}",
        gives({"overload": False}, "measure")),
    *[row(NAME, f"{reply} is no snapshot",
          "<start> | " + " | <ok> | ".join([f"{SNAPSHOT}{reply} | <clear>"] * 3), refuses("B-INST-004", "", "measure"))
      for reply in ("0.1,0.2", "0.1,0.2,1,4", "a,b,c")],
    row(NAME, "locked is what is and not what was", f"<start> | LIAS? -> 8 | {QUIET} | LIAS? -> 8 | LIAS? -> 8",
        gives(True, "locked"), gives(False, "locked"), leaves={"test_clock.now_ns": NS}),
    *[row(NAME, f"phase {sent} goes out with every digit, {back} reads back", f"<start> | {phased(sent, back)}",
          does("set_phase", at), leaves={"kept": (("PHAS?", at, 0.0101, "deg", 360),)}) for at, sent, back in PHASES],
    row(NAME, "a setting that reads back different is noticed",
        configured(*SMALL).partition("OFLT? -> 0")[0] + "OFLT? -> 2",
        refuses("B-INST-011", r"OFLT\?", "configure", 1e-5, 6, 2e-9, "off"), leaves={"kept": ()}),
    row(NAME, "what somebody left is set", configured(*CHOSEN)
        .replace("ICPL? -> 1", "ICPL? -> 0 | ICPL 1! | ICPL? -> 1")
        .replace("OEXP? 2 -> 0", "OEXP? 2 -> 50.00,1 | OEXP 2,0,0! | OEXP? 2 -> -0"), SET_UP),
    row(NAME, "an output that stays expanded is noticed",
        configured(*CHOSEN).partition("OEXP? 1")[0] + "OEXP? 1 -> 0.00,1 | OEXP 1,0,0! | OEXP? 1 -> 0.00,1",
        refuses("B-INST-011", "expand", "configure", 1.0, 24, 1.0, "on")),
    row(NAME, "another phase is noticed", "<start> | " + phased("90", "90.03").replace(f" | {QUIET}", ""),
        refuses("B-INST-011", r"90\.03", "set_phase", 90.0)),
    *[row(NAME, f"not in its lists: {message.partition(' is')[0]}", "",
          refuses("B-INST-008", message, "configure", *arguments)) for arguments, message in NOT_LISTED],
    row(NAME, "a refused setting is told with its registers",
        "<start> | FMOD? -> 1 | FMOD 0 | *ESR? -> 48 | ERRS? -> 64",
        refuses("B-INST-005", "execution error; command error; DSP failure", "configure", 1.0, 24, 1.0, "on")),
    row(NAME, "a phase that did not arrive is sent again", f"<start> | {phased('90', '90.00')} | {IN_DOUBT} | {QUIET}",
        does("set_phase", 90.0), does("set_phase", 180.0)),
    row(NAME, "a phase beyond its range is not sent", "", refuses("B-INST-008", "", "set_phase", 730.0),
        refuses("B-INST-008", "", "set_phase", -360.01)),
]  # fmt: skip


@pytest.mark.parametrize("case", ROWS, ids=lambda case: case.claim)
def test_an_exchange(case: Row) -> None:
    case.play()


def test_the_lists_are_those_of_the_manual() -> None:
    assert (len(SENSITIVITIES_V), *(SENSITIVITIES_V[at] for at in (0, 8, 26))) == (27, 2e-9, 1e-6, 1.0)
    assert (len(TIME_CONSTANTS_S), *(TIME_CONSTANTS_S[at] for at in (0, 10, 19))) == (20, 1e-5, 1.0, 3e4)


SETTINGS = told(*ALL)
OWN = "<clear> | <start:1>"


@pytest.mark.parametrize(
    ("answers", "code", "named"),
    [
        (f"{OWN} | <ok> | {SETTINGS.partition('FMOD?')[0]}FMOD? -> 1", "B-INST-011", r"FMOD\?"),
        (f"{OWN} | <ok> | {SETTINGS} | PHAS? -> 0.00", "B-INST-011", r"PHAS\?"),
        ("<clear> | OUTX 1;*IDN? -> Stanford_Research_Systems,SR830,s/n50001,ver1.07", "B-INST-016", "s/n48123"),
    ],
)
def test_after_a_reopening_settings_and_phase_must_still_stand_on_this_amplifier(
    answers: str, code: str, named: str
) -> None:
    """It was off for a moment: set as after power-on, its readings would be of another phase."""
    again: Any = Scripts([exchange(NAME, answers)])
    script = f"{configured(*CHOSEN)} | {phased('-90', '-90.00', *ALL)} | SNAP? 1,2,9 -> <bus error>"
    lock_in = make(NAME, exchange(NAME, script), rungs={"reopen": again})
    lock_in.configure(1.0, 24, 1.0, "on")
    lock_in.set_phase(-90.0)
    with refused(code, named):
        lock_in.measure()
    if code == "B-INST-016":
        assert lock_in.kept == ()
