"""Faults of raw samples, before anybody fits them: one answer for records and logs of every system.

Samples at the end of a range or held at an extreme, a channel that stands still, samples that repeat, gaps, and single
samples that no motion makes. Each finding says what, where and how many of how many, and whether the samples may be
used all the same; the system that asked has the words. Time stamps: ``stamps``.

A value that stays the same is a fault only where noise cannot leave it so: for white noise of standard deviation s in
steps of the output no value has more than the probability p = erf(1 / (s sqrt(8))), so a run of r equal pairs anywhere
in n samples has at most the probability n p^r. A run is a fault where that is below one in a million. Noise is told by
second differences; where a signal moves on by itself and has none (a table that turns), by how often its neighbours are
equal elsewhere. Floats may be a coarse sensor's behind a correction, and their smallest change no step of the output:
there a value is no less likely than single pairs of equal neighbours are.

A single sample is odd against what its neighbours, a smooth course or a model make of it, in robust standard deviations
of what is left. A turn that begins or ends takes the samples behind it along, so its edge lies between its neighbours;
a flipped bit or a disturbed transfer does not. Odd samples are left out or bridged as long as they are few (one in a
thousand, one at the least): many are no faults but the signal's own nature.

Source: David and Nagaraja, Order Statistics (2003), section 2.1 (Boole's bound); Rousseeuw and Croux, J. Am. Stat.
Assoc. 88 (1993) 1273 (median absolute deviation as scale); Hampel, J. Am. Stat. Assoc. 69 (1974) 383 (median of the
neighbourhood).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.maths.arrays import Flags, Floats, Integers

Column = Integers | Floats
FALSE_ALARM = 1e-6  # for one channel of one record
REPEAT_ALARM = 1e-3  # for whole samples, one question for a record
_MAD = 0.6745  # of a normal distribution
_STD = 1.4826  # standard deviation over median absolute deviation of normal noise
_CAREFUL = 0.9  # of the noise found: rather a run too long than a false alarm
_FEWEST, _SMALL = 50, 2  # second differences that tell noise; steps that count as small
_FINE = 0.4  # probability of one value below which the steps of the output are fine against its noise
_COARSE = 0.3  # probability of one value above which its noise is about a step of the output
_PILE, _TIMES_BEFORE = 20, 5
SATURATED, HELD, FROZEN, RUNS, REPEATED, GAPS = "saturated", "held", "frozen", "runs", "repeated", "gaps"
_REFUSED = (SATURATED, HELD, RUNS)
_FAR = 10.0  # standard deviations of the noise
_COARSE_STEP = 0.5  # of a step: noise of less is hidden in the steps
MOST = 1e-3  # of the samples, one at the least: odd ones
_FAR_OFF = 40.0  # scatters about a smooth course: a smaller one does no harm, and a small kink looks like it
_LEFT = 0.12  # of what was odd, among the neighbours of a bad sample once it is replaced; of a kink a sixth is left
_WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
_RESOLUTION = 1e-13  # of the largest value: what arithmetic leaves
_KINKS = 50  # places that are looked at
_TINY = 1e-300
_STILL, _STILL_SHARE = 30, 0.02  # samples on end without a change, and their part of the log
_LIVELY, _TURNING = 0.5, 0.2  # share of samples that change, and of changes that turn back, in a column with noise
_ALIKE = 0.9  # correlation of two columns that go together
_FOLLOWS = 0.2  # of its span: how far something else moves meanwhile
_VISIBLE = 3.0  # steps of the output: noise that does not repeat a value by itself
_LEAST_REPEATED = 0.02  # share of the rows
_RUNS_ALIKE, _FEWEST_RUNS = 0.95, 50
_SENTINEL, _CANDIDATES = 3, 20  # times the same value; values that are looked at
_OUTSIDE = 0.2  # of the span of all others
_FAR_VALUE = 20.0  # scatters of the steps from one reading to the next, or of a reading about its neighbours
_ABOUT = 3  # rows on either side that a value is held against
_MOST_MOVES, _MOVES = 0.75, 5.0  # share of the steps from row to row; a value off by so many times the largest of these
_ROUNDING = 1e-9  # of a value


@dataclass(frozen=True)
class Finding:
    """One kind of fault in one channel: ``kind``, ``channel`` ("" for the whole sample), ``count`` of samples among
    ``of``, ``first``: index of the first of them; ``figures``: what else is to be said of it.
    """

    kind: str
    channel: str
    count: int
    of: int
    first: int
    figures: Mapping[str, float] = field(default_factory=dict)

    @property
    def refused(self) -> bool:
        """Whether its samples may not be used.

        A channel of which every sample is the same is not refused: without noise that is no fault, and a sensor that
        does not answer at all determines no fit.
        """
        return self.kind in _REFUSED


@dataclass(frozen=True)
class SampleChecks:
    """Result for one record or log.

    Attributes:
        samples: that are there.   missing: that the counter misses.   findings: faults, in the order found.
    """

    samples: int
    missing: int
    findings: tuple[Finding, ...]


def check_samples(columns: Mapping[str, Column], counter: Integers, limits: Mapping[str, float]) -> SampleChecks:
    """Look at a record sample by sample.

    Args:    columns: raw output steps by channel, (n,) or (n, 3); components are called x, y, z.   counter: (n,) of
             the samples, unwrapped.   limits: largest step of each channel's range, both signs; a channel without one
             saturates nowhere.
    Returns: SampleChecks.
    Source:  see the head of this file.
    """
    flat = {
        f"{name} {'xyz'[part]}" if values.ndim == 2 else name: (values[:, part] if values.ndim == 2 else values)
        for name, values in columns.items()
        for part in range(values.shape[1] if values.ndim == 2 else 1)
    }
    findings = _gaps(counter)
    missing = sum(finding.count for finding in findings)
    for name, values in flat.items():
        limit = limits.get(name, limits.get(name.rpartition(" ")[0], math.inf))
        findings += _saturated(name, values, limit) or piled_up(name, values)
        findings += frozen_runs(name, values)
    findings += _repeated(flat, counter)
    return SampleChecks(counter.size, missing, tuple(findings))


def longest_equal_run(likelihoods: Sequence[float], samples: int, false_alarm: float = FALSE_ALARM) -> int:
    """Equal successive pairs that chance may leave anywhere among the samples, all channels at once.

    Args:    likelihoods: largest probability of a single value, by channel.   samples: of the record.   false_alarm:
             probability for the record.
    Returns: pairs; ``samples`` where even a record of nothing else would be no surprise.
    Source:  Boole's bound; of a normal distribution in fine steps the sum of p_k^(r + 1) over all values is
             p^r / sqrt(r + 1) with p the largest of them, and no more than p^r in coarse ones.
    """
    likelihood = math.prod(likelihoods)
    fine = sum(largest < _FINE for largest in likelihoods) / 2.0
    if likelihood >= 1.0 or samples < 2:
        return samples
    if likelihood <= 0.0:
        return 0
    most = min(samples, math.ceil(math.log(false_alarm / samples) / math.log(likelihood)))
    while most > 1 and samples * likelihood ** (most - 1) / most**fine <= false_alarm:
        most -= 1
    return most - 1 if most < samples else samples


def value_likelihood(values: Column) -> float:
    """Largest probability that one output step can have under the noise of the record, slow signals taken out.

    The median of second differences, counted as grouped into steps, is not moved by a part of the record that hangs;
    the longest run of equal values does not count at all. Where most differences are zero all the same, the smaller of
    the median and the root mean square of the small ones counts: fewer runs are then called faults, never more. A step
    of the output is the smallest change between two samples.
    """
    real = np.asarray(values, np.float64)
    changes = np.abs(np.diff(real))
    second = np.abs(np.diff(real, 2))[_outside_the_longest_run(changes == 0.0)]
    if second.size < _FEWEST or not changes.any():
        return 1.0
    second = second / changes[changes > 0.0].min()
    steps = np.rint(second)
    middle = int(np.partition(steps, steps.size // 2)[steps.size // 2])  # one that occurs, as a mean of two may not
    inside = (second.size / 2.0 - float((steps < middle).sum())) / float((steps == middle).sum())
    grouped = middle - 0.5 + inside if middle else 0.5 * inside
    noise = grouped / _MAD / math.sqrt(6.0)
    if middle == 0:
        noise = min(noise, float(np.sqrt(np.mean(second[steps <= _SMALL] ** 2) / 6.0)))
    return math.erf(1.0 / (_CAREFUL * noise * math.sqrt(8.0))) if noise > 0.0 else 1.0


def _outside_the_longest_run(equal: Flags) -> Flags:
    """Second differences that are not wholly inside the longest run of equal values, (n - 2,) from (n - 1,)."""
    start, pairs = longest_run(equal)
    kept = np.ones(max(equal.size - 1, 0), np.bool_)
    kept[start : start + max(pairs - 1, 0)] = False
    return kept


def _gaps(counter: Integers) -> list[Finding]:
    steps = np.diff(counter)
    places = np.flatnonzero(steps > 1)
    if not places.size:
        return []
    missing, first, of = int((steps[places] - 1).sum()), int(places[0]) + 1, int(counter[-1] - counter[0]) + 1
    figures = {"gaps": places.size, "counter": int(counter[first]), "longest": int(steps.max()) - 1}
    return [Finding(GAPS, "", missing, of, first, figures)]


def _saturated(name: str, values: Column, limit: float) -> list[Finding]:
    """At the end of the range."""
    at_limit = np.abs(values) >= limit
    return [finding_at(SATURATED, name, at_limit, limit=limit)] if at_limit.any() else []


def finding_at(kind: str, channel: str, bad: Flags, **figures: float) -> Finding:
    """Return a finding of samples by their flags, (n,); ``channel``: "" for whole samples."""
    return Finding(kind, channel, int(bad.sum()), bad.size, int(np.argmax(bad)), figures)


def piled_up(name: str, values: Column) -> list[Finding]:
    """Held against an extreme inside the range; where noise is smaller than a step the values are too few to tell."""
    if value_likelihood(values) > _COARSE:
        return []
    return [
        finding_at(HELD, name, values == extreme, extreme=float(extreme))
        for extreme, upward in ((values.max(), values), (values.min(), -values))
        if pinned(upward) >= _PILE
    ]


def pinned(values: Column) -> int:
    """Return how many samples are at the largest value, 0 if there are more than a fifth as many at the next one.

    Noise thins out towards its extremes, and the turning points of a sine have 2.4 times the samples of the step beside
    them. The next one is that which occurs: an output need not use every step.
    """
    below = values[values < values.max()]
    count = values.size - below.size
    return count if below.size and count > _TIMES_BEFORE * np.count_nonzero(below == below.max()) else 0


def frozen_runs(name: str, values: Column) -> list[Finding]:
    """Find runs of equal values that noise does not explain, or a channel that never moves.

    Args:    name: of the channel.   values: (n,) as read, in any unit.
    Returns: one finding, or none.
    Source:  see the head of this file.
    """
    if values.size > 2 and (values == values[0]).all():
        return [Finding(FROZEN, name, values.size, values.size, 0)]
    starts, pairs = _runs(np.diff(values) == 0)
    alone = np.count_nonzero(pairs == 1) / values.size if values.dtype.kind == "f" else 0.0
    explained = longest_equal_run([max(value_likelihood(values), alone)], values.size)
    bad = pairs > explained
    if not bad.any():
        return []
    figures = {"runs": int(bad.sum()), "longest": int(pairs.max()) + 1, "noise": explained + 1}
    return [Finding(RUNS, name, int(pairs[bad].sum()), values.size, int(starts[bad][0]), figures)]


def is_silent(values: Floats) -> bool:
    """Return whether a channel has one value only, or none."""
    known = values[np.isfinite(values)]
    return bool(known.size == 0 or (known == known[0]).all())


def longest_still(values: Floats) -> int:
    """Return the longest run of equal samples if chance does not explain it by how often two are equal elsewhere.

    Args:    values: (n,) of a signal that moves on, with noise or without.
    Returns: samples, 0 for none.
    Source:  see the head of this file.
    """
    equal = np.diff(values) == 0.0
    _, longest = longest_run(equal)
    elsewhere = (int(equal.sum()) - longest + 1) / max(values.size - longest, 1)
    return longest + 1 if longest and values.size * min(elsewhere, 1.0) ** longest < FALSE_ALARM else 0


def still_columns(columns: Mapping[str, Floats], programme: Sequence[str]) -> list[Finding]:
    """Find columns of a log that stand still for long though their own noise or another column says they cannot.

    Args:    columns: (n,) by name.   programme: those that are allowed to stand still and are only held beside.
    Returns: a finding for each, its longest stretch without a change.
    Source:  noise differs from sample to sample, up and down; a column that otherwise goes with another one does not
             stay where that one moves.
    """
    findings = []
    for name, values in columns.items():
        first, pairs = longest_run(np.diff(values) == 0.0)
        still = slice(first, first + pairs + 1)
        if name in programme or pairs + 1 < max(_STILL, _STILL_SHARE * values.size):
            continue
        others = [other for key, other in columns.items() if key != name]
        if _noisy(np.delete(values, still)) or any(_follows(other, values, still) for other in others):
            findings.append(Finding(RUNS, name, pairs + 1, values.size, first))
    return findings


def _noisy(values: Floats) -> bool:
    """Whether nearly every sample differs from the one before, up and down: noise above the last digit."""
    steps = np.diff(values)
    changes = steps[steps != 0.0]
    if changes.size < _LIVELY * max(steps.size, 1) or changes.size < _STILL:
        return False
    return float(np.mean(np.sign(changes[1:]) != np.sign(changes[:-1]))) > _TURNING


def _follows(other: Floats, values: Floats, still: slice) -> bool:
    """Whether a column that otherwise goes with this one leaves it standing by a fifth of its span."""
    rest, beside = np.delete(values, still), np.delete(other, still)
    if rest.size <= _STILL or not np.ptp(rest) > 0 or not np.ptp(beside) > 0:
        return False
    alike = float(np.corrcoef(rest, beside)[0, 1])
    return alike > _ALIKE and bool(np.ptp(other[still]) > _FOLLOWS * np.ptp(other))


def _repeated(columns: Mapping[str, Column], counter: Integers) -> list[Finding]:
    """Whole samples equal to the one before, or with its counter, beyond what noise explains."""
    if counter.size < 2 or not columns:
        return []
    moving = [values for values in columns.values() if not (values == values[0]).all()]
    equal = repeats(*moving) if moving else np.zeros(counter.size - 1, bool)
    starts, pairs = _runs(equal)
    bad = pairs > longest_equal_run([value_likelihood(values) for values in moving], counter.size, REPEAT_ALARM)
    same_number = np.diff(counter) == 0
    marked = np.concatenate(([False], same_number))
    for start, length in zip(starts[bad], pairs[bad], strict=True):
        marked[start + 1 : start + length + 1] = True
    return [finding_at(REPEATED, "", marked, same=int(same_number.sum()))] if marked.any() else []


def repeats(*columns: Column) -> Flags:
    """Return which samples are those before, (n - 1,), of columns (n,) or (n, k)."""
    parts = np.column_stack(columns)
    return np.asarray(np.all(parts[1:] == parts[:-1], axis=1))


def _runs(equal: Flags) -> tuple[Integers, Integers]:
    """Begin and length of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], equal.astype(np.int8), [0]))))
    return edges[::2], edges[1::2] - edges[::2]


