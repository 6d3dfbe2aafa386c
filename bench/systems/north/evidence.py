"""What the data of a north finder say against its model: repeats, known azimuths, two methods and the amplitude.

White noise of known size, one calibration and one direction of north is all that the intervals know. So repeats must
scatter as their noise, errors at known azimuths must be those of noise about one common error, which the calibration
explains, both lock-ins and the waveform must tell the same, and the signal must be as large at every place.
Source: docs/decisions/0025-doubt.md; F tests of linear models, the union bound for the rivals and for the splits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from scipy import special

from bench.analysis import Estimates, Evidence, Floats
from bench.systems.north.errors_at_known import Errors, LEAST_deg, errors_of, f_test, t_test
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.raw_evidence import raw_evidence
from bench.systems.north.rivals import OF_ALL, best_step, rivals
from bench.systems.north.sets import CALIBRATION
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, LITERAL, QUADRANT, Solution
from bench.systems.north.wording import method_name, say

_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")
_BY_LOCK_INS = (LEAST_SQUARES, QUADRANT, LITERAL)
_NO_SIGNAL_deg = 20.0  # of one set: a direction is lost in its noise
_FEWEST_DIFFERENCES = 4


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
        if entry["quantity"] == "azimuth":
            method = str(entry["conditions"]["method"])
            widths[method] = min(widths.get(method, math.inf), float(entry["expanded_uncertainty"]))
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
    apart_deg = np.asarray(wrapped_deg(by_samples.azimuth_deg - by_waveform.azimuth_deg))
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
    probability = float(special.fdtrc(1.0, dof, gain / rest)) * (apart_deg.size - 1)
    sentence = say(
        "evidence.methods_step",
        first=where + 1,
        count=apart_deg.size,
        one=LEAST_SQUARES,
        step=step_deg,
        other=LIKELIHOOD,
    )
    return Evidence("methods_step", sentence, abs(step_deg), _chance(probability), abs(step_deg))


def _chance(probability: float) -> float:
    return min(1.0, max(probability, 1e-300))
