"""North by a turning fibre-optic gyroscope: azimuths by every method, their errors at known azimuths, the verdict.

Source: FOG paper (digital north finding), equations (13) to (21), corrected as said in ``estimators``; the
convention from index to north is in ``estimators.phasors``. What is not a sample, a flag, or stated in the
sequence is not known here.

Estimates of a north finder for results.json: azimuths and their errors, accuracies, calibration, signal.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimates,
    Material,
    estimate,
    evidence_of,
    stated_limits,
    unseen_tables,
)
from bench.maths.arrays import rms
from bench.model.errors import FitError
from bench.systems.north.declaration import DECLARATION
from bench.systems.north.departures import implausible, searches_of
from bench.systems.north.estimators.phasors import IndexCalibration
from bench.systems.north.figures import error_figures, signal_figures
from bench.systems.north.report import north_notes, tables
from bench.systems.north.sets import COSINE, SENSES, SINE, TEST, north_sets
from bench.systems.north.solution import METHODS, Accuracy, Mean, Solution, accuracies
from bench.systems.north.solve import site_of, solve

_EVERY_DIRECTION_deg = 180.0  # of an interval to either side: no estimate, the table of failures says why
_MOST_SCATTER = 2.0  # of amplitudes over that of white noise, from which it is taken
AZIMUTH_ERROR, SPECIFIED_deg = "azimuth_error", 0.5


def north_estimates(solution: Solution, method: str, accuracy: list[Accuracy], limit_deg: float) -> Estimates:
    """Tests by ``method``, which is judged; searches by every method that finds a direction; what else was found."""
    estimates: Estimates = []
    for name in METHODS:
        for mean in solution.means(name):
            if name == method or (mean.item != TEST and 2.0 * mean.std_deg < _EVERY_DIRECTION_deg):
                estimates += _azimuth(mean, name, limit_deg)
    estimates += [entry for each in accuracy if each.used > 1 for entry in _of_method(each)]
    for sense, index in solution.calibrations.items():
        estimates += _calibration(index, sense, solution.placed_deg)
    return estimates + _waveform(solution)


def _azimuth(mean: Mean, method: str, limit_deg: float) -> Estimates:
    place: dict[str, Any] = {"item": mean.item, "head_deg": mean.head_deg, "method": method}
    if mean.place:
        place["place"] = mean.place
    if mean.parameters:
        place["parameters"] = mean.parameters
    counted: dict[str, Any] = {"n": mean.n, "dropped": mean.dropped, "dof": mean.dof}
    estimates = [estimate("azimuth", "deg", mean.azimuth_deg % 360.0, mean.std_deg, place, **counted)]
    if mean.item == TEST:
        estimates.append(
            estimate("azimuth_error", "deg", mean.error_deg, mean.error_std_deg, place, limit=limit_deg, **counted)
        )
    return estimates


def _of_method(errors: Accuracy) -> Estimates:
    place, n = {"method": errors.method}, errors.used
    estimates = [estimate("azimuth_rms_error", "deg", errors.rms_deg, errors.rms_std_deg, place, n=n)]
    if not math.isfinite(errors.time_within_s):
        return estimates
    law: dict[str, Any] = {}
    if errors.time_std_s > 0.0:  # JCGM 100:2008, (G.3): an uncertainty in proportion to the value is as uncertain as it
        law["dof"] = 0.5 * (errors.time_s / errors.time_std_s) ** 2
        law["factor"] = errors.time_within_s / errors.time_std_s
    return [*estimates, estimate("time_to_accuracy", "s", errors.time_s, errors.time_std_s, place, n=n, **law)]


def _calibration(index: IndexCalibration, sense: int, placed_deg: float) -> Estimates:
    """Index B (lock-in 1) and A (lock-in 2): placement by table angle; gain as amplitude of the signal, volt.

    ``placed_deg``: what makes both placements uncertain beside the noise of the calibration.
    """
    std = np.sqrt(np.diag(index.covariance))
    estimates: Estimates = []
    for number, (role, letter, gain, at_deg) in enumerate(
        ((SINE, "b", index.f1, index.f2_deg), (COSINE, "a", index.f4, index.f5_deg))
    ):
        about: dict[str, Any] = {"index": letter, "rotation": SENSES[sense]}
        gain_std, deg_std = float(std[2 * number]), math.hypot(std[2 * number + 1], placed_deg)
        estimates.append(
            estimate("index_placement", "deg", sense * at_deg, deg_std, about, n=index.sets, dof=index.dof)
        )
        about = {"source": role, "rotation": SENSES[sense]}
        both = math.sqrt(2.0) * gain, math.sqrt(2.0) * gain_std
        estimates.append(estimate("scale", "V", *both, about, n=index.sets, dof=index.dof))
    return estimates


def _waveform(solution: Solution) -> Estimates:
    """Amplitude, noise per sample and bound by the raw samples, over all sets."""
    raw = [waveform for waveform in solution.raw if waveform is not None]
    if not raw:
        return []
    amplitude = np.array([waveform.amplitude for waveform in raw])
    noise = np.array([waveform.noise_V for waveform in raw])
    samples = sum(waveform.samples for waveform in raw)
    bound_std = math.sqrt(0.5 + 2.0 * float(np.mean((noise / amplitude) ** 2))) / math.sqrt(samples)
    bound_deg = float(np.sqrt(np.nanmean(solution.bound_deg**2)))
    noise_V, about = rms(noise), {"source": "waveform"}
    scale_std_V = noise_V * math.sqrt(2.0 / samples)
    if len(raw) > 1:  # an amplitude that changes from set to set is known no better than it scatters
        scatter_V = float(np.std(amplitude, ddof=1)) / math.sqrt(len(raw))
        scale_std_V = scatter_V if scatter_V > _MOST_SCATTER * scale_std_V else scale_std_V
    return [
        estimate("scale", "V", float(np.mean(amplitude)), scale_std_V, about, n=samples),
        estimate("noise", "V", noise_V, noise_V / math.sqrt(2.0 * samples), about, n=samples),
        estimate("azimuth_bound", "deg", bound_deg, bound_deg * bound_std, about, n=samples),
    ]


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Azimuths by all methods; ``method`` says which one is judged against the limit ``azimuth_error``.

    Raises: FitError B-FOG-001 (limit), -002 (no readings), -003 (site), -004 (no set can be
            used), -005 (the method has nothing to work on).
    """
    limit_deg = azimuth_error_limit_deg(material.campaign)
    solution = solve(north_sets(material), site_of(material.campaign))
    if not np.isfinite(solution.by_method[method].azimuth_deg).any():
        raise FitError(
            "B-FOG-005",
            f"no set has what the method {method!r} needs: {'; '.join(solution.missing[:3])}",
            next_step="give the records 'samples: true' for likelihood, read both lock-ins for the other methods",
        )
    accuracy = accuracies(solution, limit_deg)
    estimates = north_estimates(solution, method, accuracy, limit_deg)
    searches = list(searches_of(solution, estimates))
    return Analysis(
        "fog_north",
        method,
        material.campaign["uut"],
        estimates,
        evidence=[*implausible(solution), *evidence_of(searches)],
        notes=north_notes(solution, method, accuracy),
        missing=solution.missing,
        figures=[*signal_figures(solution), *error_figures(solution, method, limit_deg)],
        tables=[*tables(solution, method, accuracy, limit_deg), *unseen_tables(searches)],
    )


def azimuth_error_limit_deg(campaign: Document) -> float:
    """Return the largest azimuth error allowed, degrees.

    Raises: FitError B-FOG-001 for a limit of the sequence that is not one of a north finder, in a wrong unit or not
            above zero.
    """
    declared = DECLARATION.analysis("fog_north")
    stated = stated_limits(campaign, declared.limits, "B-FOG-001", "a north finder has no such limit")
    return stated.get(AZIMUTH_ERROR, SPECIFIED_deg)
