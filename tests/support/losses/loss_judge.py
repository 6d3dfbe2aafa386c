"""What a bench did around a loss, and whether that was right: a pure function of what was recorded.

Judged is what the simulated world really does, what the views show, what the folder holds; never what a command says of
itself. ``begin`` and ``end`` of a loss are the moments at which the network was taken away and given back.

**In time**, 5 s, counts for every kind from the first moment at which it can be noticed, and that is:

* ``refused``, ``reset``, ``server``: the begin; every connection is reset then, whoever holds it can see it at once.
* ``mute``, ``down``: the begin, too. Nothing tells a silence but a question without an answer; a run that drives a
  stimulus has to ask often enough to notice it and be done within the 5 s.
* ``cut``: nothing is in time or late; the instrument can be asked again at once, so it counts like the end of a loss.

Behind the end the 5 s count from the moment the ways are open again, whatever a system's timers make of that.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby

from loss_schedule import ALL, HOLDING, STIMULUS, Loss

IN_TIME_S = 5.0
MOST_SEEN = 20  # samples in ``VIEW_S``
VIEW_S = 1.0  # a view may be that much older than the world
TRIES_S = 10.0  # whoever still tries does so, and tells it, at least that often
ROUTE = frozenset(STIMULUS)
KILLED, INTERNAL = -9, 70
NO_RESULTS, DOUBTFUL = "no results", 1  # too few records were whole: the run says so by its exit status
ENDS = (0, 1, 3, 4)  # done, done beyond a limit, ended safely, ended by a person


@dataclass(frozen=True)
class Sample:
    """What was seen at one moment, monotonic second.

    drives: roles that drive something or lead it to the unit; None if there was no world to ask.
    run, guard: whether they live.   step: under way, None if the run did not tell.
    off: what views show as off: roles, and ``ALL`` for the bench as a whole.
    """

    t_s: float
    drives: frozenset[str] | None
    run: bool = True
    guard: bool = True
    step: int | None = None
    off: frozenset[str] = frozenset()

    def driven(self, roles: Collection[str]) -> frozenset[str]:
        """Return which of the roles drive something."""
        return frozenset() if self.drives is None else self.drives & frozenset(roles)

    @property
    def current(self) -> bool:
        """Whether current goes through the unit: the calibrator operates, and a route is closed."""
        return self.driven(ROUTE) == ROUTE


@dataclass(frozen=True)
class Kept:
    """A record that counts at the end: its number, the steps of its point, when its window was (second)."""

    number: int
    first: int
    step: int
    last: int
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Recording:
    """A run with its losses. Times are monotonic seconds.

    armed: when a person let the bench go on.   unasked_s: from then on the run asks nobody (a resumed simulated one).
    holds, breaks: when it began to stand still; when it went on or was gone on with.   tries: when somebody told of an
    instrument that could not be made safe.   exits: of all processes of the run, in turn.   guard: its last word.
    ended: the session is closed or its results are there.   replay: what it said.   roles: of all instruments.
    """

    samples: Sequence[Sample]
    roles: tuple[str, ...]
    armed: Sequence[float] = ()
    unasked_s: float = math.inf
    holds: Sequence[float] = ()
    breaks: Sequence[float] = ()
    tries: Sequence[float] = ()
    kept: Sequence[Kept] = ()
    exits: Sequence[int] = ()
    guard: str = ""
    ended: bool = True
    replay: str = "identical"


@dataclass(frozen=True)
class Span:
    """A loss and when it was, monotonic second. ``until_s``: when the next one begins."""

    loss: Loss
    begin_s: float
    end_s: float
    until_s: float = math.inf

    def roles(self, every: tuple[str, ...]) -> tuple[str, ...]:
        """Return the roles that were lost."""
        return every if self.loss.target == ALL else (self.loss.target,)

    @property
    def bare(self) -> bool:
        """Whether nothing was lost."""
        return self.loss.kind == "none"


@dataclass
class Verdict:
    """What came of a loss: seconds (NaN where nothing was driven), and what was wrong."""

    path_open_s: float = math.nan
    off_after_s: float = math.nan
    violations: list[str] = field(default_factory=list)


def judge(span: Span, recording: Recording) -> Verdict:
    """Judge one loss of a run."""
    verdict = Verdict()
    samples = [sample for sample in recording.samples if span.begin_s <= sample.t_s < span.until_s]
    if not span.bare:
        _path(span, samples, recording, verdict)
        _behind(span, samples, recording, verdict)
        _points(span, recording, verdict)
        _tries(span, samples, recording, verdict)
    _left_on(span, samples, recording, verdict)
    _views(samples, verdict)
    _guards(samples, verdict)
    _ends(recording, verdict)
    return verdict


def _path(span: Span, samples: Sequence[Sample], recording: Recording, verdict: Verdict) -> None:
    """One instrument of the stimulus is lost: what else breaks the path has broken it in time."""
    if span.loss.target not in ROUTE or not any(sample.current for sample in samples[:2]):
        return
    driven_s = [sample.t_s for sample in samples if sample.current and sample.t_s < span.end_s]
    on_s = max(driven_s, default=span.begin_s) - span.begin_s
    if on_s > IN_TIME_S:
        verdict.violations.append(f"current for {on_s:.1f} s of the loss")
    if (
        on_s > IN_TIME_S or on_s + VIEW_S < span.end_s - span.begin_s
    ):  # else it is over before anybody has to do anything
        verdict.path_open_s = on_s


def _behind(span: Span, samples: Sequence[Sample], recording: Recording, verdict: Verdict) -> None:
    """From 5 s behind the end a lost stimulus drives nothing, until a person came or the run went its own way back.

    Its own way is that of a run that has not stood still: what it drives it has been able to ask but for 5 s.
    """
    lost = set(span.roles(recording.roles)) & ROUTE
    by_itself = [t for t in recording.breaks if t >= recording.unasked_s]  # armed by the simulation
    people_s = (*recording.armed, recording.unasked_s, *by_itself)
    person_s = min((t for t in people_s if t >= span.begin_s), default=math.inf)
    held_s = min((t for t in recording.holds if t >= span.begin_s), default=math.inf)
    held_s = span.begin_s if span.loss.moment == HOLDING else held_s
    begun_s, off_s, told = math.inf, math.nan, False
    for sample in samples:
        if not (on := sample.driven(lost)) or sample.t_s >= person_s:
            begun_s = math.inf
            continue
        begun_s = min(begun_s, sample.t_s)
        through = span.end_s - begun_s > IN_TIME_S
        held = held_s <= sample.t_s
        if sample.t_s < span.end_s or (sample.run and not held and not through):
            continue
        off_s = sample.t_s - span.end_s
        due_s = span.end_s if through or not held else max(span.end_s, held_s)
        if sample.t_s > due_s + IN_TIME_S and not told:
            told = True
            why = "the run stood still" if held else "as if nothing had been" if sample.run else "no run"
            verdict.violations.append(f"{'+'.join(sorted(on))} on behind the loss, no person there: {why}")
    on_at_begin = any(sample.driven(lost) for sample in samples[:2])
    verdict.off_after_s = 0.0 if math.isnan(off_s) and on_at_begin else off_s


def _points(span: Span, recording: Recording, verdict: Verdict) -> None:
    """A point during which the calibrator could not be asked for more than 5 s does not count."""
    if "calibrator" not in span.roles(recording.roles):
        return
    for kept in recording.kept:
        begin_s, end_s = point_of(kept, recording)
        without_s = min(end_s, span.end_s) - max(begin_s, span.begin_s)
        if without_s > IN_TIME_S:
            text = f"record {kept.number} kept, {without_s:.1f} s without its calibrator"
            verdict.violations.append(text)


def point_of(kept: Kept, recording: Recording) -> tuple[float, float]:
    """Return when the point of a record was, from its relays on to its last check, second."""
    begin_s, end_s, step = kept.begin_s, kept.end_s, kept.step
    border_s = max((t for t in recording.breaks if t <= kept.begin_s), default=-math.inf)
    for sample in reversed([sample for sample in recording.samples if border_s <= sample.t_s <= kept.begin_s]):
        if sample.step is None:
            continue
        if not kept.first <= sample.step <= step:  # an earlier point, or an earlier attempt at this one
            break
        begin_s, step = sample.t_s, sample.step
    for sample in (sample for sample in recording.samples if sample.t_s >= kept.end_s and sample.step is not None):
        if not kept.step <= (sample.step or 0) <= kept.last:
            break
        end_s = sample.t_s
    return begin_s, end_s


def _tries(span: Span, samples: Sequence[Sample], recording: Recording, verdict: Verdict) -> None:
    """A loss that lasts: whoever is left still tries to switch off what is on, and tells it."""
    at_end = [sample for sample in samples if sample.t_s <= span.end_s][-1:]
    if not at_end or span.end_s - span.begin_s <= TRIES_S + IN_TIME_S:
        return
    if at_end[0].driven(set(span.roles(recording.roles)) & ROUTE):
        if not (at_end[0].run or at_end[0].guard):
            verdict.violations.append("nobody is left at the end of the loss")
        elif not any(span.end_s - TRIES_S <= t <= span.end_s for t in recording.tries):
            verdict.violations.append(f"nobody tried in the last {TRIES_S:g} s of the loss")


def _left_on(span: Span, samples: Sequence[Sample], recording: Recording, verdict: Verdict) -> None:
    """5 s behind the end of a run, and of the loss, nothing at all is on."""
    lost, ran_s = set(span.roles(recording.roles)) if not span.bare else set(), -math.inf
    for sample in samples:
        ran_s = sample.t_s if sample.run else ran_s
        since_s = max(ran_s, span.begin_s)
        there = sample.drives or frozenset()
        late = {role for role in there if sample.t_s > (max(since_s, span.end_s) if role in lost else since_s) + 5.0}
        if late and not sample.run:
            verdict.violations.append(f"{'+'.join(sorted(late))} on, and no run")
            return


def _views(samples: Sequence[Sample], verdict: Verdict) -> None:
    """No view shows as off what has been on for longer than a view may be old."""
    for number, sample in enumerate(samples):
        past = [one for one in samples[max(0, number - MOST_SEEN) : number + 1] if one.t_s >= sample.t_s - VIEW_S]
        if not sample.off or sample.t_s - samples[0].t_s < VIEW_S or any(one.drives is None for one in past):
            continue
        steady = frozenset[str].intersection(*(one.drives or frozenset() for one in past))
        # a closed route holds no energy of its own: outputs are off where nothing feeds it
        wrong = steady & sample.off or (steady - {"switch"} if ALL in sample.off else frozenset())
        if wrong:
            verdict.violations.append(f"a view shows {'+'.join(sorted(wrong))} as off while it is on")
            return


def _guards(samples: Sequence[Sample], verdict: Verdict) -> None:
    """There is a guard while something of the stimulus is on; a run without one has 5 s to end safely."""
    for begin, end in _unguarded(samples):
        limit_s = IN_TIME_S if any(s.run for s in samples if begin <= s.t_s <= end) else VIEW_S
        if end - begin > limit_s:
            verdict.violations.append(f"no guard for {end - begin:.1f} s while something was on")
            return


def _unguarded(samples: Sequence[Sample]) -> Iterator[tuple[float, float]]:
    """Yield begin and end (second) of each stretch in which the stimulus was on and no guard lived."""
    for bare, stretch in groupby(samples, lambda sample: bool(sample.driven(ROUTE)) and not sample.guard):
        times_s = [sample.t_s for sample in stretch]
        if bare:
            yield times_s[0], times_s[-1]


def _ends(recording: Recording, verdict: Verdict) -> None:
    """No internal error, nobody killed; the session is whole and says the same again."""
    named = {INTERNAL: "internal error, exit 70", KILLED: "killed by its guard"}
    wrong = [named.get(status, f"exit {status}") for status in recording.exits if status not in ENDS]
    verdict.violations += dict.fromkeys(wrong)
    if not recording.ended:
        verdict.violations.append("neither closed nor gone on with")
    elif recording.replay != "identical" and (recording.replay, recording.exits[-1]) != (NO_RESULTS, DOUBTFUL):
        verdict.violations.append(f"replay: {recording.replay}")