def longest_run(equal: Flags) -> tuple[int, int]:
    """Return begin and length of the longest run of true, the first of several; (0, 0) without one."""
    starts, lengths = _runs(equal)
    longest = int(np.argmax(lengths)) if lengths.size else 0
    return (int(starts[longest]), int(lengths[longest])) if lengths.size else (0, 0)


def repeated_rows(columns: Sequence[Column]) -> Flags:
    """Return which rows of a log say again what the row before said, in every column, beyond what noise does.

    A sensor that is slower than its recorder gives each value several times: as many times always, or its noise is far
    above the step of its output, so that two samples hardly ever agree. A coarse sensor at rest does neither.

    Args:    columns: (n,) each, raw values of one sensor.
    Returns: (n,), all false where the rows do not repeat, and where nothing at all changes.
    """
    table = np.column_stack([np.asarray(values, np.float64) for values in columns])
    again = np.concatenate(([False], (np.diff(table, axis=0) == 0.0).all(axis=1)))
    new = table[~again]
    if len(new) < _FEWEST_RUNS or again.mean() < _LEAST_REPEATED:
        return np.zeros(len(table), np.bool_)
    lengths = np.diff(np.append(np.flatnonzero(~again), len(table)))
    usual = int(np.floor(np.median(lengths)))
    regular = usual > 1 and float(np.mean((lengths == usual) | (lengths == usual + 1))) >= _RUNS_ALIKE
    changes = np.abs(np.diff(new, axis=0))
    least = np.min(np.where(changes > 0.0, changes, np.inf), axis=0)
    fine = bool((np.median(changes, axis=0) > _VISIBLE * least).any())
    return again if regular or fine else np.zeros(len(table), np.bool_)


