"""The Monte Carlo study of the time offset between EGI and IMU: what is flown, and the tasks it is cut into.

A task is one manoeuvre with one block of offsets and filters. The tasks and their order are the same on one machine and
on many, and nothing is added up across tasks but in this order, so that the numbers do not depend on who computed them.
Source: S. Lee et al., J. Korean Soc. Aeronaut. Space Sci. 48(4), 285-293 (2020), Tables 1-7, sections 2.1-3.3.

Results that the tasks of the study hand back, and the form of an estimate that is made of it.

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

from bench.analysis import Document, Estimate, Floats, estimate
from bench.maths.arrays import Flags
from bench.model.errors import InputError
from bench.systems.time_sync.estimators.sar.image import Chip
from bench.systems.time_sync.estimators.sar.response import Response

NAME = "time_sync"
RUNS, FEWEST_RUNS, MOST_RUNS = 50, 2, 1000
QUICK_RUNS = 6
FARTHEST_ms = 150.0  # beyond it a target of the scene is imaged where the next one is looked for
RECOVERED_ms = (-20.0, 0.0, 10.0, 13.7, 20.0, 30.0)  # what the augmented filter is asked to find
SHOWN_ms = 20.0  # offset of the paper's figures 15 and 16
SHORT_s, LONG_s, QUICK_LONG_s = 60.0, 500.0, 200.0
APERTURE_s = 10.0
SETTLED_s = 5.0  # statistics begin when the first corrections are over
BASE, TIGHT, LOOSE = "base", "tight", "loose"
SIGMA_R = {BASE: (1.0, 0.2, 0.01), TIGHT: (1.0, 0.05, 0.01), LOOSE: (10.0, 2.0, 0.05)}  # m, m/s, deg
AUGMENTED, UNAUGMENTED, ERRORLESS = "augmented", "unaugmented", "none"
NARROW_P0_m, WIDE_P0_m = 1.0, 10.0
# numbers that the paper prints, and the flight they belong to
OFFSETS_ms = (0.0, 10.0, 20.0, 30.0)
POSITION_m = dict(zip(OFFSETS_ms, (0.3219, 1.045, 2.019, 3.01), strict=True))  # Table 5, latitude
VELOCITY_m_s = dict(zip(OFFSETS_ms, (0.03439, 0.08124, 0.1467, 0.2143), strict=True))  # Table 6, V_N
YAW_deg = dict(zip(OFFSETS_ms, (0.01347, 0.04958, 0.09429, 0.1396), strict=True))  # Table 7
SPEED_m_s, ACCELERATION_m_s2, RATE_deg_s = 100.0, 5.0, 4.5  # Table 4; 90 deg in 20 s
MANOEUVRE_s = (20.0, 40.0)
FLOWN = ("linear", "acceleration", "turn")
IMAGE_SPEED_m_s = 250.0  # 100 m/s and 10 s of 15 m/s2
ERRORS = ("position_m", "velocity_m_s", "attitude_deg", "accel_bias_ug", "gyro_bias_deg_h")


@dataclass(frozen=True)
class StudyOptions:
    """Options of a study. ``quick``: fewer runs and a shorter flight, for a look; what needs 50 runs is not judged."""

    runs: int = RUNS
    seed: int = 1
    offsets_ms: tuple[float, ...] = OFFSETS_ms
    quick: bool = False

    @property
    def long_s(self) -> float:
        """Length of the flight that ends with the radar on, s."""
        return QUICK_LONG_s if self.quick else LONG_s

    @property
    def judged(self) -> bool:
        """Whether the tolerances hold: they are stated for 50 runs and the whole flight."""
        return self.runs >= RUNS and not self.quick


@dataclass(frozen=True)
class Group:
    """One filter on one offset, over all runs; ``augmented``: with a state for it.   ``noise``: key of SIGMA_R."""

    offset_ms: float
    augmented: bool = False
    noise: str = BASE

    @property
    def offset_s(self) -> float:
        """The offset in seconds."""
        return self.offset_ms * 1e-3

    @property
    def solution(self) -> str:
        """The filter in one word."""
        return AUGMENTED if self.augmented else UNAUGMENTED

    def where(self, manoeuvre: str, **more: Any) -> dict[str, Any]:
        """Return conditions of an estimate."""
        return {"manoeuvre": manoeuvre, "offset_ms": self.offset_ms, "filter": self.solution, **more}


@dataclass(frozen=True)
class Task:
    """One manoeuvre, one block of groups: plain values only, so that it travels to another process.

    ``kind``: "flight", "image" (a flight whose end is focused) or "ideal" (no errors at all).
    """

    kind: str
    manoeuvre: str
    duration_s: float
    groups: tuple[Group, ...]
    runs: int
    seed: int
    position_sigma_m: float = NARROW_P0_m

    @property
    def name(self) -> str:
        """Return the name that a person reads while the task runs."""
        if self.kind == "ideal":
            return "no errors: navigation and image"
        offsets = ", ".join(f"{offset:g}" for offset in dict.fromkeys(group.offset_ms for group in self.groups))
        solutions = {group.solution for group in self.groups}
        what = solutions.pop() if len(solutions) == 1 else "both filters"
        return f"{self.manoeuvre}, {what}, offsets {offsets} ms{', images' if self.kind == 'image' else ''}"


def checked_options(runs: int | None, seed: int, offsets: str, quick: bool) -> StudyOptions:
    """Options as a person gives them; ``offsets``: ms, with commas between.

    Raises: InputError B-STUDY-002 naming what is wrong and its limits.
    """
    count = runs if runs is not None else (QUICK_RUNS if quick else RUNS)
    if not FEWEST_RUNS <= count <= MOST_RUNS:
        raise _wrong("--runs", count, f"{FEWEST_RUNS} to {MOST_RUNS} are possible")
    try:
        offsets_ms = tuple(dict.fromkeys(float(part) for part in offsets.split(",")))
    except ValueError:
        raise _wrong("--offsets", offsets, "milliseconds with commas between are due, such as 0,10,20,30") from None
    if 0.0 not in offsets_ms:
        raise _wrong("--offsets", offsets, "0 must be among them: every other offset is compared with it")
    if not all(abs(offset) <= FARTHEST_ms for offset in offsets_ms):
        raise _wrong("--offsets", offsets, f"the limit is {FARTHEST_ms:g} ms either way")
    return StudyOptions(count, seed, tuple(sorted(offsets_ms)), quick)


def _wrong(where: str, value: object, limit: str) -> InputError:
    return InputError("B-STUDY-002", f"is {value}; {limit}", where=where, next_step="correct it and start again")


def tasks_of(options: StudyOptions) -> list[Task]:
    """Return all tasks of a study, the longest first: whoever shares them out ends with short ones."""
    plain = _groups(options.offsets_ms, ((False, BASE), (False, TIGHT)))
    recovering = _groups(RECOVERED_ms, ((True, BASE),))
    runs, seed = options.runs, options.seed
    return [
        *image_tasks(options),
        *(
            Task("flight", name, SHORT_s, plain, runs, seed)
            for name in ("turn", "acceleration", "linear", "stationary")
        ),
        *(
            Task("flight", name, SHORT_s, recovering, runs, seed, WIDE_P0_m)
            for name in ("turn", "acceleration", "linear")
        ),
        Task("ideal", "turn", SHORT_s, (), 1, seed),
    ]


def image_tasks(options: StudyOptions) -> list[Task]:
    """The long flight, two offsets at a time: tight filters with and without the offset's state, and a loose one."""
    kinds = ((False, TIGHT), (True, TIGHT), (True, LOOSE))
    blocks = [options.offsets_ms[at : at + 2] for at in range(0, len(options.offsets_ms), 2)]
    return [
        Task("image", "sar", options.long_s, _groups(block, kinds), options.runs, options.seed, WIDE_P0_m)
        for block in blocks
    ]


