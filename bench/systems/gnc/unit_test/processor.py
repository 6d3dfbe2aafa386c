"""Judges of the processor and its interfaces: arithmetic, timer, memories; IO loop-back, SPI, SCI, CAN, serial number.

Source: GNC-module paper, table 1, rows 1 to 3, and section 3 (2) 1 to 3; a random pair of IO lines is not enough, all
ordered pairs are due.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, permutations

from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Answer, Findings, Measured, whole
from bench.systems.gnc.wording import say

OPERATIONS = ("addition", "subtraction", "multiplication", "division")
SETTINGS_us = (500, 1000, 2000, 5000)
REGIONS = ("RAM", "SDRAM", "SPI FLASH", "internal FLASH")
PATTERNS = ("0x55", "0xAA", "address")
_FLASH = (2, 3)
_WRITE_READ, _ERASE, _BLANK, _PROGRAM, _VERIFY = range(5)
_FLASH_ORDER = (_ERASE, _BLANK, _PROGRAM, _VERIFY)
_STEPS = ("write_read", "erase", "blank_check", "program", "verify")
_WORD = 4  # bytes
_TICK_STD_us = 12.0**-0.5  # intervals are whole microseconds
LINES = (1, 2, 3, 4)
_SERIAL_BYTES = 12


def judge_cpu(answers: Sequence[Answer], limits: Limits) -> Findings:
    """All four operations must be done, none of them wrong, and no memory cell either."""
    findings = Findings()
    for answer in whole(answers, findings):
        fields = answer.fields
        for name, done, wrong in zip(OPERATIONS, fields["operations"], fields["wrong"], strict=True):
            operation = say(f"cpu.{name}")
            first = say("cpu.first", count=wrong, due=fields["first_expected"], came=fields["first_received"])
            findings.expect(done > 0, answer, say("cpu.not_done", operation=operation), say("cpu.some"), done)
            what = say("cpu.wrong", operation=operation, wrong=wrong, done=done)
            findings.expect(wrong == 0, answer, what, 0, first)
        findings.expect(fields["memory_wrong"] == 0, answer, say("cpu.memory"), 0, fields["memory_wrong"])
    return findings


def judge_timer(answers: Sequence[Answer], limits: Limits) -> Findings:
    """At every setting as many interrupts as asked for, 20 at least, none of the intervals off by more than 1 %."""
    findings, most, least = Findings(), limits["timer_interval_error"], int(limits["timer_ticks"])
    for answer in whole(answers, findings):
        setting, ticks = answer.asked.get("setting_us", 0), answer.asked.get("ticks", 0)
        if not setting:
            continue
        intervals = answer.fields["intervals_us"][:ticks]
        due = max(ticks, least)
        findings.expect(len(intervals) >= due, answer, say("timer.few", setting=setting), due, len(intervals))
        heard = answer.fields["interrupts"]
        findings.expect(heard == ticks and heard >= least, answer, say("timer.interrupts", setting=setting), due, heard)
        errors = [value / setting - 1.0 for value in intervals]
        outside = sum(abs(error) > most for error in errors)
        worst = max(errors, key=abs, default=0.0)
        what = say("timer.outside", setting=setting, outside=outside, count=len(errors), most=100 * most)
        findings.expect(not outside, answer, what, setting, say("timer.worst", worst=setting * (1 + worst)))
        if errors:
            place = {"setting_ms": setting / 1000.0}
            std = _TICK_STD_us / setting
            findings.measured.append(Measured("timer_interval_error", "1", worst, std, place, most, len(errors)))
    asked = {answer.asked.get("setting_us") for answer in answers}
    for setting in SETTINGS_us:
        if setting not in asked:
            findings.missing(answers[-1].exchange.begin_s, say("timer.setting", setting=setting))
    return findings


def judge_memory(answers: Sequence[Answer], limits: Limits) -> Findings:
    """RAM and SDRAM with every pattern; FLASH erased, blank, programmed, verified in this order, erased once each."""
    findings = Findings()
    for answer in whole(answers, findings):
        asked, fields = answer.asked, answer.fields
        if not asked:
            continue
        what = say("memory.wrong", place=_place(answer), wrong=fields["wrong"], checked=fields["checked"])
        first = say(
            "memory.first",
            count=fields["wrong"],
            address=fields["address"],
            came=fields["received"],
            due=fields["expected"],
        )
        findings.expect(fields["wrong"] == 0, answer, what, 0, first)
        due = asked["length"] // _WORD
        text = say("memory.checked", place=_place(answer))
        findings.expect(0 < due == fields["checked"], answer, text, max(due, 1), fields["checked"])
    _complete_memory(answers, findings)
    for region in _FLASH:
        _erases([answer for answer in answers if answer.asked.get("region") == region and answer.fields], findings)
    return findings


def _place(answer: Answer) -> str:
    operation, region = answer.asked["operation"], REGIONS[answer.asked["region"]]
    if operation == _WRITE_READ:
        return say("memory.write_read", region=region, pattern=PATTERNS[answer.asked["pattern"]])
    step = say(f"memory.{_STEPS[operation]}") if operation < len(_STEPS) else str(operation)
    return say("memory.step", region=region, step=step)


def _complete_memory(answers: Sequence[Answer], findings: Findings) -> None:
    at_s = answers[-1].exchange.begin_s
    for region, name in enumerate(REGIONS):
        mine = [answer.asked for answer in answers if answer.asked.get("region") == region]
        if region in _FLASH:
            steps = [asked["operation"] for asked in mine]
            if not _in_order(steps):
                findings.missing(at_s, say("memory.cycle", region=name))
            continue
        patterns = {asked["pattern"] for asked in mine if asked["operation"] == _WRITE_READ}
        for number, pattern in enumerate(PATTERNS):
            if number not in patterns:
                findings.missing(at_s, say("memory.pattern", region=name, pattern=pattern))


def _in_order(steps: Sequence[int]) -> bool:
    """Return True if the steps hold a whole FLASH cycle, in its order."""
    left = iter(steps)
    return all(step in left for step in _FLASH_ORDER)


def _erases(answers: Sequence[Answer], findings: Findings) -> None:
    """Every erase that was asked for counts once, whatever had to be repeated on the link; nothing else erases."""
    for before, after in pairwise(answers):
        due = before.fields["erases"] + (after.asked["operation"] == _ERASE)
        findings.expect(
            after.fields["erases"] == due, after, say("memory.erases", place=_place(after)), due, after.fields["erases"]
        )


def judge_io(answers: Sequence[Answer], limits: Limits) -> Findings:
    """Each of the 12 ordered pairs of lines at both levels: the input reads the level, no other line follows."""
    findings = Findings()
    for answer in whole(answers, findings):
        if answer.asked:
            line = say("io.line", output=answer.asked["output"], input=answer.asked["input"])
            level, read = answer.asked["level"], answer.fields["read"]
            findings.expect(read == level, answer, say("io.level", line=line), level, read)
            findings.expect(
                answer.fields["others"] == 0, answer, say("io.others", line=line), 0, bin(answer.fields["others"])
            )
    asked = {(answer.asked.get("output"), answer.asked.get("input"), answer.asked.get("level")) for answer in answers}
    for output, source in permutations(LINES, 2):
        for level in (0, 1):
            if (output, source, level) not in asked:
                line = say("io.line", output=output, input=source)
                findings.missing(answers[-1].exchange.begin_s, say("io.at_level", line=line, level=level))
    return findings


def judge_spi(answers: Sequence[Answer], limits: Limits) -> Findings:
    """The word comes back, and the IO lines beside the bus saw the same."""
    findings = Findings()
    for answer in whole(answers, findings):
        word = answer.asked.get("word")
        for name in ("received", "observed"):
            value = answer.fields[name]
            findings.expect(value == word, answer, say(f"spi.{name}"), _word(word), _word(value))
    return findings


def judge_sci(answers: Sequence[Answer], limits: Limits) -> Findings:
    """Return what was sent comes back unchanged, and it is not nothing."""
    findings = Findings()
    for answer in whole(answers, findings):
        sent, echo = str(answer.asked.get("pattern", "")), str(answer.fields["echo"])
        findings.expect(bool(sent), answer, say("sci.nothing"), say("sci.pattern"), say("sci.none"))
        findings.expect(echo == sent, answer, say("sci.echo"), sent, echo)
    return findings


def judge_can(answers: Sequence[Answer], limits: Limits) -> Findings:
    """As SCI, and under the identifier it was sent with."""
    findings = judge_sci(answers, limits)
    for answer in answers:
        if answer.fields:
            sent, received = answer.asked.get("identifier"), answer.fields["identifier"]
            findings.expect(received == sent, answer, say("can.identifier"), sent, received)
    return findings


def judge_identity(answers: Sequence[Answer], limits: Limits) -> Findings:
    """The serial number that the module gives is that of the unit that should be in the socket, its first 12 signs."""
    findings = Findings()
    for answer in whole(answers, findings):
        unit = str(answer.exchange.conditions.get("unit", ""))[:_SERIAL_BYTES]
        told = bytes.fromhex(answer.fields["unit_serial"]).decode("ascii", "replace").strip(" \0")
        findings.expect(not unit or told == unit, answer, say("identify.serial"), unit, told)
    return findings


def _word(value: int | None) -> str:
    return say("unknown") if value is None else f"{value:#06x}"
