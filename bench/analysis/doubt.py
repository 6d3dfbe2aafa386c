"""Doubt: what a check of the data says against an estimate, and what becomes of the estimate then.

A check either holds a value against what is plausible, or gives the probability of at least as odd data in a world as
the model has it. The second kind must be rare by chance over the whole campaign, and must move a number: one check in
three hundred is odd in most right campaigns, and what moves nothing costs nothing.

Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bench.analysis.estimates import Document, Estimate, EvidenceInterval, Reason
from bench.analysis.figures import number, with_uncertainty
from bench.analysis.wording import say
from bench.maths.verdict import INDETERMINATE

if TYPE_CHECKING:  # loads scipy
    from bench.maths.long_terms import NoiseAtRest

SOUND, DOUBTFUL, REFUSED = "sound", "doubtful", "refused"
FALSE_DOUBT = 0.002  # of right campaigns, over all their checks together
LEAST_MOVE = 0.3  # of the expanded uncertainty of the fit
DEPARTS = "departs"  # code of a departure, each of which is one thing
TOGETHER = "depart_together"  # more than one rests on the same rows
_DOUBTFUL_DIGITS = 3
_MOST_NAMED = 3  # quantities in a line
CERTAIN = 0.0  # probability that a value beyond what is plausible comes from a right world


@dataclass(frozen=True)
class Evidence:
    """What one check of a campaign's data says, whatever its outcome.

    ``quantities``, ``conditions``: the estimates it bears on; none named is every one, and a temperature coefficient
    belongs to its quantity. ``sentence``, ``figure``: what was seen. ``probability``: of data at least as odd in a
    right world. ``move``: of the estimate, in expanded uncertainties of its fit, were the check right; infinite where
    the number means nothing. ``refuses``: the value means nothing. ``interval``: where the value may lie all the same.
    ``entries``: the very estimates that it bears on, where they are known one by one.
    """

    code: str
    sentence: str
    figure: float | None
    probability: float
    move: float = math.inf
    quantities: Collection[str] = ()
    conditions: Document = field(default_factory=dict)
    refuses: bool = False
    interval: EvidenceInterval | None = None
    entries: Collection[Estimate] = ()

    def bears_on(self, entry: Estimate) -> bool:
        """Return whether an estimate depends on what was checked.

        A condition that the estimate does not have cannot keep it apart: what holds for a channel takes in every
        temperature of it.
        """
        name = entry.quantity
        if self.entries:
            return any((one.quantity, one.conditions) == (name, entry.conditions) for one in self.entries)
        named = not self.quantities or name in self.quantities or base_quantity(name) in self.quantities
        of_it = entry.conditions
        return named and all(of_it.get(name, value) == value for name, value in self.conditions.items())

    @property
    def reason(self) -> Reason:
        """The check as the reason of a doubt."""
        return Reason.model_construct(code=self.code, sentence=self.sentence, figure=self.figure)


def noise_evidence(
    noise: NoiseAtRest, sensor: str, terms: Collection[str], conditions: Document
) -> tuple[Evidence, Evidence]:
    """Return what says that a log at rest is no noise of its terms alone.

    Args: sensor: for people.   terms: quantities of its noise terms.   conditions: of all its estimates.
    """
    long, misfit = noise.long, say("noise.no_terms", sensor=sensor)
    odd = say("noise.cycle" if long.cycle else "noise.jumps", sensor=sensor, time=long.odd_s)
    return (
        Evidence("not_one_noise", odd, long.odd_s, long.oddness, conditions=conditions),
        Evidence("no_terms", misfit, None, noise.chance, quantities=terms, conditions=conditions),
    )


def possible_terms(noise: NoiseAtRest, sensor: str, names: Collection[str]) -> list[str]:
    """Say which long terms, by their ``names`` for people, a log may have that does not show which of them."""
    return (
        [say("noise.possible", sensor=sensor, terms=say.listed(names, "departs.parts"))] if noise.long.possible else []
    )


_ENDINGS = ("_tc0", "_tc1", "_tc2", "_tc3", "_residual", "_change", "_drift")


def base_quantity(quantity: str) -> str:
    """Return the quantity that a coefficient, residual, change or drift is of."""
    return next((quantity.removesuffix(ending) for ending in _ENDINGS if quantity.endswith(ending)), quantity)


@dataclass(frozen=True)
class Weighed:
    """The checks of a campaign after all were heard: ``against`` cast doubt, ``noted`` are odd and move too little."""

    against: Sequence[Evidence]
    noted: Sequence[Evidence]


def weigh(evidence: Iterable[Evidence]) -> Weighed:
    """Sort the checks of a whole campaign, those that found nothing included: their number sets the level.

    Source: the union bound; docs/method-uncertainty.md.
    """
    heard = list(evidence)
    chances = sum(seen.probability > CERTAIN for seen in heard)
    odd = [seen for seen in heard if seen.probability <= FALSE_DOUBT / max(chances, 1)]
    against = [seen for seen in odd if seen.move > LEAST_MOVE]
    return Weighed(against, [seen for seen in odd if seen.move <= LEAST_MOVE])


def stated(entry: Estimate, against: Sequence[Evidence]) -> Estimate:
    """Return what the checks against an estimate leave of it, and why.

    A doubtful estimate keeps its value and has no uncertainty and no verdict; a refused one has no value either.
    """
    heard = [check for check in against if check.bears_on(entry)]
    if not heard:
        return entry.model_copy(update={"quality": SOUND, "reasons": []})
    refused = any(check.refuses for check in heard)
    intervals = [check.interval for check in heard if check.interval is not None]
    given = {
        **{name: getattr(entry, name) for name in entry.model_fields_set - {"common"}},
        "value": None if refused else entry.value,
        "std_uncertainty": None,
        "coverage_factor": None,
        "expanded_uncertainty": None,
        "dof": None,
        "verdict": INDETERMINATE,
        "conformance_probability": None,
        "quality": REFUSED if refused else DOUBTFUL,
        "reasons": [check.reason for check in heard],
    }
    if intervals and not refused:
        given["evidence_interval"] = intervals[0]
    return Estimate.model_construct(**given)


def is_sound(entry: Estimate) -> bool:
    """Return whether nothing casts doubt on an estimate."""
    return entry.quality == SOUND


def stated_value(entry: Estimate, scale: float = 1.0) -> str:
    """Return value and expanded uncertainty of an estimate times ``scale``, or what is left of them.

    A doubtful value has no more digits than sound ones of its kind have.
    """
    value, expanded = entry.value, entry.expanded_uncertainty
    if value is None:
        return say("stated.refused")
    if not is_sound(entry) and not entry.acceptance:
        return say("stated.doubtful", value=number(float(f"{value * scale:.{_DOUBTFUL_DIGITS}g}")))
    text = with_uncertainty(value * scale, None if expanded is None else expanded * scale)
    return text if is_sound(entry) else say("stated.accepted", value=text)


def doubt_lines(entries: Iterable[Estimate]) -> list[str]:
    """Return what is wrong in a line for each kind of reason, the worst first: its sentence with the largest figure, at
    how many places more, and how many estimates it takes in. Empty for sound estimates.

    A departure has a line of its own, unless more than one rests on the same rows: then the surest speaks for all.
    """
    by_kind: dict[tuple[str, str, str], dict[str, float]] = {}
    taken_in: dict[tuple[str, str, str], Counter[str]] = {}
    for entry in entries:
        alone, kinds = TOGETHER not in {reason.code for reason in entry.reasons}, set()
        for reason in entry.reasons:
            kinds.add(kind := (entry.quality, reason.code, reason.sentence if reason.code == DEPARTS and alone else ""))
            by_kind.setdefault(kind, {})[reason.sentence] = abs(reason.figure or 0.0)
        for kind in kinds:
            taken_in.setdefault(kind, Counter())[base_quantity(entry.quantity)] += 1
    lines: list[str] = []
    for (quality, code, thing), sentences in sorted(by_kind.items(), key=lambda item: item[0][0] != REFUSED):
        others = len(sentences) - 1
        more = "also" if code == DEPARTS else "more"
        more = say(f"doubt.{more}", count=others) if others > 1 else say(f"doubt.{more}_one") if others else ""
        counts = taken_in[quality, code, thing]
        names = [*list(counts)[:_MOST_NAMED], *["..."][: len(counts) > _MOST_NAMED]]
        worst = next(iter(sentences)) if code == DEPARTS else max(sentences, key=sentences.__getitem__)
        key = f"doubt.{quality}" if (count := counts.total()) > 1 else f"doubt.{quality}_one"
        of = ", ".join(names)
        lines.append(say(key, count=count, of=of, worst=worst, more=more, code=code))
    return lines
