"""The beginning of a record: with the first whole gate from now on, or the frame right behind the record before it.

Records that follow each other are opened ahead: the frames of the next one arrive while the last ones of this one are
still being decoded, and while calls between the two keep the bus busy. No frame is in two of them, none in between.
"""

from __future__ import annotations

from collections.abc import Iterator

from bench.frame import signal_of
from bench.model.clock import NS, to_ns
from bench.model.errors import RunError
from bench.model.events import Gap
from bench.model.ports import RecordWindow
from bench.plan import PlannedCall, PlannedPrompt, PlannedRecord, PlannedVerify
from bench.run.context import RunContext
from bench.run.links.port import cure
from bench.run.links.reader import LinkReader

BEHIND_FRAMES = 2  # the newest frame is older than this many periods: the link is behind
OPEN_GATE = 1  # the gate that is open at the start began before it
SILENCE_S = 2.0
AHEAD_S = 100.0  # how late a step between two records may be (a bus that asks again) before a frame is missed


def begin_window(context: RunContext, step: PlannedRecord, number: int) -> RecordWindow:
    """Return the window of a record step, open, and with it those that follow it without a gap.

    Those that are taken together with it, of other units, are opened at the same moment. A step that follows another
    one begins anew if its first frames have gone by already.
    Raises: RunError B-RUN-021 if the unit is silent where a window begins anew.
    """
    with context.acquisition.lock:
        gates_ns = context.clock.now_ns()
        context.acquisition.refresh()
        start_ns = context.clock.now_ns()  # all that was decoded came before it: a replay, too, keeps only what follows
        window = context.ahead.pop(step.number, None)
        if window is None:
            window = _begin_anew(context, step, number, gates_ns, start_ns)
            for place, later in enumerate(_together(context, step), 1):
                begun = _begin_anew(context, later, number + place, gates_ns, start_ns)
                context.ahead[later.number] = begun
                _open_followers(context, later, begun)
        _open_followers(context, step, window)
    return window


def _begin_anew(context: RunContext, step: PlannedRecord, number: int, gates_ns: int, start_ns: int) -> RecordWindow:
    first = _first_counter(context, step, number, gates_ns)
    end_ns = start_ns + to_ns(step.seconds)
    if is_chained(context, step):
        end_ns = _due_ns(context, step.role, first + _frames(context, step))
    window = _window(context, step, number, first, start_ns, end_ns)
    _open(context, step, window)
    if step.follows:
        context.event(Gap(step=step.number, record=number, first_counter=window.first_counter))
    return window


def _together(context: RunContext, step: PlannedRecord) -> list[PlannedRecord]:
    """Return the records right behind a step that are taken together with it, without those that are left out."""
    steps, number = context.plan.steps, step.number + 1
    together = []
    while number < len(steps) and isinstance(later := steps[number], PlannedRecord) and later.together:
        together += [] if number in context.decided.left_out else [later]
        number += 1
    return together


def patience_s(context: RunContext, step: PlannedRecord) -> float:
    """Return how much later than due the last frame of a record may come, second."""
    return SILENCE_S + 3.0 / context.rate_Hz + 0.001 * step.seconds


def is_chained(context: RunContext, step: PlannedRecord) -> bool:
    """Return whether a record follows another one without a gap, or is followed by one."""
    return step.follows or next(_followers(context, step), None) is not None


def silent(reader: LinkReader, message: str) -> RunError:
    """The unit sends nothing."""
    return RunError(
        "B-RUN-021",
        message,
        where=reader.name,
        next_step=f"{cure(reader.link)}, then start again",
    )


def _first_counter(context: RunContext, step: PlannedRecord, number: int, gates_ns: int) -> int:
    """Return the counter of the first frame whose gate began after ``gates_ns``, as far as the bytes received tell.

    A frame of which no byte is here yet (11 us at 921,600 Bd, plus the delay of the port) makes the first gate begin
    that much too early; the settle time before a record is a thousand times longer. When frames are overdue, on a
    machine or an adapter that stalls, those that must be on their way are reckoned with: they belong to the settling.
    """
    reader = context.acquisition.readers[step.role]
    rate = context.rate_Hz
    if reader.last_counter < 0 or gates_ns - reader.last_frame_ns > to_ns(SILENCE_S + 2.0 / rate):
        raise silent(reader, f"no good frame for {SILENCE_S:g} s before record {number}")
    overdue = int((gates_ns - reader.last_frame_ns) * rate // NS)
    coming = overdue + 1 if overdue >= BEHIND_FRAMES else int(reader.mid_frame)
    return reader.last_counter + coming + OPEN_GATE + 1


def _open_followers(context: RunContext, step: PlannedRecord, window: RecordWindow) -> None:
    """Open the next window, and more until the longest wait for this one and AHEAD_S are covered.

    Never one that has begun: what was received since is counted already.
    """
    reader, now_ns = context.acquisition.readers[step.role], context.clock.now_ns()
    enough_ns = window.t_end_ns + to_ns(patience_s(context, step) + AHEAD_S)
    number = window.number
    for place, later in _followers(context, step):
        stop = window.first_counter + window.frames
        known = context.ahead.get(later.number)
        if known is None and (reader.last_counter >= stop or window.t_end_ns < now_ns):
            return
        if known is None:
            end_ns = _due_ns(context, step.role, stop + _frames(context, later))
            known = _window(context, later, number + place, stop, window.t_end_ns, end_ns)
            context.ahead[later.number] = known
            _open(context, later, known, chained=True)
        window = known
        if window.t_end_ns >= enough_ns:
            return


def _followers(context: RunContext, step: PlannedRecord) -> Iterator[tuple[int, PlannedRecord]]:
    """Yield the record steps of a link that follow ``step`` without a gap, each with how many records later it is."""
    steps, place = context.plan.steps, 0
    for number in range(step.number + 1, len(steps)):
        later = steps[number]
        if isinstance(later, PlannedRecord) and later.phase == step.phase and (later.follows or later.together):
            place += number not in context.decided.left_out
            if later.role == step.role and number not in context.decided.left_out:
                yield place, later
        elif not isinstance(later, PlannedCall | PlannedVerify | PlannedPrompt):  # nothing else may stand between
            return


def _open(context: RunContext, step: PlannedRecord, window: RecordWindow, chained: bool = False) -> None:
    definitions = {link: reader.definition for link, reader in context.acquisition.readers.items()}
    context.cutters[step.role].open(
        window, timed=step.pulse_timing, sampled=step.samples, chained=chained,
        signals=[signal_of(signal, definitions) for _, signal in step.signals],
    )  # fmt: skip


def _frames(context: RunContext, step: PlannedRecord) -> int:
    return round(step.seconds * context.rate_Hz)


def _due_ns(context: RunContext, link: str, stop: int) -> int:
    """Return when the frame before counter ``stop`` is due, by the newest frame: the unit's clock is not ours."""
    reader = context.acquisition.readers[link]
    rate = context.rate_Hz
    return reader.last_frame_ns + round((stop - 1 - reader.last_counter) / rate * NS)


def _window(
    context: RunContext, step: PlannedRecord, number: int, first: int, start_ns: int, end_ns: int
) -> RecordWindow:
    return RecordWindow(
        number=number,
        link=step.role,
        first_counter=first,
        frames=_frames(context, step),
        t_start_ns=start_ns,
        t_end_ns=end_ns,
        conditions=step.conditions if context.settled else {**step.conditions, "settled": False},
        step=step.number,
    )
