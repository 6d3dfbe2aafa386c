"""How the estimates of a wrong world are sorted; the truth is known here and nowhere in the analysis."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

RIGHT, WIDE, MISSED, DOUBTED, REFUSED, WRONG = "right", "wide", "missed", "doubted", "refused", "confidently_wrong"
CLASSES = (RIGHT, WIDE, MISSED, DOUBTED, REFUSED, WRONG)
_MISSED, _WRONG = 1.0, 1.5  # expanded uncertainties off
_MOVED = 1.0  # of them, by the violation: less is the chance of the seed
LEAST_TRACE = 8.0  # threshold of a thousand columns that differ at one campaign in 500, 4.9, and 3: power 99.9 %
_WIDER = 1.2  # than in the right world: the product was told


PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "doubt"}


def changed(right: type[Any], **parts: Any) -> type[Any]:
    """Return a world in which some parts are others; they take the world first, whose ``size`` they go by."""
    return type("Wrong", (right,), parts)


@dataclass(frozen=True)
class Switch:
    """One respect in which a world is wrong, and the sizes that are tried.

    ``assumption``: the code of the assumption that the report names, where no data can show it.
    """

    name: str
    world: Callable[[float], Any]
    sizes: tuple[float, ...]
    assumption: str = ""


@dataclass(frozen=True)
class Seen:
    """Estimates as results.json states them, (n,), their truths; chi-square of all residuals and repeats; how many
    estimates the campaign promises.
    """

    entries: Sequence[Any]
    truths: Sequence[float]
    chi2: float
    promised: int


def sorted_classes(wrong: Seen, right: Seen) -> Counter[str]:
    """Return how many estimates of a wrong world are in each class, held against the same seed in a right world."""
    counted = Counter(kind for _, kind in named_classes(wrong, right))
    counted[REFUSED] += wrong.promised - len(wrong.entries)
    return counted


def named_classes(wrong: Seen, right: Seen) -> list[tuple[tuple[Any, ...], str]]:
    """Return the name and the class of each estimate of a wrong world that has one."""
    before = {_name(entry): (entry, truth) for entry, truth in zip(right.entries, right.truths, strict=True)}
    return [
        (_name(entry), class_of(entry, truth, *before.get(_name(entry), (None, truth))))
        for entry, truth in zip(wrong.entries, wrong.truths, strict=True)
    ]


def class_of(entry: Any, truth: float, before: Any, truth_before: float) -> str:
    """Return the class of one estimate; ``before``: of the right world, None if it had none."""
    if entry.quality != "sound":
        return DOUBTED if entry.quality == "doubtful" else REFUSED
    off = off_by(entry, truth)
    if off > _WRONG:
        return WRONG if before is None or _is_moved(entry, truth, before, truth_before) else MISSED
    if off > _MISSED:
        return MISSED
    told = before is not None and entry.expanded_uncertainty > _WIDER * (before.expanded_uncertainty or math.inf)
    return WIDE if told else RIGHT


def _is_moved(entry: Any, truth: float, before: Any, truth_before: float) -> bool:
    """Return whether the violation put an estimate off, and not the chance of the seed."""
    if before.value is None:
        return True
    moved = abs(entry.value - truth - before.value + truth_before) > _MOVED * entry.expanded_uncertainty
    return moved and off_by(before, truth_before) <= _WRONG


def off_by(entry: Any, truth: float) -> float:
    """Return the error of an estimate in its expanded uncertainty; 0 for one that is not sound."""
    if entry.quality != "sound":
        return 0.0
    expanded = entry.expanded_uncertainty
    error = abs(entry.value - truth)
    return error / expanded if expanded else math.inf if error else 0.0


def is_visible(noise_free: Seen, right: Seen) -> bool:
    """Return whether a violation leaves a trace that could be seen."""
    return trace_of(noise_free, right) >= LEAST_TRACE


def trace_of(noise_free: Seen, right: Seen) -> float:
    """Return the norm of what a violation puts into the whitened residuals, repeats and checks included.

    ``right``: without violation and noise, where steps of readings and approximations of the fit are left over.
    """
    return math.sqrt(max(noise_free.chi2 - right.chi2, 0.0))


def worst_bias(noise_free: Seen, right: Seen) -> dict[str, float]:
    """Return by quantity how far a violation alone puts the worst estimate off, in the uncertainties of a right world.

    An estimate that is refused has no value and is left out.
    """
    expanded = {_name(entry): entry.expanded_uncertainty for entry in right.entries}
    worst: dict[str, float] = {}
    for entry, truth in zip(noise_free.entries, noise_free.truths, strict=True):
        unit = expanded.get(_name(entry))
        if entry.value is not None and unit:
            off = abs(entry.value - truth) / unit
            worst[entry.quantity] = max(off, worst.get(entry.quantity, 0.0))
    return worst


def _name(entry: Any) -> tuple[Any, ...]:
    return entry.quantity, *sorted(entry.conditions.items())


@cache
def right_world(worlds: Any, seed: int, **changes: bool) -> Seen:
    """Return what the campaign of a seed states in a right world; ``worlds``: a module of wrong ones."""
    seen: Seen = worlds.seen(seed, None, 0.0, **changes)
    return seen


def classes(worlds: Any, switch: Switch, size: float, seeds: range) -> Counter[str]:
    """Return how many estimates are in each class over all seeds."""
    counted: Counter[str] = Counter()
    for seed in seeds:
        counted += sorted_classes(worlds.seen(seed, switch, size), right_world(worlds, seed))
    print(f"{switch.name} {size:g}, seeds {seeds}: " + ", ".join(f"{counted[name]} {name}" for name in CLASSES))
    return counted


def is_hidden(worlds: Any, switch: Switch, size: float) -> bool:
    """Return whether no analysis could see it: without noise it leaves nothing in residuals and repeats."""
    return not is_visible(worlds.seen(0, switch, size, noise_free=True), right_world(worlds, 0, noise_free=True))


def codes_of(seen: Seen) -> set[str]:
    """Return the codes of all reasons against estimates."""
    return {reason.code for entry in seen.entries for reason in entry.reasons}