def sentinel(values: Floats) -> tuple[float, bool] | None:
    """Return the value that stands in a column in place of readings: exactly the same at least three times, and a jump
    into it and out of it each time, far beyond the noise; outside of all others, which is told too, or on end, where a
    motion may jump as far. None without one; NaN are no readings.
    """
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    if known.size < _FEWEST or not scatter(np.diff(known)) > 0.0:
        return None
    jump = np.concatenate(([True], steps > _FAR_VALUE * float(scatter(np.diff(known))), [True]))
    behind, count = np.unique(known[jump[:-1]], return_counts=True)
    for value in behind[np.argsort(-count)][:_CANDIDATES]:
        there = known == value
        edges = np.flatnonzero(np.diff(np.concatenate(([False], there, [False]))))
        others = known[~there]
        outside = max(others.min() - value, value - others.max()) > _OUTSIDE * np.ptp(others)
        on_end = 2 * there.sum() >= _SENTINEL * edges.size  # no noise gives the same value again
        if _SENTINEL <= there.sum() < known.size / 2 and jump[edges].all() and (outside or on_end):
            return float(value), bool(outside)
    return None


def seen_before(blocks: Iterable[Any]) -> Flags:
    """Return which blocks of a stream are the same as an earlier one, bit by bit: no signal does that."""
    first: dict[bytes, int] = {}
    return np.array([first.setdefault(block, at) != at for at, block in enumerate(blocks)], np.bool_)


