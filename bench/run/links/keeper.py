"""A link that is lost or silent does not end a run: the run stands still until the link and the unit are back.

Lost: the port is gone. It is opened again under the same identity. Silent: the port is there, and no good frame comes
(a stuck stream is silent too). Frames must come again, and the unit must be the one of before, before the run goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

from bench.model.clock import NS, to_ns
from bench.model.errors import LinkError, RunError
from bench.model.events import Link
from bench.model.ports import Effect, drivers_of
from bench.plan import PlannedCommand, PlannedRecord, PlannedSend, PlannedSoak, Step
from bench.run.bus.port import InstrumentLink, Reopenable, cure, kernel_counts, readers_beside
from bench.run.bus.reader import LinkReader, age_s, is_silent, is_stale, silence_s
from bench.run.context import RunContext
from bench.run.links.unit import NOWHERE, CounterMark, Unit, went_on
from bench.run.observers import Observer, Order
from bench.run.stop import LINKS, SUSPEND_S

REOPEN_NS = NS // 2
GOOD_FRAMES = 3  # in a row of time; a port that was opened in the middle of a frame costs one
ASK_NS = 2 * NS  # an identity that is not answered is asked again
NUDGE_NS, NUDGE_AGAIN_NS = 2 * NS, 10 * NS  # without frames: when the last command is sent again
LIMIT_S = 600.0  # of standing still for a link
KERNEL_NS = 5 * NS
ACT_NS = NS // 2  # how long what a person has switched off may still send


@dataclass
class Kept:
    """One link of ``unit``, by its ``serial`` number where several share a campaign.

    ``trouble`` began at ``since_ns`` behind ``mark`` and ``frames`` good frames; ``held_ns``: since when the run stands
    still for it, 0 if it does not. ``switched``: it sent nothing before an act of a person, so another act may end it.
    ``how`` it comes back, in words; ``compared``: its counter was; ``commanded``: what the unit was told again.
    ``beside``: who else had the port open when frames were last ``missed``.
    """

    reader: LinkReader
    unit: Unit
    serial: str = ""
    trouble: Literal["", "lost", "silent", "shared"] = ""
    reason: str = ""
    since_ns: int = 0
    held_ns: int = 0
    tried_ns: int = 0
    nudged_ns: int = 0
    asked_ns: int = 0
    frames: int = 0
    mark: CounterMark = NOWHERE
    how: list[str] = field(default_factory=list)
    compared: bool = False
    commanded: list[str] = field(default_factory=list)
    missed: int = 0
    beside: str = ""
    counted: dict[str, int] | None = None
    behind: int = 0
    switched: bool = False

    @property
    def by(self) -> str:
        """Who asks the run to stand still."""
        return f"link {self.reader.name}"


class LinkKeeper(Observer):
    """Judges links and brings them back. Its state is under the acquisition's lock.

    A silent link counts only once it has sent a frame and while a record or soak needs it: from the next one that
    begins after a command to the unit or to its supply on; a link that a person switches on, such as a radar, once it
    has sent a frame since the last act of a person. A lost one counts while a command is to be sent over it,
    too. In the phase ``finally`` nothing counts.
    """

    order = Order.SAFETY
    vital = True

    def __init__(self, context: RunContext) -> None:
        self._context = context
        of_plan = {unit.serial: Unit(context, unit) for unit in context.plan.units} or {"": Unit(context)}
        owners = {link: unit.serial for unit in context.plan.units for link in unit.links.values()}
        self._kept = [
            Kept(reader, of_plan[owners.get(name, "")], owners.get(name, ""))
            for name, reader in context.acquisition.readers.items()
        ]
        self._drivers = drivers_of(context.instruments)
        self._step = 0
        self._needed = False
        self._commanded = ""  # the link that the step under way sends a command over
        self._power_changed = False
        self._asked = False  # the step under way is an act of a person
        self._acted_ns = 0  # when the last act ended
        self._judged_ns, self._woke_ns = context.clock.now_ns(), 0
        self._kernel_ns = context.clock.now_ns()
        for kept in self._links:
            kept.reader.kept = True
            kept.counted = kernel_counts(kept.reader.link)
            if not context.clock.virtual:
                self._tell(kept, state="open", kernel_counts=kept.counted is not None)

    @property
    def _links(self) -> list[Kept]:
        """The links that are looked after; not those of a unit that was left out."""
        out = self._context.decided.units_out
        return [kept for kept in self._kept if kept.serial not in out] if out else self._kept

    def step(self, step: Step, at_s: float) -> None:
        self._step = step.number
        self._commanded = step.role if isinstance(step, PlannedCommand) else ""
        self._person(bool(step.sets))
        if isinstance(step, PlannedRecord | PlannedSoak):
            self._needed, self._power_changed = True, False
        elif isinstance(step, PlannedCommand):
            self._needed = False
        elif isinstance(step, PlannedSend) or Effect.POWER in step.effects(self._drivers.get(step.role, {})):
            self._needed, self._power_changed = False, True

    def _person(self, asked: bool) -> None:
        """A step begins that is an act of a person on the bench, or another one."""
        if self._asked:
            self._acted_ns = self._context.clock.now_ns()
        for kept in self._links if asked else ():
            kept.switched = kept.switched or kept.reader.last_frame_ns < 0
        self._asked = asked

    # --- judging ---------------------------------------------------------------------------------------------------

    def judge(self) -> None:
        """Ask the run to stand still for a link that is lost or silent; to be called with the lock held.

        Where nothing was read because this machine stood still, no unit was silent: it is given as long again.
        """
        now_ns = self._context.clock.now_ns()
        if now_ns - self._judged_ns > SUSPEND_S * NS and not self._context.clock.virtual:
            self._woke_ns = now_ns
        self._judged_ns = now_ns
        for kept in self._links:
            if kept.reader.lost and kept.trouble != "lost":
                self._begin(kept, "lost", kept.reader.lost, now_ns)
            elif not kept.trouble and self._expected(kept) and is_silent(kept.reader, now_ns, self._woke_ns):
                reason = f"no good frame for {age_s(kept.reader, now_ns):.1f} s"
                self._begin(kept, "silent", reason, now_ns)
            if kept.trouble and not kept.held_ns and self._expected(kept):
                kept.held_ns = now_ns
                self._context.stop.holds.hold(kept.by, kept.reason)

    def _expected(self, kept: Kept) -> bool:
        """Return whether the run needs the link now."""
        if not self._active:
            return False
        if kept.trouble == "lost" and kept.reader.name == self._commanded:
            return True
        if kept.reader.last_frame_ns < 0:
            return False
        if kept.switched and kept.trouble != "lost" and kept.reader.last_frame_ns < self._acted_ns + ACT_NS:
            return False
        return self._needed or (kept.trouble == "lost" and not self._power_changed)

    @property
    def _active(self) -> bool:
        """False from the moment on when the bench is put away."""
        return self._context.stop.interruptible and not self._context.stop.over

    def _begin(self, kept: Kept, trouble: Literal["lost", "silent", "shared"], reason: str, now_ns: int) -> None:
        if not kept.trouble:
            kept.since_ns = now_ns
        kept.trouble, kept.reason = trouble, reason
        self._remember(kept, now_ns)
        self._tell(kept, state=trouble, reason=reason)

    @property
    def calm(self) -> bool:
        """Whether no link is in trouble; to be asked with the lock held."""
        return not any(kept.trouble for kept in self._links)

    # --- bringing back ---------------------------------------------------------------------------------------------

    def service(self) -> None:
        """A few times a second, on a thread that may wait for a port."""
        acquisition, now_ns = self._context.acquisition, self._context.clock.now_ns()
        with acquisition.lock:
            if any(_left_over(kept.reader, now_ns) for kept in self._links):
                acquisition.decode()
            self.judge()
        for kept in self._links if self._active else ():
            self._look_beside(kept, now_ns)
            if kept.reader.lost:
                self._reopen(kept, now_ns)
            elif kept.trouble:
                with acquisition.lock:
                    acquisition.decode()
                    self.judge()
                    self._welcome(kept, now_ns)
            if kept.trouble:
                self._give_up(kept, now_ns)
        self._note(now_ns)

    def _look_beside(self, kept: Kept, now_ns: int) -> None:
        """Where frames are missing, stand still for whoever reads the port too."""
        missed = kept.reader.decoder.counts.lost + kept.reader.decoder.counts.bad
        if kept.beside or kept.trouble == "silent" or missed != kept.missed:
            kept.missed, kept.beside = missed, readers_beside(kept.reader.link)
        if kept.beside and kept.trouble in ("", "silent") and self._expected(kept):
            with self._context.acquisition.lock:
                self._begin(kept, "shared", f"process {kept.beside} has the port open too", now_ns)
                kept.held_ns = 0  # a hold for silence names the cause from now on

    def _reopen(self, kept: Kept, now_ns: int) -> None:
        link = kept.reader.link
        if now_ns - kept.tried_ns < REOPEN_NS or not isinstance(link, Reopenable):
            return
        kept.tried_ns = now_ns
        self._context.acquisition.unlisten(kept.reader)
        try:
            link.reopen()
        except LinkError:
            return
        with self._context.acquisition.lock:
            self._context.acquisition.catch_up()  # frames that came before count for nothing now
            self._remember(kept, now_ns, "port opened again")
        kept.counted = kernel_counts(link)
        kept.reader.found()
        self._context.acquisition.listen(kept.reader)

    @staticmethod
    def _remember(kept: Kept, now_ns: int, *how: str) -> None:
        """What follows is compared with how the link is now."""
        kept.frames, kept.mark = kept.reader.decoder.counts.frames, CounterMark.of(kept.reader)
        kept.nudged_ns, kept.asked_ns, kept.how = now_ns, 0, list(how)
        kept.compared, kept.commanded = False, []

    def _welcome(self, kept: Kept, now_ns: int) -> None:
        """Frames must come to this run alone, then the unit must be the one of before."""
        if kept.beside:
            return
        if kept.reader.last_frame_ns < 0:
            self._end(kept, now_ns)  # it never sent anything: there is nothing to compare
            return
        if kept.reader.decoder.counts.frames - kept.frames < GOOD_FRAMES or is_silent(kept.reader, now_ns):
            self._nudge(kept, now_ns)
            return
        if not kept.compared:
            self._compare(kept)
        verdict = kept.unit.verdict() if kept.asked_ns else "pending"
        if verdict == "pending" and (not kept.asked_ns or now_ns - kept.asked_ns > ASK_NS):
            kept.unit.ask()
            kept.asked_ns = now_ns
            verdict = kept.unit.verdict()
        if verdict == "other":
            self._context.stop.fail(kept.unit.other("after the link came back", kept.reader.name))
        elif verdict != "pending":
            kept.how.append(f"unit answers {kept.unit.answer!r}" if verdict == "same" else "identity not asked")
            self._end(kept, now_ns)

    def _compare(self, kept: Kept) -> None:
        reader, kept.compared = kept.reader, True
        sizes = [item.counter.size for item in reader.definition.layout.messages if item.counter is not None]
        wrap = 1 << (8 * sizes[0]) if sizes else 1 << 62
        buffered = isinstance(reader.link, InstrumentLink) or kept.mark.t_ns < self._woke_ns
        if went_on(kept.mark, CounterMark.of(reader), reader.definition.rate_Hz, wrap, buffered=buffered):
            kept.how.append("counter went on")
            return
        kept.how.append("counter began anew: the unit was restarted")
        self._command_again(kept)

    def _nudge(self, kept: Kept, now_ns: int) -> None:
        """No frames: the unit may have been restarted and wait for its command."""
        if now_ns - max(kept.nudged_ns, self._woke_ns) > (NUDGE_AGAIN_NS if kept.commanded else NUDGE_NS):
            kept.nudged_ns = now_ns
            self._command_again(kept)

    def _command_again(self, kept: Kept) -> None:
        name = kept.unit.again(self._step)
        if name and name not in kept.commanded:
            kept.commanded.append(name)
            kept.how.append(f"{name!r} sent again")

    def _end(self, kept: Kept, now_ns: int) -> None:
        seconds = (now_ns - kept.since_ns) / NS
        how = "; ".join(kept.how or ["frames come again"])
        self._tell(kept, state="back", seconds=seconds, how=how)
        kept.trouble, kept.held_ns, kept.asked_ns = "", 0, 0
        self._context.stop.holds.release(kept.by)

    def _give_up(self, kept: Kept, now_ns: int) -> None:
        if not kept.held_ns or now_ns - max(kept.held_ns, self._woke_ns) < LIMIT_S * NS:
            return
        code = "B-RUN-024" if kept.reader.lost else "B-RUN-021"
        self._context.stop.fail(
            RunError(
                code,
                f"not back after {LIMIT_S:g} s: {kept.reason}",
                where=kept.reader.name,
                next_step=f"{cure(kept.reader.link)}, then 'bench resume SESSION'",
            )
        )

    # --- what others see -------------------------------------------------------------------------------------------

    def _tell(self, kept: Kept, **told: Any) -> None:
        self._context.event(Link(link=kept.reader.name, **told))

    def _note(self, now_ns: int) -> None:
        for kept in self._links:
            stale = bool(kept.reader.lost) or is_stale(kept.reader, now_ns)
            self._context.health.note(f"{kept.reader.name}_stale", float(stale))
        if now_ns - self._kernel_ns < KERNEL_NS:
            return
        self._kernel_ns = now_ns
        for kept in self._links:
            self._note_counts(kept)

    def _note_counts(self, kept: Kept) -> None:
        """Bytes the kernel lost, and decoding that fell behind, are events; nothing else of them is."""
        counts = None if kept.reader.lost else kernel_counts(kept.reader.link)
        if counts is not None and kept.counted is not None and counts != kept.counted:
            more = {name: value - kept.counted[name] for name, value in counts.items()}
            self._tell(kept, state="kernel errors", **more)
        kept.counted = counts
        if kept.reader.behind != kept.behind:
            times = kept.reader.behind - kept.behind
            self._tell(kept, state="behind", times=times)
            kept.behind = kept.reader.behind


def _left_over(reader: LinkReader, now_ns: int) -> bool:
    """Bytes wait to be decoded, and none has followed for long: what they say is the newest there is."""
    return reader.decoder.pending_bytes > 0 and now_ns - reader.last_byte_ns >= to_ns(silence_s(reader))


@contextmanager
def keep_links(context: RunContext) -> Iterator[LinkKeeper]:
    """Look after the links while a run goes on (a Beside of bench.run.session)."""
    keeper, acquisition = LinkKeeper(context), context.acquisition
    context.observers.add(keeper)
    acquisition.on_serviced = lambda: context.health.alive(LINKS)
    acquisition.watch = keeper
    try:
        yield keeper
    finally:
        acquisition.watch = None
        for reader in acquisition.readers.values():
            reader.kept = False
