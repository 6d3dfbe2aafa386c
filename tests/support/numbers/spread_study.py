"""Predicted uncertainties against the spread of estimates about the truth, over many campaigns."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import stats

from bench.analysis import Estimate, Estimates, Prediction

Key = tuple[str, str]
PROBABILITY = 0.999


def key_of(entry: Estimate) -> Key:
    """Name of an estimate: its quantity and where it holds."""
    return name_of(entry.quantity, entry.conditions)


def name_of(quantity: str, conditions: Mapping[str, Any]) -> Key:
    """Return the name of the estimate of a quantity under some conditions."""
    return quantity, json.dumps(conditions, sort_keys=True)


@dataclass
class Study:
    """Errors of the estimates over their predicted standard uncertainties, one of each campaign.

    ``held``: whether the interval of 95 % that each campaign states holds the truth.
    """

    prediction: Prediction
    scores: dict[Key, list[float]] = field(default_factory=dict)
    stated: dict[Key, list[float]] = field(default_factory=dict)
    held: dict[Key, list[bool]] = field(default_factory=dict)

    def add(self, estimates: Estimates, truth: Mapping[Key, float]) -> None:
        """Take a campaign in; each estimate with a truth must be predicted."""
        predicted = {key_of(entry): entry.std_uncertainty for entry in self.prediction.estimates}
        for entry in estimates:
            key = key_of(entry)
            if key in truth:
                error = entry.value - truth[key]
                self.scores.setdefault(key, []).append(error / predicted[key])
                self.held.setdefault(key, []).append(abs(error) <= entry.expanded_uncertainty)
                self.stated.setdefault(key, []).append(entry.std_uncertainty / predicted[key])

    def ratios(self) -> dict[Key, float]:
        """Spread about the truth over the predicted uncertainty."""
        return spread(self.scores)

    def outside(self) -> dict[Key, float]:
        """Ratios outside of their 99.9 % band of chi-square."""
        return {key: ratio for key, ratio in self.ratios().items() if outside({key: ratio}, len(self.scores[key]))}

    def counts(self) -> dict[Key, int]:
        """Return of each place in how many campaigns the interval holds the truth."""
        return {key: sum(held) for key, held in self.held.items()}

    def median(self) -> float:
        return float(np.median(list(self.ratios().values())))

    def lines(self) -> Iterable[str]:
        """A line for each quantity: least, median and largest ratio over its places, and stated over predicted."""
        by_quantity: dict[str, list[Key]] = {}
        for key in self.scores:
            by_quantity.setdefault(key[0], []).append(key)
        ratios, counts = self.ratios(), self.counts()
        for quantity, keys in by_quantity.items():
            own = [ratios[key] for key in keys]
            stated = np.sqrt(np.mean([np.square(self.stated[key]) for key in keys]))
            yield (
                f"{quantity}: spread / predicted {min(own):.3f} to {max(own):.3f}, median {np.median(own):.3f} "
                f"({len(keys)} places, {len(self.scores[keys[0]])} campaigns); stated / predicted {stated:.3f} rms; "
                f"{min(map(counts.__getitem__, keys))} to {max(map(counts.__getitem__, keys))} intervals hold the truth"
            )


def spread(errors: Mapping[Any, Iterable[float]], expected: Mapping[Any, float] | None = None) -> dict[Any, float]:
    """Return root mean squares of errors by place, over the standard uncertainties that are expected there."""
    return {
        where: float(np.sqrt(np.mean(np.square(list(each))))) / (1.0 if expected is None else expected[where])
        for where, each in errors.items()
    }


def band(count: float) -> tuple[float, float]:
    """Return between which ratios 99.9 % of spreads over their predictions lie, by chi-square."""
    low, high = np.sqrt(stats.chi2.ppf([(1 - PROBABILITY) / 2, (1 + PROBABILITY) / 2], count) / count)
    return float(low), float(high)


def outside(ratios: Mapping[Any, float], count: float) -> dict[Any, float]:
    """Return the ratios outside of that band."""
    low, high = band(count)
    return {where: ratio for where, ratio in ratios.items() if not low < ratio < high}


def judged(ratios: Mapping[Any, float], campaigns: int, record: Callable[[str, object], None]) -> dict[Any, float]:
    """Tell spreads over predictions by place; return those outside of their 99.9 % band of chi-square.

    The median must be 1 within 3 % at 500 campaigns, and within more at fewer.
    """
    beyond, (low, high) = outside(ratios, campaigns), band(campaigns)
    median = float(np.median(list(ratios.values())))
    inside = f"{len(beyond)} of {len(ratios)} outside {low:.3f} to {high:.3f}"
    record("obtained", f"{campaigns} campaigns: {inside}, median {median:.3f}")
    print(*(f"{where}: {ratio:.3f}" for where, ratio in ratios.items()), f"{inside}, median {median:.3f}", sep="\n")
    assert abs(median - 1.0) < 0.03 * np.sqrt(500.0 / campaigns)
    return beyond