def few(odd: int | np.signedinteger[Any], of: int, share: float = MOST) -> bool:
    """Return whether odd samples are few enough to be left out: a share of all, and one at least."""
    return bool(odd <= max(1.0, share * of))


def scatter(off: Floats) -> Floats:
    """Return the standard deviation of normal noise by the median of its size, along the first axis."""
    return np.asarray(_STD * np.median(np.abs(off), axis=0))


def off_neighbours(values: Floats, beside: int) -> Floats:
    """Return by how much samples are off the median of as many on either side, (n,), without sign; n > ``beside``.

    A sample is no part of what it is held against. Beyond either end the series is taken as its mirror image.
    """
    return np.asarray(np.abs(values - np.median(_around(values, beside), axis=1)))


def _around(values: Floats, beside: int) -> Floats:
    """Return the neighbours of each sample, (n, 2 beside)."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, beside, mode="reflect"), 2 * beside + 1)
    return np.asarray(np.delete(around, beside, axis=1))


def lone_values(values: Floats) -> Flags:
    """Return which values of one column stand far outside of their neighbours, (n,).

    Three on either side, of which one may be as bad: a step, such as where a turn begins, lies between its neighbours.
    Far is 20 scatters, and more than the column moves from one row to the next.
    """
    if len(values) < _FEWEST:
        return np.zeros(len(values), np.bool_)
    around = np.sort(_around(values, _ABOUT), axis=1)
    beyond = np.maximum(values - around[:, -2], around[:, 1] - values)
    noise, move = scatter(off_neighbours(values, _ABOUT)), np.quantile(np.abs(np.diff(values)), _MOST_MOVES)
    least = max(_FAR_VALUE * float(noise), _MOVES * float(move), _ROUNDING * abs(float(np.median(values))))
    return np.asarray(beyond > least)


def bad_samples(values: Floats, step: float) -> Flags:
    """Return which samples stand alone outside of their neighbours.

    Args:    values: (n, k) outputs.   step: of the output, same unit.
    Returns: (n, k); at most one in a thousand of a column, or one. All false in a column where more stand out.
    Source:  see the head of this file.
    """
    bad = np.zeros(values.shape, np.bool_)
    if len(values) < 5:
        return bad
    around = np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]])
    beyond = np.maximum(values[2:-2] - around.max(axis=0), around.min(axis=0) - values[2:-2])
    noise = scatter(np.diff(values, 2, axis=0)) / math.sqrt(6.0)
    bad[2:-2] = beyond > _FAR * np.maximum(noise, _COARSE_STEP * step)
    bad[:, [not few(count, len(values)) for count in bad.sum(axis=0)]] = False
    return bad


def bridged(values: Floats, bad: Flags) -> Floats:
    """Return the same with the mean of both neighbours in place of each bad sample, (n, k).

    Args:    values: (n, k).   bad: as ``bad_samples``.
    Returns: (n, k).
    Source:  linear interpolation.
    """
    mended = values.copy()
    rows, columns = np.nonzero(bad)
    mended[rows, columns] = (values[rows - 1, columns] + values[rows + 1, columns]) / 2.0
    return mended


def off_course(values: Floats, counter: Integers) -> Integers:
    """Return the places of bad samples of a smooth course in rising order, at most one in a thousand or one.

    A kink, as where a turn begins, is no bad sample: its neighbours stay odd without it.

    Args:    values: (n, c).   counter: (n,), rising; only samples without a gap around them are judged.
    Source:  prediction by the cubic through two samples on either side; scatter by the median of the residuals.
    """
    if len(values) < _FEWEST:
        return np.zeros(0, np.int64)
    values, most = values.copy(), max(1, int(MOST * len(values)))
    off = _off(values)
    scale = scatter(off) + _RESOLUTION * np.abs(values).max(axis=0) + _TINY
    open_to_doubt = np.zeros(len(values), bool)
    open_to_doubt[2:-2] = counter[4:] - counter[:-4] == 4
    odd: list[int] = []
    for _ in range(_KINKS):
        score = np.where(open_to_doubt, np.abs(off / scale).max(axis=1), 0.0)
        at = int(np.argmax(score))
        if len(odd) == most or score[at] <= _FAR_OFF:
            break
        replaced = values[at] - off[at]
        again = _off(np.concatenate((values[max(at - 5, 0) : at], [replaced], values[at + 1 : at + 6])))
        if np.abs(again / scale).max() < _LEFT * score[at]:
            odd.append(at)
            values[at] = replaced
            off = _off(values)
        else:
            open_to_doubt[max(at - 2, 0) : at + 3] = False
    return np.array(sorted(odd), np.int64)


def _off(values: Floats) -> Floats:
    """Return samples minus their prediction, (n, c); zero for two at either end."""
    out = np.zeros_like(values)
    count = len(values) - 4
    out[2:-2] = values[2:-2] - sum(weight * values[k : k + count] for k, weight in enumerate(_WEIGHTS))
    return out
