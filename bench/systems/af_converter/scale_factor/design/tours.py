"""The orders in which temperatures may be visited: from one of them out, back to it in the middle, and back at the end.

The reference channels are read there three times, so that a drift shows over the whole campaign and its two parts.
Source: docs/decisions/0025-doubt.md; Daniel and Wilcoxon, Technometrics 8 (1966), on orders robust against drift.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

COEFFICIENTS = 3  # of the polynomial over temperature
MIDDLE, CLOSING = 1, 2  # numbers of the repeats


@dataclass(frozen=True, order=True)
class Stop:
    """A temperature that is soaked at; ``repeat``: 0 for the visit of all channels, else which repeat it is."""

    temperature_degC: float
    repeat: int = 0


Tour = tuple[Stop, ...]


def tours(temperatures_degC: Sequence[float]) -> Iterator[Tour]:
    """Yield every tour of some of the temperatures with the lowest and the highest, one more than coefficients."""
    lowest, *inner, highest = sorted(temperatures_degC)
    for left_out in range(len(inner) - (COEFFICIENTS - 1) + 1):
        for kept in combinations(inner, len(inner) - left_out):
            yield from _round((lowest, *kept, highest))


def _round(temperatures_degC: tuple[float, ...]) -> Iterator[Tour]:
    for home in temperatures_degC:
        others = [degC for degC in temperatures_degC if degC != home]
        for order in permutations(others):
            for middle in range(1, len(order)):
                out, on = ([Stop(degC) for degC in part] for part in (order[:middle], order[middle:]))
                yield (Stop(home), *out, Stop(home, MIDDLE), *on, Stop(home, CLOSING))


def missing_repeats(tour: Tour) -> list[str]:
    """Return which of opening, middle and closing visit of one temperature a tour lacks."""
    first, last = tour[0], tour[-1]
    closed = last.repeat > 0 and last.temperature_degC == first.temperature_degC and first.repeat == 0
    middle = any(stop.repeat and stop.temperature_degC == first.temperature_degC for stop in tour[1:-1])
    return [name for name, there in (("opening and closing", closed), ("middle", middle)) if not there]


def is_monotone(tour: Tour) -> bool:
    """Return whether the first visits go through the temperatures in one direction."""
    steps = np.diff([stop.temperature_degC for stop in tour if stop.repeat == 0])
    return bool(np.all(steps > 0) or np.all(steps < 0))
