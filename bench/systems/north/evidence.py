"""What the data of a north finder say against its model: repeats, known azimuths, two methods and the amplitude.

White noise of known size, one calibration and one direction of north is all that the intervals know. So repeats must
scatter as their noise, errors at known azimuths must be those of noise about one common error, which the calibration
explains, both lock-ins and the waveform must tell the same, and the signal must be as large at every place.
Source: docs/decisions/0025-doubt.md; F tests of linear models, the union bound for the rivals and for the splits.

What the raw waveforms of a north finder say: noise of every place, amplitude of every place, rate of the table.

What could be true instead of one error that all known azimuths share: a short fixed list, fitted beside it.

A drift and one step in time (a bench that moves), a wave once per turn of the dividing head (tilt, a magnet on the
bench) and twice (unlike gains, an amplitude that goes with twice the angle of the table). The probability of each is
multiplied by the length of the list, that of the step by its places too.
Source: docs/decisions/0025-doubt.md; F test of nested linear models.

Azimuths of one method set by set, against their repeats and against the stated azimuths, with what is due.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Estimates, Evidence, Floats
from bench.maths.arrays import Integers
from bench.maths.tests import best_step, f_tail, of_many, t_both
from bench.systems.north.estimators.likelihood import LikelihoodNorth
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import CALIBRATION, SEARCH, TEST, NorthSet
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, LITERAL, QUADRANT, Solution
from bench.systems.north.wording import item_name, method_name, say

_FEWEST = 4
_MOST_RATE = 0.05  # of the stated rate; a serial line hands samples over in blocks
_OF_RATE = ("azimuth", "azimuth_error", "azimuth_rms_error", "index_placement")
_OF_NOISE = ("azimuth", "azimuth_error", "noise", "azimuth_bound")

Pairs = list[tuple[NorthSet, LikelihoodNorth]]
OF_ALL = ("index_placement", "scale", "azimuth_bound")  # what hangs on the azimuths as well
_LIST = 4
_FEWEST_TO_STEP = 4
_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")
_BY_LOCK_INS = (LEAST_SQUARES, QUADRANT, LITERAL)
_NO_SIGNAL_deg = 20.0  # of one set: a direction is lost in its noise
_FEWEST_DIFFERENCES = 4


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
            chance = f_tail(here / rest, dof[own].sum(), dof[~own].sum())
            pooled = math.sqrt(here / float(np.average(variance, weights=dof)))
            worst = min(worst, (chance, pooled, place))
    chance, pooled, (item, place_name, head_deg, parameters) = worst
    sentence = say("evidence.noise_changes", item=item_name(item), head=head_deg, ratio=pooled)
    about = {"item": item, "head_deg": head_deg} | ({"place": place_name} if place_name else {})
    about |= {"parameters": parameters} if parameters else {}
    probability = of_many(chance, len(places))
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
        for method in _BY_LOCK_INS:
            yield Evidence(
                "rate_not_as_stated", sentence, turned, 0.0, quantities=_OF_RATE, conditions={"method": method},
                refuses=turned * own.rate_deg_s < 0.0,
            )  # fmt: skip
        return


def rivals(method: str, errors: Errors) -> Iterator[Evidence]:
    """Yield each rival that the known azimuths can tell from a common error; moves in degrees."""
    time = errors.times_s - errors.times_s.mean() if len(errors.times_s) else errors.times_s
    turned = np.deg2rad(errors.heads_deg)
    for code, columns in (
        ("north_drifts", time[:, None]),
        ("once_per_turn", np.column_stack((np.cos(turned), np.sin(turned)))),
        ("twice_per_turn", np.column_stack((np.cos(2.0 * turned), np.sin(2.0 * turned)))),
    ):
        if len(time) < columns.shape[1] + 2:
            continue
        gain, size_deg, rank = _gain(errors, columns)
        if rank == columns.shape[1]:
            ratio, probability = f_test(gain, rank, 1.0, errors.noise_dof)
            yield _rival(code, size_deg, probability, ratio, method=method_name(method))
    if len(time) >= _FEWEST_TO_STEP:
        order = np.argsort(errors.times_s)
        step_deg, gain, where = best_step(errors.mean_deg[order], errors.weights[order])
        ratio, probability = f_test(gain, 1, 1.0, errors.noise_dof)
        head_deg = errors.heads_deg[order][where]
        chance = probability * (len(time) - 1)
        yield _rival("north_steps", abs(step_deg), chance, ratio, method=method_name(method), head=head_deg)


def _rival(code: str, size_deg: float, probability: float, ratio: float, **values: object) -> Evidence:
    sentence = say(f"rival.{code}", **values, size=size_deg, ratio=math.sqrt(ratio))
    return Evidence(code, sentence, size_deg, min(1.0, probability * _LIST), size_deg, OF_ALL)


def _gain(errors: Errors, columns: Floats) -> tuple[float, float, int]:
    """Return what columns beside the mean take off chi-square, the change they make in deg, their rank."""
    root = np.sqrt(errors.weights)
    centred = columns - np.average(columns, axis=0, weights=errors.weights)
    _, left = errors.common_error()
    values, _, rank, _ = np.linalg.lstsq(centred * root[:, None], left * root, rcond=1e-9)
    fitted_deg = centred @ values
    return float(np.sum(errors.weights * fitted_deg**2)), float(np.ptp(fitted_deg)), int(rank)


def evidence(solution: Solution, entries: Estimates) -> list[Evidence]:
    """Return what every check says, those that found nothing included."""
    widths_deg = _widths_deg(entries)
    heard: list[Evidence] = []
    for judged, touched in ((LEAST_SQUARES, _BY_LOCK_INS), (LIKELIHOOD, (LIKELIHOOD,))):
        errors = errors_of(solution, judged)
        if errors is None:
            continue
        seen = [*_signal(judged, errors), *_repeats(judged, errors), *_known(judged, errors), *rivals(judged, errors)]
        heard += _for_each(seen, touched, widths_deg)
    heard += _for_each(_two_methods(solution), (*_BY_LOCK_INS, LIKELIHOOD), widths_deg)
    return [*heard, *raw_evidence(solution, widths_deg)]


def _widths_deg(entries: Estimates) -> dict[str, float]:
    """Return the smallest expanded uncertainty of an azimuth by each method that states one, degrees."""
    widths: dict[str, float] = {}
    for entry in entries:
        if entry.quantity == "azimuth":
            method = str(entry.conditions["method"])
            widths[method] = min(widths.get(method, math.inf), float(entry.expanded_uncertainty))
    return widths


def _for_each(seen: Iterable[Evidence], methods: Iterable[str], widths_deg: Mapping[str, float]) -> Iterator[Evidence]:
    """Yield each check for each method that rests on the same readings; moves come in degrees and leave in U."""
    checks = list(seen)
    for method in methods:
        if method in widths_deg:
            width_deg = widths_deg[method] or 1e-9
            for check in checks:
                yield Evidence(
                    check.code, check.sentence, check.figure, check.probability, check.move / width_deg,
                    (*_AZIMUTHS, *check.quantities), {**check.conditions, "method": method}, check.refuses,
                )  # fmt: skip


def _signal(method: str, errors: Errors) -> Iterator[Evidence]:
    if errors.noise_deg > _NO_SIGNAL_deg:
        sentence = say("evidence.no_signal", method=method_name(method), noise=errors.noise_deg, limit=_NO_SIGNAL_deg)
        yield Evidence("no_signal", sentence, errors.noise_deg, 0.0, refuses=True)


def _repeats(method: str, errors: Errors) -> Iterator[Evidence]:
    """Yield the scatter of repeats against the noise that the intervals are made of."""
    squares, dof = errors.within()
    if not dof:
        return
    due = errors.noise_deg**2 + errors.start_deg**2
    ratio, probability = f_test(squares, dof, due, errors.noise_dof)
    beyond_deg = math.sqrt(max(0.0, squares / dof - due))
    sentence = say(
        "evidence.repeats_apart", method=method_name(method), scatter=math.sqrt(squares / dof), noise=math.sqrt(due)
    )
    yield Evidence("repeats_apart", sentence, math.sqrt(ratio), probability, beyond_deg / math.sqrt(errors.most))


def _known(method: str, errors: Errors) -> Iterator[Evidence]:
    """Yield the errors at the known azimuths about their mean, and their mean."""
    if not len(errors.heads_deg):
        return
    mean_deg, left = errors.common_error()
    dof = len(errors.heads_deg) - 1
    if dof:
        ratio, probability = f_test(float(np.sum(left**2 * errors.weights)), dof, 1.0, errors.noise_dof)
        beyond_deg = math.sqrt(max(0.0, float(np.mean(left**2)) - dof / float(np.sum(errors.weights))))
        most_deg = float(np.abs(left).max())
        sentence = say(
            "evidence.known_azimuths_apart", method=method_name(method), ratio=math.sqrt(ratio), most=most_deg
        )
        yield Evidence("known_azimuths_apart", sentence, math.sqrt(ratio), probability, beyond_deg, OF_ALL)
    due_deg = errors.common_std_deg()
    score, probability = t_test(mean_deg, due_deg, errors.common_dof)
    sentence = say("evidence.all_azimuths_off", method=method_name(method), mean=mean_deg, due=due_deg)
    yield Evidence("all_azimuths_off", sentence, score, probability, abs(mean_deg), OF_ALL)


def _two_methods(solution: Solution) -> Iterator[Evidence]:
    """Yield the mean of what least squares finds beside likelihood, and whether it changes in time."""
    by_samples, by_waveform = solution.by_method[LEAST_SQUARES], solution.by_method[LIKELIHOOD]
    apart_deg = wrapped_deg(by_samples.azimuth_deg - by_waveform.azimuth_deg)
    seen = np.isfinite(apart_deg) & ~solution.of(CALIBRATION)
    apart_deg = apart_deg[seen]
    if not apart_deg.size:
        return
    noise_deg = math.hypot(by_samples.noise_deg, by_waveform.noise_deg, math.sqrt(2.0) * solution.swing_deg, LEAST_deg)
    mean_deg = float(np.mean(apart_deg))
    due_deg = math.hypot(noise_deg / math.sqrt(apart_deg.size), by_samples.common_deg, solution.placed_deg)
    score, probability = t_test(mean_deg, due_deg, min(by_samples.dof, by_samples.common_dof))
    sentence = say("evidence.methods_apart", one=LEAST_SQUARES, mean=mean_deg, other=LIKELIHOOD, due=due_deg)
    yield Evidence("methods_apart", sentence, score, probability, abs(mean_deg), ("index_placement",))
    if apart_deg.size >= _FEWEST_DIFFERENCES:
        yield _methods_step(apart_deg, math.hypot(math.sqrt(2.0) * solution.swing_deg, LEAST_deg))


def _methods_step(apart_deg: Floats, start_deg: float) -> Evidence:
    """Hold the step against the scatter of the differences themselves: both methods have most of their noise alike."""
    step_deg, gain, where = best_step(apart_deg, np.ones(apart_deg.size))
    dof = apart_deg.size - 2.0
    rest = max(0.0, float(np.var(apart_deg)) * apart_deg.size - gain) / dof + start_deg**2
    probability = of_many(f_tail(gain / rest, 1, dof), apart_deg.size - 1)
    sentence = say(
        "evidence.methods_step",
        first=where + 1,
        count=apart_deg.size,
        one=LEAST_SQUARES,
        step=step_deg,
        other=LIKELIHOOD,
    )
    return Evidence("methods_step", sentence, abs(step_deg), probability, abs(step_deg))


LEAST_deg = 1e-3  # steps of level and lock-ins


@dataclass(frozen=True)
class Errors:
    """What one method found, degrees.

    ``about_deg``, ``group``: (n,) every azimuth about the mean of its repeats, and which mean.   ``heads_deg``,
    ``times_s``, ``mean_deg``, ``weights``: (h,) the known azimuths: head, middle of the time, mean error, 1/variance.
    ``noise_deg``: of one set, with ``noise_dof``.   ``start_deg``: what changes at each start of the table.
    ``shared_deg``: what all have in common, ``common_dof`` its degrees of freedom.   ``most``: repeats of a group.
    """

    about_deg: Floats
    group: Integers
    heads_deg: Floats
    times_s: Floats
    mean_deg: Floats
    weights: Floats
    noise_deg: float
    noise_dof: float
    start_deg: float
    shared_deg: float
    common_dof: float
    most: int

    def within(self) -> tuple[float, int]:
        """Return the sum of squares of all repeats about their means, and its degrees of freedom."""
        return float(np.sum(self.about_deg**2)), len(self.about_deg) - len(np.unique(self.group))

    def common_error(self) -> tuple[float, Floats]:
        """Return the weighted mean of the errors at the known azimuths, and what is left, (h,)."""
        mean_deg = float(np.sum(self.weights * self.mean_deg) / np.sum(self.weights))
        return mean_deg, self.mean_deg - mean_deg

    def common_std_deg(self) -> float:
        """Return the standard uncertainty of the common error."""
        return math.hypot(1.0 / math.sqrt(float(np.sum(self.weights))), self.shared_deg)


def errors_of(solution: Solution, method: str) -> Errors | None:
    """Return what a method found; None if it found nothing."""
    azimuths = solution.by_method[method]
    found = np.isfinite(azimuths.azimuth_deg)
    if not found.any():
        return None
    names = list(dict.fromkeys(north_set.group for north_set in solution.sets))
    group = np.array([names.index(north_set.group) for north_set in solution.sets])
    swing_deg = 0.0 if method == LIKELIHOOD else math.sqrt(2.0) * solution.swing_deg
    about_deg, rows = np.zeros(len(group)), []
    for k, (item, _, head_deg, _) in enumerate(names):
        own = found & (group == k)
        if not own.any():
            continue
        first_deg = float(azimuths.azimuth_deg[own][0])
        beside_deg = wrapped_deg(azimuths.azimuth_deg[own] - first_deg)
        about_deg[own] = beside_deg - beside_deg.mean()
        if item == TEST:
            known_deg = float(solution.known_deg[own][0])
            times_s = [(each.begin_s + each.end_s) / 2.0 for each, use in zip(solution.sets, own, strict=True) if use]
            variance = azimuths.noise_deg**2 / own.sum() + swing_deg**2 + solution.tilted_deg**2 + LEAST_deg**2
            error_deg = float(wrapped_deg(first_deg + beside_deg.mean() - known_deg))
            rows.append((head_deg, float(np.mean(times_s)), error_deg, 1.0 / variance))
    heads_deg, middles_s, mean_deg, weights = np.array(rows, np.float64).reshape(-1, 4).T
    calibrated = method != LIKELIHOOD and bool(solution.calibrations)
    beside = (0.0 if calibrated else solution.site.azimuth_std_deg, solution.tilted_deg, swing_deg)
    return Errors(
        about_deg[found], group[found], heads_deg, middles_s, mean_deg, weights, azimuths.noise_deg,
        azimuths.dof, math.hypot(swing_deg, LEAST_deg), math.hypot(azimuths.common_deg, *beside),
        min(azimuths.dof, azimuths.common_dof), int(np.bincount(group[found]).max()),
    )  # fmt: skip


def f_test(squares: float, dof: int, variance: float, of_dof: float) -> tuple[float, float]:
    """Return a mean square over a variance that is known with ``of_dof``, and the chance of more in a right world."""
    ratio = squares / dof / variance if variance > 0.0 else 0.0
    return ratio, f_tail(ratio, dof, of_dof)


def t_test(value: float, std: float, dof: float) -> tuple[float, float]:
    """Return a value over its standard uncertainty, and the chance of more on either side."""
    score = abs(value) / std if std > 0.0 else 0.0
    return score, t_both(score, dof)
