"""The beginning of a record: with the first whole gate from now on, or the frame right behind the record before it.

Records that follow each other are opened ahead: the frames of the next one arrive while the last ones of this one are
still being decoded, and while calls between the two keep the bus busy. No frame is in two of them, none in between.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bench.frame import signal_of
from bench.model.clock import NS, to_ns
from bench.model.errors import RunError
from bench.model.events import Gap
from bench.model.ports import RecordWindow
from bench.plan import PlannedCall, PlannedPrompt, PlannedRecord, PlannedVerify, Step
from bench.run.context import RunContext

BEHIND_FRAMES = 2  # the newest frame is older than this many periods: the link is behind
OPEN_GATE = 1  # the gate that is open at the start began before it
SILENCE_S = 2.0
AHEAD_S = 100.0  # how late a step between two records may be (a bus that asks again) before a frame is missed


def begin_window(context: RunContext, step: PlannedRecord, number: int) -> RecordWindow:
    """Return the window of a record step, open, and with it those that follow it without a gap.

    A step that follows another one begins anew if its first frames have gone by already.
    Raises: RunError B-RUN-021 if the unit is silent where a window begins anew.
    """
    with context.acquisition.lock:
        start_ns = context.clock.now_ns()
        context.acquisition.refresh()
        window = context.ahead.pop(step.number, None)
        if window is None:
            window = _anew(context, step, number, start_ns)
            _open(context, step, window)
            if step.follows:
                context.event(Gap(step=step.number, record=number, first_counter=window.first_counter))
        _open_followers(context, step, window)
    return window


def patience_s(context: RunContext, step: PlannedRecord) -> float:
    """Return how much later than due the last frame of a record may come, second."""
    return SILENCE_S + 3.0 / float(context.plan.campaign["rate_Hz"]) + 0.001 * step.seconds


def is_chained(context: RunContext, step: PlannedRecord) -> bool:
    """Return whether a record follows another one without a gap, or is followed by one."""
    return step.follows or next(_followers(context.plan.steps, step), None) is not None


def silent(context: RunContext, message: str) -> RunError:
    """The unit sends nothing."""
    return RunError(
        "B-RUN-021",
        message,
        where=context.measurement_link,
        next_step="check supply, cable and stream mode of the unit, then start again",
    )


def _anew(context: RunContext, step: PlannedRecord, number: int, start_ns: int) -> RecordWindow:
    """The first frame is the first whose gate began after ``start_ns``, as far as the bytes received can tell.

    A frame of which no byte is here yet (11 us at 921,600 Bd, plus the delay of the port) makes the first gate begin
    that much too early; the settle time before a record is a thousand times longer. When frames are overdue, on a
    machine or an adapter that stalls, those that must be on their way are reckoned with: they belong to the settling.
    """
    reader = context.acquisition.readers[context.measurement_link]
    rate = float(context.plan.campaign["rate_Hz"])
    if reader.last_counter < 0 or start_ns - reader.last_frame_ns > to_ns(SILENCE_S + 2.0 / rate):
        raise silent(context, f"no good frame for {SILENCE_S:g} s before record {number}")
    overdue = int((start_ns - reader.last_frame_ns) * rate // NS)
    coming = overdue + 1 if overdue >= BEHIND_FRAMES else int(reader.mid_frame)
    first = reader.last_counter + coming + OPEN_GATE + 1
    end_ns = start_ns + to_ns(step.seconds)
    if is_chained(context, step):
        end_ns = _due_ns(context, first + _frames(context, step))
    return _window(context, step, number, first, start_ns, end_ns)


def _open_followers(context: RunContext, step: PlannedRecord, window: RecordWindow) -> None:
    """Open the next window, and more until the longest wait for this one and AHEAD_S are covered.

    Never one that has begun: what was received since is counted already.
    """
    reader, now_ns = context.acquisition.readers[context.measurement_link], context.clock.now_ns()
    enough_ns = window.t_end_ns + to_ns(patience_s(context, step) + AHEAD_S)
    for later in _followers(context.plan.steps, step):
        stop = window.first_counter + window.frames
        known = context.ahead.get(later.number)
        if known is None and (reader.last_counter >= stop or window.t_end_ns < now_ns):
            return
        if known is None:
            end_ns = _due_ns(context, stop + _frames(context, later))
            known = _window(context, later, window.number + 1, stop, window.t_end_ns, end_ns)
            context.ahead[later.number] = known
            _open(context, later, known, chained=True)
        window = known
        if window.t_end_ns >= enough_ns:
            return


def _followers(steps: Sequence[Step], step: PlannedRecord) -> Iterator[PlannedRecord]:
    """Yield record steps that follow ``step`` without a gap, in order."""
    for number in range(step.number + 1, len(steps)):
        later = steps[number]
        if isinstance(later, PlannedRecord) and later.follows and later.phase == step.phase:
            yield later
        elif not isinstance(later, PlannedCall | PlannedVerify | PlannedPrompt):  # nothing else may stand between
            return


def _open(context: RunContext, step: PlannedRecord, window: RecordWindow, chained: bool = False) -> None:
    definitions = {link: reader.definition for link, reader in context.acquisition.readers.items()}
    context.frames_cutter.open(
        window, timed=step.pulse_timing, sampled=step.samples, chained=chained,
        signals=[signal_of(signal, definitions) for _, signal in step.signals],
    )  # fmt: skip


def _frames(context: RunContext, step: PlannedRecord) -> int:
    return round(step.seconds * float(context.plan.campaign["rate_Hz"]))


def _due_ns(context: RunContext, stop: int) -> int:
    """Return when the frame before counter ``stop`` is due, by the newest frame: the unit's clock is not ours."""
    reader = context.acquisition.readers[context.measurement_link]
    rate = float(context.plan.campaign["rate_Hz"])
    return reader.last_frame_ns + round((stop - 1 - reader.last_counter) / rate * NS)


def _window(
    context: RunContext, step: PlannedRecord, number: int, first: int, start_ns: int, end_ns: int
) -> RecordWindow:
    return RecordWindow(
        number=number,
        link=context.measurement_link,
        first_counter=first,
        frames=_frames(context, step),
        t_start_ns=start_ns,
        t_end_ns=end_ns,
        conditions=step.conditions if context.settled else {**step.conditions, "settled": False},
        step=step.number,
    )
