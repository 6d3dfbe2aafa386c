"""Results that the tasks of the study hand back, and the form of an estimate that is made of it.

Results are plain arrays, so that they travel between processes; all statistics over runs are made where the runs are.
An estimate is held against a tolerance with one or two ends. One from 0.2 to 0.45 does not fit a limit on the size of a
value: its ends stand in the conditions as ``at_least`` and ``at_most``, and ``limit`` repeats the upper one, or the
lower where there is no upper one. The value itself is judged; its uncertainty is that of a finite number of runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Estimate, Floats, estimate
from bench.systems.time_sync.study.study import Group, Task

ERRORS = ("position_m", "velocity_m_s", "attitude_deg", "accel_bias_ug", "gyro_bias_deg_h")


@dataclass(frozen=True)
class FlightResult:
    """Statistics over the runs of one manoeuvre, at times ``t_s`` (m,).

    ``mean``, ``rms``: errors (estimate - truth) by name of ERRORS, (m, groups, 3); north, east, down, of the biases
    forward, right, down.   ``offset_*``: of the estimated offset, (m, groups): mean and RMS error over runs, s, the
    filter's own standard deviation, s, and the squared error over variance, mean over runs.   ``nis_ratio``,
    ``nis_outside``: mean normalised innovation squared over its degrees of freedom, and the share outside its 95 %
    interval, after the first seconds, (groups,).   ``eigenvalue``, ``share``: of the
    normalised covariance, the eigenvalue that belongs to the offset and the offset's own element, (m, groups).
    """

    groups: tuple[Group, ...]
    runs: int
    t_s: Floats
    mean: Mapping[str, Floats]
    rms: Mapping[str, Floats]
    offset_mean_s: Floats
    offset_rms_s: Floats
    offset_sigma_s: Floats
    offset_nees: Floats
    nis_ratio: Floats
    nis_outside: Floats
    eigenvalue: Floats
    share: Floats

    def at(self, group: Group) -> int:
        """Place of a group."""
        return self.groups.index(group)

    def during(self, begin_s: float, end_s: float) -> NDArray[np.bool_]:
        """Return which times lie in an interval, its ends included."""
        return np.asarray((self.t_s >= begin_s - 1e-9) & (self.t_s <= end_s + 1e-9))


@dataclass(frozen=True)
class Cut:
    """The focused target along one direction, of one run: metres from where it truly is, and the raw amplitude.

    ``solution``: whose positions it was focused with, "unaugmented", "augmented" or "none" (the true ones).
    """

    direction: str
    offset_ms: float
    solution: str
    at_m: Floats
    amplitude: NDArray[np.complex128]


@dataclass(frozen=True)
class Chip:
    """Size of the image about the target's true place, of one run; (azimuth, range)."""

    offset_ms: float
    solution: str
    azimuth_m: Floats
    range_m: Floats
    size: Floats


@dataclass(frozen=True)
class ImageResult:
    """Focused targets of a flight, by group and run, (groups, runs), metres and decibels; shift = image - target.

    ``predicted_m``: the shift along the track that the errors of navigation at the aperture explain.   ``several_m``
    (groups, 3): of three targets in one scene, of one run.
    """

    flight: FlightResult
    groups: tuple[Group, ...]
    predicted_m: Floats
    several_m: Floats
    azimuth_shift_m: Floats
    range_shift_m: Floats
    azimuth_resolution_m: Floats
    range_resolution_m: Floats
    pslr_dB: Floats
    islr_dB: Floats
    peak: Floats
    cuts: tuple[Cut, ...]
    chips: tuple[Chip, ...]


@dataclass(frozen=True)
class IdealResult:
    """Without any error: greatest distance of the strapdown from the flight, m and m/s, and a target's response."""

    position_m: float
    velocity_m_s: float
    resolution_m: float
    range_resolution_m: float
    pslr_dB: float
    islr_dB: float
    cuts: tuple[Cut, ...] = ()


@dataclass(frozen=True)
class Results:
    """All tasks with what they gave, in the order of the tasks."""

    pairs: Sequence[tuple[Task, Any]] = field(default_factory=tuple)

    def flight(self, manoeuvre: str, *, augmented: bool) -> FlightResult:
        """Return the 60-second flight of a manoeuvre."""
        flight: FlightResult = next(
            result
            for task, result in self.pairs
            if task.kind == "flight" and task.manoeuvre == manoeuvre and task.groups[0].augmented == augmented
        )
        return flight

    def images(self) -> Iterator[ImageResult]:
        """Return the blocks of the long flight."""
        return (result for task, result in self.pairs if task.kind == "image")

    def image(self, group: Group) -> tuple[ImageResult, int]:
        """The block that has a group's images, and the group's place in it."""
        return next((result, result.groups.index(group)) for result in self.images() if group in result.groups)

    def long_flight(self, group: Group) -> tuple[FlightResult, int]:
        """Return the long flight of a group, and the group's place in it."""
        return next(
            (result.flight, result.flight.at(group)) for result in self.images() if group in result.flight.groups
        )

    def ideal(self) -> IdealResult:
        """Return the case without errors."""
        ideal: IdealResult = next(result for task, result in self.pairs if task.kind == "ideal")
        return ideal


def measured(
    quantity: str,
    unit: str,
    value: float,
    std: float,
    conditions: Mapping[str, Any],
    *,
    n: int,
    at_least: float | None = None,
    at_most: float | None = None,
) -> Estimate:
    """Return an estimate; judged if a tolerance is given.

    Args:    std: standard uncertainty from the number of runs, 0 for what has none; all in ``unit``.
    Returns: an entry of the flat list of results.json.
    """
    ends = {"at_least": at_least, "at_most": at_most}
    given = {name: float(end) for name, end in ends.items() if end is not None}
    entry = estimate(quantity, unit, value, std, {**conditions, **given}, n=n)
    if given:
        inside = math.isfinite(value) and given.get("at_least", -math.inf) <= value <= given.get("at_most", math.inf)
        entry["limit"] = given.get("at_most", given.get("at_least"))
        entry["verdict"] = "pass" if inside else "fail"
    return entry


def rms_std(rms: float, runs: int) -> float:
    """Return standard uncertainty of the RMS of so many independent normal errors of mean zero."""
    return rms / math.sqrt(2.0 * runs)


def unjudged(entry: Estimate) -> Estimate:
    """Return the same without a verdict: the tolerance was stated for more runs than there are."""
    return {**entry, "limit": None, "verdict": "none"}
