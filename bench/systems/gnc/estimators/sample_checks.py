"""Faults of the samples of a record, before anybody fits them: one answer for all analyses.

Saturation, samples that repeat, a sensor that hangs, gaps, time stamps that are not even, a clock that runs off.
A value that stays the same is a fault only where noise cannot leave it so: for white noise of standard deviation s in
steps of the output no value has more than the probability p = erf(1 / (s sqrt(8))), so a run of r equal pairs anywhere
in n samples has at most the probability n p^r. A run is a fault where that is below one in a million.

Source: David and Nagaraja, Order Statistics (2003), section 2.1 (Boole's bound); robust deviation of second differences
as in Rousseeuw and Croux, J. Am. Stat. Assoc. 88 (1993) 1273 (median absolute deviation).

Single samples that no motion makes: far outside of what both neighbours on either side show.

A turn that begins or ends takes the samples behind it along, so its edge lies between its neighbours; a flipped bit or
a disturbed transfer does not. A bad sample is replaced by the mean of its neighbours, because an integral needs every
sample; they are few, or none is replaced.

Source: Rousseeuw and Croux, J. Am. Stat. Assoc. 88 (1993) 1273 (median absolute deviation as scale).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Flags, Floats, Integers
from bench.systems.gnc.estimators.clocks import TickFindings, check_ticks
from bench.systems.gnc.wording import channel_name, say

Column = Integers | Floats
FALSE_ALARM = 1e-6  # for one channel of one record
REPEAT_ALARM = 1e-3  # for whole samples, one question for a record
_MAD = 0.6745  # of a normal distribution
_CAREFUL = 0.9  # of the noise found: rather a run too long than a false alarm
_FEWEST, _SMALL = 50, 2  # second differences that tell noise; steps that count as small
_FINE = 0.4  # probability of one value below which the steps of the output are fine against its noise
_COARSE = 0.3  # probability of one value above which its noise is about a step of the output
_PILE, _TIMES_BEFORE = 20, 5
SATURATED, FROZEN, REPEATED, GAP = "saturated", "frozen", "repeated", "gap"
_FAR = 10.0  # standard deviations of the noise
_SECOND = 1.4826 / 6.0**0.5  # from the median of second differences to the standard deviation of a sample
_COARSE_STEP = 0.5  # of a step: noise of less is hidden in the steps
LARGEST_SHARE = 1e-3


@dataclass(frozen=True)
class Finding:
    """One kind of fault in one channel: ``kind``, ``channel`` ("" for the whole sample), ``count`` of samples,
    ``first``: index of the first of them, ``sentence`` for a report, ``limit``: steps at the end of its range."""

    kind: str
    channel: str
    count: int
    first: int
    sentence: str
    limit: float = math.inf


@dataclass(frozen=True)
class SampleChecks:
    """Result for one record.

    Attributes:
        samples: that are there.   missing: that the counter misses.   gaps: places where it jumps.
        findings: faults, in the order found.   ticks: of the sample clock, None without one.
    """

    samples: int
    missing: int
    gaps: int
    findings: tuple[Finding, ...]
    ticks: TickFindings | None

    @property
    def clean(self) -> bool:
        """Nothing was found."""
        return not self.findings

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence for each finding."""
        return tuple(finding.sentence for finding in self.findings)

    def count(self, kind: str) -> int:
        """Return samples with this kind of finding, added over channels."""
        return sum(finding.count for finding in self.findings if finding.kind == kind)


def check_samples(
    columns: Mapping[str, Column],
    counter: Integers,
    *,
    limits: Mapping[str, float],
    interval_s: float,
    tick_s: Floats | None = None,
    received_s: Floats | None = None,
) -> SampleChecks:
    """Look at a record sample by sample.

    Args:    columns: raw output steps by channel, (n,) or (n, 3); components are called x, y, z.   counter: (n,) of
             the samples, unwrapped.   limits: largest step of each channel's range, both signs; a channel without one
             saturates nowhere.   interval_s: nominal, between samples.   tick_s: (n,) time of each sample by the
             unit's own clock or by the log, unwrapped.   received_s: (n,) when each arrived, by the bench clock.
    Returns: SampleChecks.
    Source:  see the head of this file.
    """
    flat = {
        f"{name} {'xyz'[part]}" if values.ndim == 2 else name: (values[:, part] if values.ndim == 2 else values)
        for name, values in columns.items()
        for part in range(values.shape[1] if values.ndim == 2 else 1)
    }
    findings = _gaps(counter)
    missing, gaps = sum(finding.count for finding in findings), int((np.diff(counter) > 1).sum())
    for name, values in flat.items():
        limit = limits.get(name, limits.get(name.rpartition(" ")[0], math.inf))
        findings += _saturated(name, values, limit) or _piled_up(name, values)
        findings += frozen_runs(name, values)
    findings += _repeated(flat, counter)
    ticks = None
    if tick_s is not None:
        ticks = check_ticks(tick_s, counter, interval_s, received_s)
        findings += [Finding(kind, "", count, first, text) for kind, count, first, text in ticks.faults]
    return SampleChecks(counter.size, missing, gaps, tuple(findings), ticks)


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
    starts, pairs = _runs(equal)
    kept = np.ones(max(equal.size - 1, 0), np.bool_)
    if pairs.size:
        longest = int(np.argmax(pairs))
        kept[starts[longest] : starts[longest] + pairs[longest] - 1] = False
    return kept


