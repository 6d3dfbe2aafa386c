"""The unit under test behind a link that comes back: is it the same one, did it go on counting, what does it need?

And what it must prove before the first stimulus: a current moves the right counter of the right channel the right way;
where several units share a campaign it moves nothing in any other one, and each says the serial number of its slot.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.frame import LinkBatch
from bench.model.clock import NS
from bench.model.errors import LinkError, RunError
from bench.model.quantities import Values
from bench.plan import UNIT, Plan, PlannedCommand, PlannedUnit
from bench.record import RecordRow
from bench.run.bus.reader import ANSWER, LinkReader, UnitAnswer, answers_of
from bench.run.context import RunContext

IDENTIFY = "identify"  # name of the unit command, under unit_commands, whose answer tells who the unit is
DONE = 0  # status of an answer
_SLACK_S = 1.0  # by which the counter may differ from what the time predicts
_SLACK_RELATIVE = 1e-3  # and per time of the outage: far more than an oscillator, far less than a wrap

Verdict = Literal["none", "pending", "same", "other"]


@dataclass(frozen=True)
class CounterMark:
    """Where the counter of a link stood: as it was sent, at its receive time."""

    raw: int
    t_ns: int

    @classmethod
    def of(cls, reader: LinkReader) -> CounterMark:
        """Return the newest good frame of a link."""
        return cls(reader.last_raw, reader.last_frame_ns)


NOWHERE = CounterMark(-1, -1)


def went_on(
    before: CounterMark, after: CounterMark, rate_Hz: float | None, wrap: int, *, buffered: bool = False
) -> bool:
    """Return whether a counter stands where the time since ``before`` predicts; True where no rate predicts anything.

    A unit that was restarted, and another unit, begin anew somewhere else. What comes from a buffer (``buffered``) may
    be as old as the last frame before.
    """
    if not rate_Hz or before.raw < 0:
        return True
    due = (after.t_ns - before.t_ns) / NS * rate_Hz
    miss = (after.raw - before.raw - due + wrap / 2) % wrap - wrap / 2
    slack = min(wrap / 4, max(2.0, _SLACK_S * rate_Hz + _SLACK_RELATIVE * due))
    return -(due if buffered else slack) <= miss <= slack


class Unit:
    """What the plan says to the unit, and who the unit said it is; ``of``: which one, where several share a campaign.

    The answer to the step ``identify`` of the plan is kept; a plan without this step has no way to ask. Tests of the
    unit are neither asked nor sent again: the units of one session are several, and a FLASH is erased once.
    """

    def __init__(self, context: RunContext, of: PlannedUnit | None = None) -> None:
        self._context, self._of = context, of
        steps = (step for step in context.plan.steps if isinstance(step, PlannedCommand) and not step.item)
        self._steps = [step for step in steps if of is None or step.role in of.names]
        self._identify = next((step for step in self._steps if step.name == IDENTIFY), None)
        self._known: bytes | None = context.unit_answer
        self._asked = False
        self._heard: bytes | None = None
        if self._identify is not None and self._identify.role in self._readers:
            self._readers[self._identify.role].listeners.append(self._hear)

    @property
    def _readers(self) -> dict[str, LinkReader]:
        return self._context.acquisition.readers

    def again(self, number: int) -> str:
        """Send the last command to the unit before step ``number`` again; its name, "" if nothing was sent."""
        left_out = self._context.decided.left_out
        told = (step for step in self._steps if step.number < number and step.number not in left_out)
        before = [step for step in told if step.name != IDENTIFY]
        return before[-1].name if before and self._send(before[-1]) else ""

    def ask(self) -> bool:
        """Ask who is there; False if the command could not be sent now."""
        self._asked, self._heard = True, None
        return self._identify is not None and self._send(self._identify)

    def verdict(self) -> Verdict:
        """Return what the answer to ``ask`` says: none (the plan has no way to ask), pending, same, other."""
        if self._identify is None:
            return "none"
        if self._heard is None:
            return "pending"
        return "same" if self._is_known(self._heard) else "other"

    def other(self, when: str, where: str) -> RunError:
        """The error of a run that finds another unit."""
        return RunError(
            "B-RUN-025",
            f"another unit answers {when}: {self.answer!r}, expected {self.expected!r}",
            where=where,
            next_step="connect the unit of this campaign, then 'bench resume SESSION'",
        )

    @property
    def answer(self) -> str:
        """The newest answer, as text."""
        return (self._heard or b"").decode("ascii", "replace")

    @property
    def expected(self) -> str:
        """Who the unit should be."""
        return self._serial if self._known is None else self._known.decode("ascii", "replace")

    @property
    def _serial(self) -> str:
        if self._of is not None:
            return self._of.serial
        uut: Any = self._context.plan.campaign.get("uut", {})
        return str(uut.get("serial", ""))

    def _is_known(self, answer: bytes) -> bool:
        """Return the answer of before; if it was never asked, the serial number of the campaign is a word of it."""
        if self._known is not None:
            return answer == self._known
        return not self._serial or names(answer, self._serial)

    def _hear(self, batch: LinkBatch) -> None:
        frames = batch.messages.get(ANSWER)
        if frames is None or not len(frames) or self._identify is None:
            return
        for answer in answers_of(ANSWER, frames):
            if self._is_asked_for(self._identify, answer):
                self._heard = answer.payload
                if self._asked:
                    continue
                self._known = self._known or self._heard
                if self._heard != self._known:
                    self._context.stop.fail(self.other("after the run was stopped", self._identify.role))

    def _is_asked_for(self, identify: PlannedCommand, answer: UnitAnswer) -> bool:
        """The unit says who it is, and was not asked by a test."""
        if answer.command != identify.code or answer.status != DONE:
            return False
        return answer.sequence < 0 or self._readers[identify.role].numbers.asks(answer.sequence)

    def _send(self, step: PlannedCommand) -> bool:
        reader = self._readers[step.role]
        if reader.lost:
            return False
        number = reader.numbers.new() if reader.numbered else -1
        if step is self._identify:
            reader.numbers.ask(number)
        try:
            reader.send(reader.command(step.code, step.payload, number))
        except LinkError:
            return False
        return True


TOLERANCE = 0.1


def check_wiring(row: RecordRow, plan: Plan, where: str) -> None:
    """Judge one wiring record.

    No other channel may count more than a tenth of what the current would give it; the channel under current must
    count within 10 % of current x time / charge per pulse on NPP (positive current) or PPP (negative current) and
    almost nothing on the other. Of a unit beside the one under current no channel may count.

    Raises: RunError B-RUN-052 (current reached another unit), B-RUN-051 (another channel), B-RUN-050 (wrong counter,
            polarity or amount).
    """
    conditions = row.window.conditions
    beside = next((unit for unit in plan.units if unit.slot == conditions.get("beside")), None)
    if beside is not None:
        _check_unit_beside(row, plan, beside, where)
        return
    _check_others(row, plan.campaign, where)
    _check_own(row, plan.campaign, where)


def _check_unit_beside(row: RecordRow, plan: Plan, driven: PlannedUnit, where: str) -> None:
    """Judge the record of a unit while another one is driven."""
    expected, counts = _expected(row, plan.campaign), row.sums["npp"] + row.sums["ppp"]
    number = max(expected, key=lambda channel: counts[channel - 1] / expected[channel])
    moved, found = counts[number - 1], plan.unit_of(row.window.conditions[UNIT])
    if found is not None and moved > TOLERANCE * expected[number]:
        raise RunError(
            "B-RUN-052",
            f"the current for unit {driven.serial} in slot {driven.slot} moves channel {number} of unit {found.serial} "
            f"in slot {found.slot}: counted {moved} there; cables or links of the two slots are exchanged",
            where=where,
            next_step="check the cables of both slots from the switch and from their ports, then start again",
        )


def _check_own(row: RecordRow, campaign: Values, where: str) -> None:
    conditions = row.window.conditions
    channel, polarity = int(conditions["channel"]), int(conditions["polarity"])
    expected = _expected(row, campaign)[channel]
    moved, still = ("npp", "ppp") if polarity > 0 else ("ppp", "npp")
    right, wrong = int(row.sums[moved][channel - 1]), int(row.sums[still][channel - 1])
    level = f"{'+' if polarity > 0 else '-'}{conditions['current_A']:g} A"
    if abs(right - expected) > TOLERANCE * expected or wrong > TOLERANCE * expected:
        raise RunError(
            "B-RUN-050",
            f"channel {channel}, {level}: counted {right} {moved} and {wrong} {still}, "
            f"expected {expected:.0f} {moved} within {TOLERANCE:.0%}",
            where=where,
            next_step="check polarity and channel of the cable between switch and unit, then start again",
        )


def _check_others(row: RecordRow, campaign: Values, where: str) -> None:
    channel = int(row.window.conditions["channel"])
    expected, counts = _expected(row, campaign), row.sums["npp"] + row.sums["ppp"]
    excess = counts - [TOLERANCE * expected.get(number + 1, expected[channel]) for number in range(len(counts))]
    excess[channel - 1] = 0.0
    if (excess > 0).any():
        guilty = int(np.argmax(excess)) + 1
        raise RunError(
            "B-RUN-051",
            f"the current of channel {channel} moves channel {guilty}: counted {counts[guilty - 1]} there and "
            f"{counts[channel - 1]} on channel {channel}",
            where=where,
            next_step="check the cable and the crosspoints, then start again",
        )


def _expected(row: RecordRow, campaign: Values) -> dict[int, float]:
    """Return what the current of a record would count on each channel, by its charge per pulse."""
    charge_C = float(row.window.conditions["current_A"]) * row.frames / float(campaign["rate_Hz"])
    return {int(entry["number"]): charge_C / float(entry["k0_C"]) for entry in campaign["channels"]}


def names(answer: bytes, serial: str) -> bool:
    """Return whether a serial number is a word of what a unit answers."""
    return serial in re.split(r"[\s,;]+", answer.decode("ascii", "replace"))


def check_identity(plan: Plan, step: PlannedCommand, answer: bytes) -> None:
    """Judge what a unit says of itself against the serial number of its slot; nothing to judge where there is one unit.

    Raises: RunError B-RUN-026, naming the slot where the unit that answers should be.
    """
    unit = plan.unit_of(step.role)
    if unit is None or names(answer, unit.serial):
        return
    other = next((other for other in plan.units if names(answer, other.serial)), None)
    exchanged = "" if other is None else f"; it is the unit of slot {other.slot}: links or units are exchanged"
    raise RunError(
        "B-RUN-026",
        f"slot {unit.slot} answers {answer.decode('ascii', 'replace')!r}, expected {unit.serial}{exchanged}",
        where=step.role,
        next_step="check the links of the slots and the serial numbers under 'units', then start again",
    )
