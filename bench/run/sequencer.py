"""The timer-driven sequencer: executes the flat plan step by step and always leaves the bench safe.

Behind a check that failed every step under its conditions is left out, such as the rest of one unit: what takes energy
away is still done and confirmed; a step that could bring it is not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from bench.model.clock import NS, to_ns
from bench.model.errors import BenchError, InstrumentError, LinkError, OperatorStop, RunError
from bench.model.events import DECISION, LEFT_OUT, End, Error, Phase, Retake, Safe, Skip, UnitLeftOut
from bench.model.installed import unforeseen
from bench.model.ports import Effect, drivers_of
from bench.plan import CHAMBER, UNIT, PlannedRecord, PlannedUnit, PlannedVerify, Step, Steps
from bench.plan import Phase as PhaseName
from bench.record import Journal, RecordRow
from bench.run.bus.safety import heat_off, make_safe, states_of
from bench.run.context import RunContext, Timeline
from bench.run.hold import stand_still, wish_to_wait
from bench.run.observers import patient
from bench.run.position import in_point, point_start, point_stop, readings_of
from bench.run.setpoints import drives
from bench.run.steps.dispatch import execute
from bench.run.steps.recording import measurement_rows
from bench.run.steps.reentry import come_back, jumped
from bench.run.stop import Interruption, Wish
from bench.run.watch.outputs import look

# A link that is silent or lost for longer than a hold, no or a wrong answer, another unit, its own wiring, and what is
# beyond a limit of its own for too long. All else concerns the bench or more than one unit, and ends the run.
OWN_FAULTS = (
    "B-RUN-021", "B-RUN-022", "B-RUN-023", "B-RUN-024", "B-RUN-025", "B-RUN-050", "B-RUN-051", "B-RUN-070",
)  # fmt: skip


def to_blame(context: RunContext, error: BenchError, step: Step) -> PlannedUnit | None:
    """Return the unit that an error concerns alone, None if the campaign cannot go on without it.

    The unit of the link that the error names, of the interlock, or of the step.
    """
    plan = context.plan
    if error.code not in OWN_FAULTS or not context.stop.interruptible or context.stop.over:
        return None
    limits = {f"interlock {rule.name}": rule.of for rule in plan.interlocks}
    unit = plan.unit_of(limits.get(error.where, error.where))
    if unit is None and error.where == step.where:
        unit = plan.unit_of(step.conditions.get(UNIT))
    others = [other for other in plan.units if other is not unit and other.serial not in context.decided.units_out]
    return unit if others and unit is not None and unit.serial not in context.decided.units_out else None


def leave_unit_out(context: RunContext, unit: PlannedUnit, error: BenchError, step: Step) -> None:
    """Take the stimulus away, open the routes and switch the unit's own instruments off, each confirmed by readback.

    Raises: RunError B-RUN-053 if one of them is not confirmed; then nothing may go on.
    """
    stimulus = {role for role, instrument in context.instruments.items() if drives(type(instrument))}
    off = [role for role in context.plan.station.safe_order if role in stimulus or role in unit.roles.values()]
    failures = make_safe(
        {role: context.instruments[role] for role in off}, off, context.clock, live=context.stop.is_alive
    )
    if failures:
        raise RunError(
            "B-RUN-053",
            f"unit {unit.serial} in slot {unit.slot} is not confirmed off ({'; '.join(map(str, failures))}); it failed "
            f"before: {error.message}",
            where=error.where,
            next_step="switch it off at its supply before anybody touches the bench",
        )
    for reason in (*unit.links.values(), *(rule.name for rule in context.plan.interlocks if rule.of in unit.names)):
        context.stop.holds.release(f"link {reason}")
        context.stop.holds.release(f"interlock {reason}")
    context.event(
        UnitLeftOut(
            uut=unit.serial, slot=unit.slot, step=step.number, code=error.code, reason=error.message, confirmed=off
        )
    )


BY = "check"
_OFF = frozenset({Effect.STIMULUS_OFF, Effect.ROUTES_OPEN})


def behind(steps: Sequence[Step], check: Step) -> int:
    """Return number of the first step behind a check that is not done under its conditions, in the phase of the check.

    ``steps``: those of the whole plan, so that a number is an index.
    """
    number, about = check.number + 1, check.conditions.items()
    while number < len(steps) and steps[number].phase == check.phase and about <= steps[number].conditions.items():
        number += 1
    return number


def leave_out(context: RunContext, check: Step) -> None:
    """Switch off what the steps behind a failed check switch off, then note that they are left out.

    Raises: InstrumentError of an instrument that does not confirm it.
    """
    steps, drivers = context.plan.steps, drivers_of(context.instruments)
    stop = behind(steps, check)
    for step in steps[check.number + 1 : stop]:
        if step.effects(drivers.get(step.role, {})) & _OFF or step.name == "output_off":
            execute(context, step)
    reason = f"a check without which nothing may follow has failed at step {check.number}"
    context.event(Skip(by=BY, reason=reason, first=check.number + 1, stop=stop))


CHAMBER_ASTRAY = ("B-RUN-031", "B-RUN-071")  # a temperature not reached, an interlock that ends the run
PHASES: tuple[PhaseName, ...] = ("prepare", "campaign", "finally")


@dataclass(frozen=True)
class Outcome:
    """The end of a run: its valid records, slip and lateness; ``error`` is None when every step was done.

    ``unsafe`` has one error for each instrument that could not be confirmed safe (empty: the bench is safe).
    """

    rows: Sequence[RecordRow]
    slip_s: float
    overruns: int
    retaken: int
    lateness_ms: tuple[float, float, float]  # median, 99th percentile, maximum
    error: BenchError | None = None
    unsafe: Sequence[RunError] = field(default_factory=tuple)


class Sequencer:
    """Executes a plan under a clock. One object per run."""

    def __init__(self, context: RunContext, journal: Journal, safe_order: Sequence[str]) -> None:
        self._context = context
        self._journal_step = patient(journal.step, context.event)
        self._safe_order = safe_order
        self._drivers = drivers_of(context.instruments)
        self._readings = readings_of(context.plan.steps, self._drivers)
        self._done = 0
        self._start_ns = context.clock.now_ns()
        self._slip_ns = 0
        self._lateness_ns: list[int] = []
        self._attempts: Counter[int] = Counter()  # by number of the verify step
        self._holds: Counter[int] = Counter()  # for an instrument that was silent, by number of the step

    def run(self, start: int = 0, enter: Callable[[], None] | None = None) -> Outcome:
        """Execute every step from number ``start`` on, then make the bench safe, whatever happened.

        ``enter`` brings the bench to where that step may begin. Errors are part of the outcome, not raised.

        An error nobody foresaw becomes B-INT-001: the session must still be closed and say what it holds.
        """
        context = self._context
        context.health.begin(self._safe_order)
        error: BenchError | None = None
        try:
            error = self._attempt(start, enter)
        except OperatorStop as stopped:  # a second signal on the way out of a step
            error = stopped
        finally:
            context.stop.shield()
            with context.in_use.take(CHAMBER):
                alive = context.stop.is_alive
                unsafe = make_safe(context.instruments, self._safe_order, context.clock, live=alive)
                astray = error is not None and error.code in CHAMBER_ASTRAY
                unsafe += heat_off(context.instruments.get(CHAMBER)) if astray else []
                context.health.over(states_of(unsafe), heat_off=astray)
                with suppress(Exception):  # it is made safe; this only shows it
                    look(context.instruments)
        if error is not None:
            context.note(Error.of(error, self._done))
        failed = [str(failure) for failure in unsafe]
        context.note(Safe(failures=failed, roles=[failure.where for failure in unsafe]))
        with suppress(BenchError):  # what a broken link still holds is not worth the outcome
            context.acquisition.stop()
        outcome = self._outcome(error, unsafe)
        context.note(
            End(
                steps=self._done,
                records=len(outcome.rows),
                slip_s=outcome.slip_s,
                overruns=outcome.overruns,
                retaken=outcome.retaken,
                lateness_ms=list(outcome.lateness_ms),
                error=error.code if error else None,
            )
        )
        return outcome

    def _attempt(self, start: int, enter: Callable[[], None] | None) -> BenchError | None:
        try:
            if enter is not None:
                enter()
            for phase in PHASES:
                steps = self._context.plan.phase(phase)
                if steps and steps[-1].number >= start:
                    self._run_phase(steps, max(0, start - steps[0].number))
        except (Exception, SystemExit) as problem:
            return unforeseen(problem)
        finally:
            self._context.stop.shield()
        return None

    def _run_phase(self, steps: Steps, position: int) -> None:
        context = self._context
        context.timeline = Timeline(context.clock, context.stop, context.clock.now_ns() - to_ns(steps[position].at_s))
        context.event(Phase(name=steps[0].phase, t_start_ns=context.clock.now_ns()))
        context.stop.interruptible = steps[0].phase != "finally"
        try:
            while (position := self._passed_over(steps, position)) < len(steps):
                count = context.record_count
                try:
                    position = self._stepped(steps, position)
                except (RunError, LinkError) as error:
                    context.drop_open_records(count)
                    position = self._without_unit(error, steps, position)
        finally:
            self._slip_ns += context.timeline.slip_ns
            self._lateness_ns += context.timeline.lateness_ns

    def _stepped(self, steps: Steps, position: int) -> int:
        """Do one step; returns where to go on. Raises: what keeps the run from going on."""
        context, count = self._context, self._context.record_count
        try:
            self._execute(steps[position])
        except Interruption as interruption:
            context.drop_open_records(count)
            return self._interrupted(interruption.wish, steps, position)
        except RunError as error:
            return self._again(error, steps, position)
        except InstrumentError as error:
            role = steps[position].role or context.in_use.newest  # a record of readings has several
            wish = self._waited_for(error, role, steps[position])
            context.drop_open_records(count)
            return self._interrupted(wish, steps, position)
        return self._behind(steps, position)

    def _without_unit(self, error: BenchError, steps: Steps, position: int) -> int:
        """Return where the others go on after an error that concerns one unit of several, armed as after any hold.

        Raises: any other error; RunError B-RUN-053 if the unit is not confirmed off.
        """
        context = self._context
        unit = to_blame(context, error, steps[position])
        if unit is None:
            raise error
        context.stop.survive(error)
        leave_unit_out(context, unit, error, steps[position])
        wish = Wish("hold", f"unit {unit.serial}", f"left out: {error.message}")
        return self._interrupted(wish, steps, position)

    def _passed_over(self, steps: Steps, position: int) -> int:
        """Return the first position from one on that no decision has left out; what is passed over is noted."""
        first, left_out = position, self._context.decided.left_out
        while position < len(steps) and steps[position].number in left_out:
            position += 1
        if position > first:
            stop = self._done = steps[position - 1].number + 1
            by, why = (DECISION, "the decision before does not take them")
            if self._context.plan.units:
                by, why = (LEFT_OUT, "their unit is left out")
            self._context.event(Skip(by=by, reason=why, first=steps[first].number, stop=stop))
        return position

    def _behind(self, steps: Steps, position: int) -> int:
        """Return where to go on behind a step: the next one, or behind all that a failed check leaves out."""
        step = steps[position]
        if step.number not in self._context.failed:
            return position + 1
        self._context.timeline.done_s = None
        return behind(self._context.plan.steps, step) - steps[0].number

    def _again(self, error: RunError, steps: Steps, position: int) -> int:
        """Return where to go on after a verify step failed: its point is taken again while attempts are left."""
        step = steps[position]
        left_out = self._context.decided.left_out
        records = (before for before in reversed(steps[:position]) if isinstance(before, PlannedRecord))
        record = next((before for before in records if before.number not in left_out), None)
        if not isinstance(step, PlannedVerify) or record is None or self._attempts[step.number] >= record.retry:
            raise error
        self._attempts[step.number] += 1
        self._context.timeline.done_s = None
        first = record.retry_step - steps[0].number
        self._context.message(f"{error.where}: {error.message}; the point is taken again")
        jumped(self._context, steps[first].number, steps[first:position])
        self._retake(error.message, steps[first:position])
        return first

    def _waited_for(self, error: InstrumentError, role: str, step: Step) -> Wish:
        """Stand still for an instrument that was silent. Raises: the error if it is no silence, or comes too often."""
        wish = wish_to_wait(self._context, error, role, self._holds[step.number])
        self._holds[step.number] += 1
        return wish

    def _interrupted(self, wish: Wish, steps: Steps, position: int) -> int:
        """Return where to go on after a wish: hold and retake go back to the beginning of the point, skip behind it."""
        context = self._context
        context.timeline.done_s = None
        first = point_start(steps, position, self._readings)
        if wish.kind == "hold":
            began_ns = context.clock.now_ns()
            self._held(wish, steps[position], steps[first].number)
            context.timeline.add_slip(context.clock.now_ns() - began_ns)
        # a soak or a setting is never left out
        skips = wish.kind == "skip" and in_point(steps, position, self._readings)
        if wish.kind != "hold" and not skips:
            jumped(context, steps[first].number, steps[first : position + 1])
        self._retake(f"{wish.reason} ({wish.by})", steps[first:position])
        if not skips:
            return first
        stop = point_stop(steps, position, self._readings)
        behind = steps[0].number + stop
        began_ns = context.clock.now_ns()
        jumped(context, behind, steps[position:stop])
        context.timeline.add_slip(context.clock.now_ns() - began_ns)
        context.event(Skip(by=wish.by, reason=wish.reason, first=steps[first].number, stop=behind))
        return stop

    def _held(self, wish: Wish, step: Step, first: int) -> None:
        """Stand still, then bring the temperature back; a chamber that is silent on the way back is waited for too."""
        while True:
            stand_still(self._context, wish, step.number, first)
            try:
                come_back(self._context, first)
            except InstrumentError as error:
                if CHAMBER not in self._context.instruments:  # it is a table: nobody waits for one that refuses to move
                    raise
                wish = self._waited_for(error, CHAMBER, step)
            else:
                return

    def _execute(self, step: Step) -> None:
        context = self._context
        context.stop.check()
        context.step = step
        context.observers.step(step, (context.clock.now_ns() - self._start_ns) / NS)
        context.timeline.bring_forward(step.at_s)
        context.timeline.reach(step.at_s)
        context.failed.discard(step.number)
        execute(context, step)
        if step.number in context.failed:
            leave_out(context, step)
        set_to = step.confirmed(self._drivers.get(step.role, {}))
        self._journal_step(step.number, step.phase, context.clock.now_ns(), step.conditions, set_to)
        self._done = step.number + 1
        context.timeline.done_s = step.at_s + step.duration_s

    def _retake(self, reason: str, again: Steps) -> None:
        """Take back every record of the steps that are done again."""
        context = self._context
        for step in again:
            if isinstance(step, PlannedRecord) and step.number not in context.decided.left_out:
                context.event(Retake(record=context.record_count, reason=reason))
                context.rows.pop(context.record_count, None)
                context.measured.discard(context.record_count)
                context.record_count -= 1
                context.retaken += 1
        if again:
            context.timeline.add_slip(context.clock.now_ns() - context.timeline.target_ns(again[0].at_s))

    def _outcome(self, error: BenchError | None, unsafe: Sequence[RunError]) -> Outcome:
        context = self._context
        late = sorted(self._lateness_ns)
        quantiles = (
            tuple(late[min(len(late) - 1, int(q * len(late)))] / 1e6 for q in (0.5, 0.99, 1.0)) if late else (0.0,) * 3
        )
        return Outcome(
            rows=measurement_rows(context.rows),
            slip_s=self._slip_ns / NS,
            overruns=context.overruns,
            retaken=context.retaken,
            lateness_ms=(quantiles[0], quantiles[1], quantiles[2]),
            error=error,
            unsafe=tuple(unsafe),
        )
