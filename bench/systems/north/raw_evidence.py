"""What the raw waveforms of a north finder say: noise of every place, amplitude of every place, rate of the table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import Evidence
from bench.systems.north.errors_at_known import t_test
from bench.systems.north.estimators.likelihood import LikelihoodNorth
from bench.systems.north.sets import SEARCH, TEST, NorthSet
from bench.systems.north.solution import LEAST_SQUARES, LITERAL, QUADRANT, Solution
from bench.systems.north.wording import item_name, say

_FEWEST = 4
_MOST_RATE = 0.05  # of the stated rate; a serial line hands samples over in blocks
_LOCK_INS = (LEAST_SQUARES, QUADRANT, LITERAL)
_BY_LOCK_INS = ("azimuth", "azimuth_error", "azimuth_rms_error", "index_placement")
_OF_NOISE = ("azimuth", "azimuth_error", "noise", "azimuth_bound")

Pairs = list[tuple[NorthSet, LikelihoodNorth]]


def raw_evidence(solution: Solution, widths_deg: Mapping[str, float]) -> list[Evidence]:
    """Return what every check of the waveforms says; moves in expanded uncertainties."""
    pairs = [(own, raw) for own, raw in zip(solution.sets, solution.raw, strict=True) if raw is not None]
    narrowest_deg = min(widths_deg.values(), default=math.inf) or 1e-9
    return [
        *_noise(pairs), *_amplitude(pairs, solution, narrowest_deg), *_rate(solution),
    ]  # fmt: skip


def _noise(pairs: Pairs) -> Iterator[Evidence]:
    """Yield the place whose noise is most above that of all others: all share one noise in the intervals."""
    places = list(dict.fromkeys(own.group for own, _ in pairs))
    if len(places) < _FEWEST:
        return
    variance = np.array([float(raw.noise_V) ** 2 for _, raw in pairs])
    dof = np.array([int(raw.samples) for _, raw in pairs], np.float64)
    worst: tuple[float, float, Any] = (1.0, 1.0, places[0])
    for place in places:
        own = np.array([each.group == place for each, _ in pairs])
        rest = float(np.average(variance[~own], weights=dof[~own]))
        here = float(np.average(variance[own], weights=dof[own]))
        if rest > 0.0:
            chance = float(special.fdtrc(dof[own].sum(), dof[~own].sum(), here / rest))
            pooled = math.sqrt(here / float(np.average(variance, weights=dof)))
            worst = min(worst, (chance, pooled, place))
    chance, pooled, (item, place_name, head_deg, parameters) = worst
    sentence = say("evidence.noise_changes", item=item_name(item), head=head_deg, ratio=pooled)
    about = {"item": item, "head_deg": head_deg} | ({"place": place_name} if place_name else {})
    about |= {"parameters": parameters} if parameters else {}
    probability = min(1.0, max(chance * len(places), 1e-300))
    yield Evidence("noise_changes", sentence, pooled, probability, pooled - 1.0, _OF_NOISE, about)


def _amplitude(pairs: Pairs, solution: Solution, width_deg: float) -> Iterator[Evidence]:
    """Yield whether the signal at a place to be found is as large as at the mark: the Earth's rate is the same."""
    size = {item: np.array([float(raw.amplitude) for own, raw in pairs if own.item == item]) for item in (TEST, SEARCH)}
    at_mark, there = size[TEST], size[SEARCH]
    if at_mark.size < _FEWEST or not there.size:
        return
    one = float(np.mean([float(raw.noise_V) * math.sqrt(2.0 / int(raw.samples)) for _, raw in pairs]))
    scatter = max(one, float(np.std(at_mark, ddof=1)))
    share = float(there.mean() / at_mark.mean()) - 1.0
    leans = [math.hypot(*own.tilt_mrad) for own, _ in pairs if own.tilt_mrad is not None]
    leaning = 2e-3 * max(leans, default=0.0) * math.tan(math.radians(abs(solution.site.latitude_deg)))
    beyond = max(0.0, abs(share) - leaning)
    due = scatter / float(at_mark.mean()) * math.sqrt(1.0 / at_mark.size + 1.0 / there.size)
    score, probability = t_test(beyond, due, at_mark.size - 1.0)
    sentence = say("evidence.amplitude_at_place", share=100.0 * share, score=score)
    move = math.degrees(beyond) / width_deg
    yield Evidence(
        "amplitude_at_place",
        sentence,
        share,
        probability,
        move,
        ("azimuth", "scale", "azimuth_bound"),
        {"item": SEARCH},
    )


def _rate(solution: Solution) -> Iterator[Evidence]:
    """Yield a table that turns otherwise than stated: rate and sense decide what the lock-ins' phases mean."""
    for own in solution.sets:
        turned = own.turned_deg_s()
        if not math.isfinite(turned) or abs(turned - own.rate_deg_s) <= _MOST_RATE * abs(own.rate_deg_s):
            continue
        sentence = say("evidence.rate_not_as_stated", turned=turned, name=own.name, stated=own.rate_deg_s)
        for method in _LOCK_INS:
            yield Evidence(
                "rate_not_as_stated", sentence, turned, 0.0, quantities=_BY_LOCK_INS, conditions={"method": method},
                refuses=turned * own.rate_deg_s < 0.0,
            )  # fmt: skip
        return
