"""North as it was found: azimuths of all sets by every method, their errors where the azimuth is known, their means.

Calibration, test and search are different sets: an error is never evaluated on the noise that calibrated.

How accurate each method is at known azimuths, and how long it must measure for a required accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis import Floats
from bench.maths.arrays import Flags, Integers, rms
from bench.maths.variances import of_variances
from bench.systems.north.estimators.likelihood import LikelihoodNorth, likelihood_north, time_to_accuracy_s
from bench.systems.north.estimators.phasors import IndexCalibration, heading_deg, tilt_std_deg, wrapped_deg
from bench.systems.north.sets import SEARCH, TEST, NorthSet, Waveform, waveform_of

LEAST_SQUARES, LIKELIHOOD, QUADRANT, LITERAL = "least_squares", "likelihood", "quadrant", "literal"
METHODS = (LEAST_SQUARES, LIKELIHOOD, QUADRANT, LITERAL)
COVERAGE = 1.96  # 95 % of a normal distribution
QUARTER_TURN_deg = 90.0  # an error beyond is one of the branch, not of noise
_PARTS = (1, 2, 4, 8, 16)  # pieces of a record
_LEAST = 4  # errors that make a scatter
_LEAST_TURNS = 0.95


@dataclass(frozen=True)
class Azimuths:
    """Headings of the sensing axis at encoder zero by one method.

    ``azimuth_deg``: (n,) for n sets, (-180, 180], NaN where there is none.   ``noise_deg``: standard uncertainty of one
    of them by noise, with ``dof`` degrees of freedom.   ``common_deg``: what all of them share, by the calibration,
    with ``common_dof``.   ``calibration``: its variance over that of the noise of one set by least squares, as the
    calibration was planned; 0 where the method's own errors say more than noise does.
    """

    azimuth_deg: Floats
    noise_deg: float
    dof: float
    common_deg: float = 0.0
    common_dof: float = math.inf
    calibration: float = 0.0

    def dof_of_mean(self, n: int) -> float:
        """Effective degrees of freedom of a mean of ``n``. Source: JCGM 100:2008, equation (G.2b)."""
        if self.common_dof == self.dof:  # both of one estimate of the noise
            return self.dof
        parts = ((self.noise_deg / math.sqrt(n), self.dof), (self.common_deg, self.common_dof))
        whole = sum(std**2 for std, _ in parts) ** 2
        share = sum(std**4 / dof for std, dof in parts)
        return whole / share if share > 0.0 else math.inf


@dataclass(frozen=True)
class Site:
    """Where the bench stands; ``azimuth_deg`` of the sensing axis at encoder zero with the dividing head at 0.

    ``azimuth_std_deg``, ``tilt_std_deg``: standard uncertainties, 0 where nobody states them.
    """

    latitude_deg: float
    azimuth_deg: float
    azimuth_std_deg: float = 0.0
    tilt_std_deg: float = 0.0


@dataclass(frozen=True)
class Mean:
    """Phasor mean over ``n`` repeats of a heading by one method, degrees; errors NaN where the azimuth is not known."""

    item: str
    place: str
    head_deg: float
    parameters: str
    azimuth_deg: float
    std_deg: float
    error_deg: float
    error_std_deg: float
    n: int
    dropped: int
    dof: float


@dataclass
class Solution:
    """Everything found of ``sets``, (n,) arrays beside them.

    ``known_deg``: stated azimuth, NaN for a search.   ``tilt_deg``: correction that was added.   ``good``: eight
    samples that can be used.   ``u1_V``, ``u2_V``: (n, 4), as a table that turns counter-clockwise would give them.
    ``calibrations``: by sense of rotation.   ``raw``: fits of the waveforms.   ``failures``: of the literal formulas,
    by name, (n,) counts.   ``swing_deg``: RMS of the table about a steady rotation: where its period fits the turn, the
    index passes early or late by as much, and otherwise after each start.   ``unsteady``: the amplitude changes
    between index positions, so that the noise of least squares is that across the signal alone.
    """

    sets: Sequence[NorthSet]
    site: Site
    known_deg: Floats
    tilt_deg: Floats
    good: Flags
    u1_V: Floats
    u2_V: Floats
    raw: Sequence[LikelihoodNorth | None] = ()
    swing_deg: float = 0.0
    unsteady: bool = False
    calibrations: Mapping[int, IndexCalibration] = field(default_factory=dict)
    by_method: dict[str, Azimuths] = field(default_factory=dict)
    failures: Mapping[str, Floats] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    def of(self, item: str) -> Flags:
        """(n,) sets of an item."""
        return np.array([north_set.item == item for north_set in self.sets])

    def with_parameters(self, kind: str) -> Flags:
        """(n,) sets with parameters of a kind."""
        return np.array([north_set.parameters == kind for north_set in self.sets])

    @property
    def kinds(self) -> list[str]:
        """Kinds of parameters of the tests, in their order; [""] where the sequence names none."""
        return list(dict.fromkeys(north_set.parameters for north_set in self.sets if north_set.item == TEST)) or [""]

    @property
    def sense(self) -> Integers:
        """(n,) +1 counter-clockwise, -1 clockwise."""
        return np.array([north_set.sense for north_set in self.sets])

    @property
    def bound_deg(self) -> Floats:
        """(n,) Cramer-Rao bound of each set by the samples of its records, degrees, NaN without them."""
        return self.of_waveforms("bound_deg")

    def of_waveforms(self, name: str) -> Floats:
        """Return an attribute of the fits of all waveforms, (n,); NaN where there is none."""
        return np.array([float(getattr(waveform, name, math.nan)) for waveform in self.raw])

    @property
    def placed_deg(self) -> float:
        """Standard uncertainty of the index placement beside noise: azimuth of the mark, tilt, swing, degrees."""
        return math.hypot(self.site.azimuth_std_deg, self.tilted_deg, self.swing_deg)

    @property
    def tilted_deg(self) -> float:
        """Standard uncertainty of an azimuth by that of the tilt, degrees."""
        return tilt_std_deg(1e3 * math.radians(self.site.tilt_std_deg), self.site.latitude_deg)

    def error_deg(self, method: str) -> Floats:
        """(n,) azimuth minus stated azimuth of the tests, folded into (-180, 180], NaN elsewhere."""
        error_deg = wrapped_deg(self.by_method[method].azimuth_deg - self.known_deg)
        return np.where(self.of(TEST), error_deg, math.nan)

    def means(self, method: str) -> list[Mean]:
        """Tests and searches by this method, repeats of a heading together, in their order."""
        groups = dict.fromkeys(north_set.group for north_set in self.sets if north_set.item in (TEST, SEARCH))
        return [mean for group in groups if (mean := self._mean(method, *group)) is not None]

    def _mean(self, method: str, item: str, place: str, head_deg: float, parameters: str) -> Mean | None:
        group = item, place, head_deg, parameters
        own = np.array([north_set.group == group for north_set in self.sets])
        azimuths = self.by_method[method]
        azimuth_deg = azimuths.azimuth_deg[own & np.isfinite(azimuths.azimuth_deg)]
        if not azimuth_deg.size:
            return None
        mean_deg = float(np.rad2deg(np.angle(np.mean(np.exp(1j * np.deg2rad(azimuth_deg))))))
        swing_deg = 0.0 if method == LIKELIHOOD else self.swing_deg * math.sqrt(2.0 if self.calibrations else 1.0)
        own_deg = math.hypot(
            azimuths.noise_deg / math.sqrt(azimuth_deg.size), azimuths.common_deg, self.tilted_deg, swing_deg
        )
        known_deg = float(self.known_deg[own][0])
        # what the mark calibrates carries its uncertainty; an error against the mark does so where it does not
        by_mark, beside_mark = (self.site.azimuth_std_deg, 0.0) if method != LIKELIHOOD and self.calibrations else (
            0.0, self.site.azimuth_std_deg)  # fmt: skip
        return Mean(
            item=item,
            place=place,
            head_deg=head_deg,
            parameters=parameters,
            azimuth_deg=mean_deg,
            std_deg=math.hypot(own_deg, by_mark),
            error_deg=float(wrapped_deg(mean_deg - known_deg)),
            error_std_deg=math.hypot(own_deg, beside_mark),
            n=azimuth_deg.size,
            dropped=int(own.sum()) - azimuth_deg.size,
            dof=azimuths.dof_of_mean(azimuth_deg.size),
        )

    def rms_deg(self, method: str) -> float:
        """Root mean square of the errors of single sets at the known azimuths, degrees; NaN without any."""
        error_deg = self.error_deg(method)
        seen = error_deg[np.isfinite(error_deg)]
        return rms(seen) if seen.size else math.nan


@dataclass(frozen=True)
class Accuracy:
    """One method at the known azimuths, single sets: all in degrees, NaN without any.

    ``rms_deg``: of the errors; ``rms_std_deg``: how well it is known.   ``gross``: errors of more than a quarter turn:
    another branch of an arctangent.   ``mean_deg``, ``scatter_deg`` about it: of the directions without regard to half
    a turn, where there are such errors, for what lies in two heaps half a turn apart has no mean between them.
    ``ratio``: scatter over the bound.   ``time_s``: measuring time until 95 % of the errors are within the limit,
    infinite if the calibration does not allow it; ``time_std_s``, ``time_within_s``: its standard uncertainty, and half
    of the interval of 95 %, infinite where the calibration may not allow it.
    """

    method: str
    used: int
    rms_deg: float
    rms_std_deg: float
    mean_deg: float
    scatter_deg: float
    ratio: float
    gross: int
    time_s: float
    time_std_s: float
    time_within_s: float


def accuracies(solution: Solution, limit_deg: float) -> list[Accuracy]:
    """Return every method, in the order of METHODS."""
    return [_accuracy(solution, method, limit_deg) for method in METHODS]


def _accuracy(solution: Solution, method: str, limit_deg: float) -> Accuracy:
    error_deg = solution.error_deg(method)
    seen = np.isfinite(error_deg)
    errors_deg, bound_deg = error_deg[seen], solution.bound_deg[seen]
    if not errors_deg.size:
        return Accuracy(method, 0, *(math.nan,) * 5, 0, *(math.nan,) * 3)
    gross = int(np.sum(np.abs(errors_deg) > QUARTER_TURN_deg))
    within_deg = half_turns_off(errors_deg) if gross else errors_deg
    mean_deg = float(np.mean(within_deg))
    scatter_deg = float(np.std(within_deg, ddof=1)) if within_deg.size > 1 else math.nan
    known = bound_deg[np.isfinite(bound_deg)]
    ratio = scatter_deg / rms(known) if known.size else math.nan
    time_s = _time_s(solution, method, limit_deg) if not gross else (math.inf,) * 3  # no time turns a wrong branch
    rms_deg = solution.rms_deg(method)
    std_deg = rms_std_deg(rms_deg, scatter_deg, _shared_deg(solution, method), errors_deg.size)
    if gross and errors_deg.size > 1:  # two heaps are no normal errors
        std_deg = float(np.std(errors_deg**2, ddof=1)) / math.sqrt(errors_deg.size) / (2.0 * rms_deg)
    return Accuracy(method, errors_deg.size, rms_deg, std_deg, mean_deg, scatter_deg, ratio, gross, *time_s)


def expected_accuracies(solution: Solution, limit_deg: float) -> list[Accuracy]:
    """Return what ``accuracies`` will be by the uncertainties of a solution, of methods that are on no wrong branch."""
    expected = []
    for seen in accuracies(solution, limit_deg):
        if not seen.used or seen.gross:
            continue
        swing_deg = 0.0 if seen.method == LIKELIHOOD else math.sqrt(2.0) * solution.swing_deg
        scatter_deg = math.hypot(solution.by_method[seen.method].noise_deg, swing_deg)
        shared_deg = _shared_deg(solution, seen.method)
        rms_deg = math.hypot(scatter_deg, shared_deg)
        std_deg = rms_std_deg(rms_deg, scatter_deg, shared_deg, seen.used)
        expected.append(replace(seen, rms_deg=rms_deg, rms_std_deg=std_deg, scatter_deg=scatter_deg))
    return expected


def _shared_deg(solution: Solution, method: str) -> float:
    """Return the standard uncertainty that all errors at the known azimuths share: of the calibration, or the mark."""
    if not solution.calibrations or method == LIKELIHOOD:
        return solution.site.azimuth_std_deg
    placed_deg = max(index.std_deg(method) for index in solution.calibrations.values())
    return min(placed_deg, solution.by_method[method].common_deg)  # a wrong branch is not shared by all azimuths


def half_turns_off(error_deg: Floats) -> Floats:
    """Return errors of directions, (n,), that are known but for half a turn: about their axial mean, degrees.

    Source: Mardia and Jupp, Directional Statistics, section 9.1: axes are averaged with the angle doubled.
    """
    mean_deg = float(np.rad2deg(np.angle(np.mean(np.exp(2j * np.deg2rad(error_deg)))))) / 2.0
    return mean_deg + wrapped_deg(2.0 * (error_deg - mean_deg)) / 2.0


def rms_std_deg(rms_deg: float, scatter_deg: float, shared_deg: float, n: int) -> float:
    """Standard uncertainty of the RMS of ``n`` errors with a part that they share (calibration or mark), degrees.

    Source: variance of the mean square of normal errors with a common part, JCGM 100:2008 section 5.1.2.
    """
    shared = min(shared_deg, rms_deg)  # it is in there: no larger than what was seen
    variance = 2.0 * scatter_deg**4 / n + 2.0 * shared**4 + 4.0 * (scatter_deg * shared) ** 2 / n
    return math.sqrt(variance) / (2.0 * rms_deg) if rms_deg > 0.0 else 0.0


def _time_s(solution: Solution, method: str, limit_deg: float) -> tuple[float, float, float]:
    """Return the time, its standard uncertainty and half of its interval: by the variances of noise and calibration."""
    azimuths, seconds = solution.by_method[method], measured_s(solution)
    swing_deg = 0.0 if method == LIKELIHOOD else math.sqrt(2.0) * solution.swing_deg
    common_deg = azimuths.common_deg
    if azimuths.calibration:  # the noise of all sets is better known than that of the calibration's own
        common_deg = solution.by_method[LEAST_SQUARES].noise_deg * math.sqrt(azimuths.calibration)
    if not seconds > 0.0:
        return (math.nan,) * 3

    def time_s(noise: Floats, common: Floats) -> Floats:
        return time_to_accuracy_s(
            azimuths.noise_deg * np.sqrt(noise), seconds, limit_deg, factor=COVERAGE,
            floor_deg=np.sqrt(common * common_deg**2 + swing_deg**2),
        )  # fmt: skip

    dof, one = _noise_dof(solution, method), np.ones(1)
    known = (
        of_variances(lambda noise: time_s(noise, noise), dof)
        if azimuths.calibration
        else of_variances(time_s, dof, azimuths.common_dof)
    )
    return float(time_s(one, one)[0]), *known


def _noise_dof(solution: Solution, method: str) -> float:
    """Return the degrees of freedom of the noise of a method: of the samples, and of the amplitude that it is held to.

    Source: JCGM 100:2008, equation (G.2b); the amplitude of a signal is as uncertain as its phase in radians.
    """
    azimuths = solution.by_method[method]
    dof = min(azimuths.dof, _samples_dof(solution)) if method == LIKELIHOOD else azimuths.dof
    sets = int(np.isfinite(azimuths.azimuth_deg).sum())
    share = 1.0 / dof + 2.0 * math.radians(azimuths.noise_deg) ** 2 / sets
    return 1.0 / share if share > 0.0 else math.inf


def _samples_dof(solution: Solution) -> float:
    """Return the degrees of freedom of the mean variance of likelihood. Source: JCGM 100:2008, equation (G.2b)."""
    raw = [waveform for waveform in solution.raw if waveform is not None]
    variance = np.array([waveform.std_deg**2 for waveform in raw])
    dof = np.array([waveform.dof for waveform in raw])
    share = float(np.sum(variance**2 / dof))
    return float(np.sum(variance)) ** 2 / share if share > 0.0 else math.inf


def measured_s(solution: Solution) -> float:
    """Seconds of the records of one set, the median of all sets; NaN without records."""
    lengths = [
        sum(1e-9 * (row.window.t_end_ns - row.window.t_start_ns) for row in north_set.rows.values())
        for north_set in solution.sets
    ]
    return float(np.median([each for each in lengths if each > 0.0] or [math.nan]))


def bench_s(solution: Solution) -> float:
    """Seconds of the bench clock that one set takes, with the settling between its records; the median."""
    return float(np.median([north_set.end_s - north_set.begin_s for north_set in solution.sets]))


def scatter_over_time(solution: Solution) -> tuple[Floats, Floats]:
    """RMS error of likelihood at the known azimuths against the length of the waveform: seconds (k,), degrees (k,).

    Pieces of single records, and whole sets: nothing is used twice for one length.
    """
    sets = [
        (north_set, known)
        for north_set, known in zip(solution.sets, solution.known_deg, strict=True)
        if north_set.item == TEST
    ]
    tilts = [tilt for north_set, tilt in zip(solution.sets, solution.tilt_deg, strict=True) if north_set.item == TEST]
    by_length: dict[float, list[float]] = {}
    for (north_set, known_deg), tilt_deg in zip(sets, tilts, strict=True):
        waveform = waveform_of(north_set)
        if waveform is None:
            continue
        for seconds, phi_deg in _pieces(north_set, waveform):
            error_deg = wrapped_deg(heading_deg(phi_deg, 1) + tilt_deg - known_deg)
            by_length.setdefault(round(seconds, 2), []).append(float(error_deg))
    lengths = sorted(length for length, errors in by_length.items() if len(errors) >= _LEAST)
    rms_deg = [rms(by_length[length]) for length in lengths]
    whole = solution.error_deg(LIKELIHOOD)
    if np.isfinite(whole).sum() >= _LEAST:
        lengths, rms_deg = [*lengths, measured_s(solution)], [*rms_deg, solution.rms_deg(LIKELIHOOD)]
    return np.array(lengths), np.array(rms_deg)


def _pieces(north_set: NorthSet, waveform: Waveform) -> list[tuple[float, float]]:
    """Return length in seconds and phase in degrees of pieces of at least a turn, over all records of a set."""
    pieces: list[tuple[float, float]] = []
    for record in sorted(north_set.rows):
        u_V, theta_deg, per_turn = waveform.turns(record)
        for parts in _PARTS:
            length = len(u_V) // parts
            if length < _LEAST_TURNS * per_turn:
                break
            for begin in range(0, parts * length, length):
                own = slice(begin, begin + length)
                pieces.append((length / waveform.rate_Hz, likelihood_north(u_V[own], theta_deg[own]).phi_deg))
    return pieces
