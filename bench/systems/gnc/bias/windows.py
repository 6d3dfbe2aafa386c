"""Means of records at rest with their uncertainty, and which two of them are a flip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bench.model.errors import FitError
from bench.systems.gnc.estimators.bias_mean import BiasMean, flip_bias, mean_bias
from bench.systems.gnc.estimators.bias_stability import on_the_counter
from bench.systems.gnc.estimators.earth_rate import body_to_table
from bench.systems.gnc.rows import AXES, SampledRow

_ALONG = 0.999  # cosine


@dataclass(frozen=True)
class Window:
    """``means``: of x, y, z as indicated.   ``start_s``: bench clock.   ``length_s``: by the unit's own clock."""

    means: tuple[BiasMean, ...]
    start_s: float
    length_s: float


def window_of(row: SampledRow, kind: str, resolution: float = 0.0) -> Window:
    """Means of a record at rest. Raises: FitError B-FIT-092 for less than a minute of samples."""
    interval_s = 1.0 / row.rate_Hz
    placed = on_the_counter(row.samples.counter, row.values(kind))
    means = tuple(mean_bias(placed[:, k], interval_s, resolution) for k in range(3))
    return Window(means, row.begin_s, len(placed) * interval_s)


@dataclass(frozen=True)
class Flip:
    """Accelerometer bias by axis from two records, and the axis about which the unit was turned: it has none."""

    by_axis: dict[str, BiasMean]
    about: str


def flip_of(rows: Sequence[SampledRow], resolution_g: float) -> Flip | None:
    """The first two records between which the unit was turned by half a turn about a body axis; None without any.

    Raises: FitError B-FIT-092 for records of less than a minute.
    """
    for one, two in combinations(rows, 2):
        about = _about(one, two)
        if about is not None:
            first, second = (window_of(row, "accelerometer", resolution_g).means for row in (one, two))
            found: dict[str, BiasMean] = {}
            for k, axis in enumerate(AXES):
                try:
                    found[axis] = flip_bias(first[k], second[k], axis=axis, about=about)
                except FitError as error:
                    if error.code != "B-FIT-094":
                        raise
            return Flip(found, about)
    return None


def _about(one: SampledRow, two: SampledRow) -> str | None:
    """Body axis that stays where it is in the table's frame while the two others turn over."""
    cosines = np.sum(body_to_table(one.pose) * body_to_table(two.pose), axis=0)
    if np.sum(cosines < -_ALONG) != 2 or np.sum(cosines > _ALONG) != 1:
        return None
    return AXES[int(np.argmax(cosines))]
