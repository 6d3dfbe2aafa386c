"""Judges of the interfaces: IO loop-back, SPI, SCI, CAN.

Source: GNC-module paper, section 3 (2) 1 to 3; a random pair of IO lines is not enough, all ordered pairs are due.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Answer, Findings, whole

LINES = (1, 2, 3, 4)
_SERIAL_BYTES = 12


def judge_io(answers: Sequence[Answer], limits: Limits) -> Findings:
    """Each of the 12 ordered pairs of lines at both levels: the input reads the level, no other line follows."""
    found = Findings()
    for one in whole(answers, found):
        if one.asked:
            line = f"IO {one.asked['output']} to IO {one.asked['input']}"
            level, read = one.asked["level"], one.fields["read"]
            found.expect(read == level, one, f"{line}: level", level, read)
            found.expect(one.fields["others"] == 0, one, f"{line}: lines that must rest", 0, bin(one.fields["others"]))
    asked = {(one.asked.get("output"), one.asked.get("input"), one.asked.get("level")) for one in answers}
    for output, source in permutations(LINES, 2):
        for level in (0, 1):
            if (output, source, level) not in asked:
                found.missing(answers[-1].exchange.begin_s, f"IO {output} to IO {source} at level {level}")
    return found


def judge_spi(answers: Sequence[Answer], limits: Limits) -> Findings:
    """The word comes back, and the IO lines beside the bus saw the same."""
    found = Findings()
    for one in whole(answers, found):
        word = one.asked.get("word")
        for name, what in (("received", "word that came back"), ("observed", "word on the IO lines")):
            value = one.fields[name]
            found.expect(value == word, one, what, _word(word), _word(value))
    return found


def judge_sci(answers: Sequence[Answer], limits: Limits) -> Findings:
    """Return what was sent comes back unchanged, and it is not nothing."""
    found = Findings()
    for one in whole(answers, found):
        sent, echo = str(one.asked.get("pattern", "")), str(one.fields["echo"])
        found.expect(bool(sent), one, "nothing was sent", "a pattern", "none")
        found.expect(echo == sent, one, "echo", sent, echo)
    return found


def judge_can(answers: Sequence[Answer], limits: Limits) -> Findings:
    """As SCI, and under the identifier it was sent with."""
    found = judge_sci(answers, limits)
    for one in answers:
        if one.fields:
            sent, received = one.asked.get("identifier"), one.fields["identifier"]
            found.expect(received == sent, one, "identifier", sent, received)
    return found


def judge_identity(answers: Sequence[Answer], limits: Limits) -> Findings:
    """The serial number that the module gives is that of the unit that should be in the socket, its first 12 signs."""
    found = Findings()
    for one in whole(answers, found):
        unit = str(one.exchange.conditions.get("unit", ""))[:_SERIAL_BYTES]
        told = bytes.fromhex(one.fields["unit_serial"]).decode("ascii", "replace").strip(" \0")
        found.expect(not unit or told == unit, one, "serial number", unit, told)
    return found


def _word(value: int | None) -> str:
    return "unknown" if value is None else f"{value:#06x}"
