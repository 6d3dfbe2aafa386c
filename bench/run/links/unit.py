"""The unit under test behind a link that comes back: is it the same one, did it go on counting, what does it need?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from bench.frame import LinkBatch
from bench.model.clock import NS
from bench.model.errors import LinkError, RunError
from bench.plan import PlannedCommand, PlannedUnit
from bench.run.context import RunContext
from bench.run.links.reader import ANSWER, LinkReader, UnitAnswer, answers_of
from bench.run.steps.proof import names

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
