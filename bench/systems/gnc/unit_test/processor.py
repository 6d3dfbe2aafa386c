"""Judges of the processor: arithmetic, timer, memories.

Source: GNC-module paper, table 1, rows 1 to 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Answer, Findings, Measured, whole

OPERATIONS = ("addition", "subtraction", "multiplication", "division")
SETTINGS_us = (500, 1000, 2000, 5000)
REGIONS = ("RAM", "SDRAM", "SPI FLASH", "internal FLASH")
PATTERNS = ("0x55", "0xAA", "address")
_FLASH = (2, 3)
_WRITE_READ, _ERASE, _BLANK, _PROGRAM, _VERIFY = range(5)
_FLASH_ORDER = (_ERASE, _BLANK, _PROGRAM, _VERIFY)
_STEPS = ("write and read", "erase", "blank check", "program", "verify")
_WORD = 4  # bytes
_TICK_STD_us = 12.0**-0.5  # intervals are whole microseconds


def judge_cpu(answers: Sequence[Answer], limits: Limits) -> Findings:
    """All four operations must be done, none of them wrong, and no memory cell either."""
    found = Findings()
    for one in whole(answers, found):
        fields = one.fields
        for name, done, wrong in zip(OPERATIONS, fields["operations"], fields["wrong"], strict=True):
            first = f"{fields['first_expected']} was due, {fields['first_received']} came first"
            found.expect(done > 0, one, f"{name}: not done", "more than 0 operations", done)
            found.expect(wrong == 0, one, f"{name}: {wrong} of {done} results are wrong", 0, f"{wrong} ({first})")
        found.expect(
            fields["memory_wrong"] == 0, one, "registers and memory: read back wrong", 0, fields["memory_wrong"]
        )
    return found


def judge_timer(answers: Sequence[Answer], limits: Limits) -> Findings:
    """At every setting as many interrupts as asked for, 20 at least, none of the intervals off by more than 1 %."""
    found, most, least = Findings(), limits["timer_interval_error"], int(limits["timer_ticks"])
    for one in whole(answers, found):
        setting, ticks = one.asked.get("setting_us", 0), one.asked.get("ticks", 0)
        if not setting:
            continue
        intervals = one.fields["intervals_us"][:ticks]
        due = max(ticks, least)
        found.expect(len(intervals) >= due, one, f"{setting} us: too few intervals", due, len(intervals))
        heard = one.fields["interrupts"]
        found.expect(heard == ticks and heard >= least, one, f"{setting} us: interrupts", due, heard)
        errors = [value / setting - 1.0 for value in intervals]
        outside = sum(abs(error) > most for error in errors)
        worst = max(errors, key=abs, default=0.0)
        what = f"{setting} us: {outside} of {len(errors)} intervals off by more than {100 * most:g} %"
        found.expect(not outside, one, what, setting, f"{setting * (1 + worst):.0f} at worst")
        if errors:
            place = {"setting_ms": setting / 1000.0}
            std = _TICK_STD_us / setting
            found.measured.append(Measured("timer_interval_error", "1", worst, std, place, most, len(errors)))
    asked = {one.asked.get("setting_us") for one in answers}
    for setting in SETTINGS_us:
        if setting not in asked:
            found.missing(answers[-1].exchange.begin_s, f"setting {setting} us")
    return found


def judge_memory(answers: Sequence[Answer], limits: Limits) -> Findings:
    """RAM and SDRAM with every pattern; FLASH erased, blank, programmed, verified in this order, erased once each."""
    found = Findings()
    for one in whole(answers, found):
        asked, fields = one.asked, one.fields
        if not asked:
            continue
        what = f"{_place(one)}: {fields['wrong']} of {fields['checked']} words are wrong"
        first = f"at {fields['address']:#x} {fields['received']:#010x} in place of {fields['expected']:#010x}"
        found.expect(fields["wrong"] == 0, one, what, 0, f"{fields['wrong']} ({first})")
        due = asked["length"] // _WORD
        text = f"{_place(one)}: words that were checked"
        found.expect(0 < due == fields["checked"], one, text, max(due, 1), fields["checked"])
    _complete_memory(answers, found)
    for region in _FLASH:
        _erases([one for one in answers if one.asked.get("region") == region and one.fields], found)
    return found


def _place(one: Answer) -> str:
    step = _STEPS[one.asked["operation"]] if one.asked["operation"] < len(_STEPS) else str(one.asked["operation"])
    pattern = f" {PATTERNS[one.asked['pattern']]}" if one.asked["operation"] == _WRITE_READ else ""
    return f"{REGIONS[one.asked['region']]} {step}{pattern}"


def _complete_memory(answers: Sequence[Answer], found: Findings) -> None:
    at_s = answers[-1].exchange.begin_s
    for region, name in enumerate(REGIONS):
        mine = [one.asked for one in answers if one.asked.get("region") == region]
        if region in _FLASH:
            steps = [asked["operation"] for asked in mine]
            if not _in_order(steps):
                found.missing(at_s, f"{name}: erase, blank check, program and verify in this order")
            continue
        patterns = {asked["pattern"] for asked in mine if asked["operation"] == _WRITE_READ}
        for number, pattern in enumerate(PATTERNS):
            if number not in patterns:
                found.missing(at_s, f"{name} with pattern {pattern}")


def _in_order(steps: Sequence[int]) -> bool:
    """Return True if the steps hold a whole FLASH cycle, in its order."""
    left = iter(steps)
    return all(step in left for step in _FLASH_ORDER)


def _erases(answers: Sequence[Answer], found: Findings) -> None:
    """Every erase that was asked for counts once, whatever had to be repeated on the link; nothing else erases."""
    for before, after in pairwise(answers):
        due = before.fields["erases"] + (after.asked["operation"] == _ERASE)
        found.expect(
            after.fields["erases"] == due, after, f"{_place(after)}: count of erases", due, after.fields["erases"]
        )