def _gaps(counter: Integers) -> list[Finding]:
    steps = np.diff(counter)
    places = np.flatnonzero(steps > 1)
    if not places.size:
        return []
    missing = int((steps[places] - 1).sum())
    first = int(places[0]) + 1
    text = say(
        "check.gaps",
        missing=missing,
        of=int(counter[-1] - counter[0]) + 1,
        gaps=places.size,
        first=int(counter[first]),
        longest=int(steps.max()) - 1,
    )
    return [Finding(GAP, "", missing, first, text)]


def _saturated(name: str, values: Column, limit: float) -> list[Finding]:
    """At the end of the range."""
    at_limit = np.abs(values) >= limit
    if at_limit.any():
        first = int(np.argmax(at_limit))
        count = int(at_limit.sum())
        text = say("check.saturated", name=channel_name(name), count=count, first=first)
        return [Finding(SATURATED, name, count, first, text, limit)]
    return []


def _piled_up(name: str, values: Column) -> list[Finding]:
    """Held against an extreme inside the range: it occurs far more often than the step before it.

    Noise thins out towards its extremes, and the turning points of a sine have 2.4 times the samples of the step beside
    them. Where noise is smaller than a step the values at hand are too few to tell.
    """
    if value_likelihood(values) > _COARSE:
        return []
    findings: list[Finding] = []
    for sign in (1, -1):
        turned = sign * values
        top = turned.max()
        count, before = int((turned == top).sum()), int(((turned < top) & (turned >= top - 1)).sum())
        if count >= _PILE and count > _TIMES_BEFORE * before:
            first = int(np.argmax(turned == top))
            extreme = float(sign * top)
            text = say("check.held", name=channel_name(name), count=count, extreme=extreme, first=first)
            findings.append(Finding(SATURATED, name, count, first, text))
    return findings


def frozen_runs(name: str, values: Column) -> list[Finding]:
    """Find runs of equal values that noise does not explain, or a channel that never moves.

    Args:    name: of the channel.   values: (n,) as read, in any unit.
    Returns: one finding, or none.
    Source:  see the head of this file.
    """
    if values.size > 2 and (values == values[0]).all():
        text = say("check.frozen", name=channel_name(name), count=values.size)
        return [Finding(FROZEN, name, values.size, 0, text)]
    longest = longest_equal_run([value_likelihood(values)], values.size)
    starts, pairs = _runs(np.diff(values) == 0)
    bad = pairs > longest
    if not bad.any():
        return []
    count, first = int(pairs[bad].sum()), int(starts[bad][0])
    text = say(
        "check.runs",
        name=channel_name(name),
        runs=int(bad.sum()),
        longest=int(pairs.max()) + 1,
        first=first,
        noise=longest + 1,
    )
    return [Finding(FROZEN, name, count, first, text)]


def _repeated(columns: Mapping[str, Column], counter: Integers) -> list[Finding]:
    """Whole samples equal to the one before, or with its counter, beyond what noise explains."""
    if counter.size < 2 or not columns:
        return []
    moving = [values for values in columns.values() if not (values == values[0]).all()]
    equal = np.all([np.diff(values) == 0 for values in moving], axis=0) if moving else np.zeros(counter.size - 1, bool)
    starts, pairs = _runs(equal)
    bad = pairs > longest_equal_run([value_likelihood(values) for values in moving], counter.size, REPEAT_ALARM)
    same_number = np.diff(counter) == 0
    marked = same_number.copy()
    for start, length in zip(starts[bad], pairs[bad], strict=True):
        marked[start : start + length] = True
    if not marked.any():
        return []
    count, first = int(marked.sum()), int(np.argmax(marked)) + 1
    text = say("check.repeated", count=count, first=first, same=int(same_number.sum()))
    return [Finding(REPEATED, "", count, first, text)]


def _runs(equal: Flags) -> tuple[Integers, Integers]:
    """Begin and length of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], equal.astype(np.int8), [0]))))
    return edges[::2], edges[1::2] - edges[::2]


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
    noise = _SECOND * np.median(np.abs(np.diff(values, 2, axis=0)), axis=0)
    bad[2:-2] = beyond > _FAR * np.maximum(noise, _COARSE_STEP * step)
    bad[:, bad.sum(axis=0) > max(1.0, LARGEST_SHARE * len(values))] = False
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