def _groups(offsets_ms: Sequence[float], kinds: Sequence[tuple[bool, str]]) -> tuple[Group, ...]:
    return tuple(Group(offset_ms, augmented, noise) for offset_ms in offsets_ms for augmented, noise in kinds)


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

    def during(self, begin_s: float, end_s: float) -> Flags:
        """Return which times lie in an interval, its ends included."""
        return (self.t_s >= begin_s - 1e-9) & (self.t_s <= end_s + 1e-9)


@dataclass(frozen=True)
class ImageResult:
    """Focused targets of a flight, by group and run, (groups, runs), metres and decibels; shift = image - target.

    ``predicted_m``: the shift along the track that the errors of navigation at the aperture explain.   ``several_m``
    (groups, 3): of three targets in one scene, ``responses`` and ``chips`` (about its true place) of the middle one,
    (groups,): of one run.
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
    responses: tuple[Response, ...]
    chips: tuple[Chip, ...]


@dataclass(frozen=True)
class IdealResult:
    """Without any error: greatest distance of the strapdown from the flight, m and m/s, and a target's response."""

    position_m: float
    velocity_m_s: float
    response: Response


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


ANY = (-math.inf, math.inf)


def measured(
    quantity: str,
    unit: str,
    value: float,
    std: float,
    conditions: Document,
    *,
    n: int,
    within: tuple[float, float] = ANY,
) -> Estimate:
    """Return an estimate; judged if a tolerance is given.

    Args:    std: standard uncertainty from the number of runs, 0 for what has none.   within: ends of the tolerance; an
             infinite one is none. All in ``unit``.
    Returns: an entry of the flat list of results.json.
    """
    low, high = within
    ends = {name: float(end) for name, end in (("at_least", low), ("at_most", high)) if math.isfinite(end)}
    entry = estimate(quantity, unit, value, std, {**conditions, **ends}, n=n)
    if ends:
        inside = math.isfinite(value) and low <= value <= high
        limit = ends.get("at_most", low)
        return entry.model_copy(update={"limit": limit, "verdict": "pass" if inside else "fail"})
    return entry


def rms_std(rms: float, runs: int) -> float:
    """Return standard uncertainty of the RMS of so many independent normal errors of mean zero."""
    return rms / math.sqrt(2.0 * runs)


def unjudged(entry: Estimate) -> Estimate:
    """Return the same without a verdict: the tolerance was stated for more runs than there are."""
    return entry.model_copy(update={"limit": None, "verdict": "none"})
