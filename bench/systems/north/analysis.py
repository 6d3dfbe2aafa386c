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
    Figure,
    Floats,
    Material,
    Series,
    band,
    estimate,
    evidence_of,
    series,
    stated_limits,
    unseen_tables,
    worded_figure,
)
from bench.maths.arrays import rms
from bench.model.errors import FitError
from bench.systems.north.declaration import DECLARATION
from bench.systems.north.departures import implausible, searches_of
from bench.systems.north.estimators.phasors import POSITIONS, IndexCalibration, heading_deg, phase_deg, wrapped_deg
from bench.systems.north.report import north_notes, tables
from bench.systems.north.sets import COSINE, SENSES, SINE, TEST, Waveform, north_sets, waveform_of
from bench.systems.north.solution import (
    COVERAGE,
    LEAST_SQUARES,
    LIKELIHOOD,
    LITERAL,
    METHODS,
    Accuracy,
    Mean,
    Solution,
    accuracies,
    measured_s,
    scatter_over_time,
)
from bench.systems.north.solve import site_of, solve
from bench.systems.north.wording import method_name, say

_BINS = 72  # of a turn, 5 degrees each
_TURN_deg = np.linspace(0.0, 360.0, 181)
_GROUP = "earth signal and lock-ins"
_FEWEST = 4  # errors of a histogram


def signal_figures(solution: Solution) -> list[Figure]:
    """Return all that the records allow."""
    kinds = solution.kinds  # side by side, as in figure 5 of the paper
    signals = [figure for kind in kinds for figure in _earth_signal(solution, kind)]
    read = [figure for number in (1, 2) for kind in kinds for figure in _lock_in(solution, number, kind)]
    return [*signals, *read, *_phasors(solution), *_residual(solution)]


def _folded(angle_deg: Floats, value: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Middle of each bin of a turn; mean, scatter and number of what falls into it."""
    place = np.floor(np.remainder(angle_deg, 360.0) / (360.0 / _BINS)).astype(np.int64) % _BINS
    count = np.bincount(place, minlength=_BINS)
    seen = count > 0
    mean = np.asarray(np.bincount(place, value, _BINS)[seen] / count[seen], np.float64)
    square = np.asarray(np.bincount(place, value**2, _BINS)[seen] / count[seen], np.float64)
    scatter = np.asarray(np.sqrt(np.maximum(square - mean**2, 0.0)), np.float64)
    at_deg = ((np.arange(_BINS, dtype=np.float64) + 0.5) * (360.0 / _BINS))[seen]
    return at_deg, mean, scatter, np.asarray(count[seen], np.float64)


def _first(solution: Solution, kind: str) -> tuple[int, Waveform] | None:
    """Waveform of the first test with parameters of this kind, else of the first set that has one."""
    for k in sorted(range(len(solution.sets)), key=lambda k: (solution.sets[k].item != TEST, k)):
        if solution.sets[k].parameters != kind:
            continue
        waveform = waveform_of(solution.sets[k])
        if waveform is not None:
            return k, waveform
    return None


def _with(title: str, kind: str) -> str:
    return say("figure.with", title=title, kind=kind) if kind else title


def _earth_signal(solution: Solution, kind: str) -> list[Figure]:
    first = _first(solution, kind)
    if first is None:
        return []
    k, waveform = first
    fit, azimuth_deg = solution.raw[k], solution.by_method[LIKELIHOOD].azimuth_deg[k] - solution.tilt_deg[k]
    at_deg, mean_V, scatter_V, _ = _folded(azimuth_deg - waveform.theta_deg, waveform.u_V)
    parts = [series(say("signal.mean"), at_deg, mean_V, "points")]
    if fit is not None:
        curve_V = fit.offset_V + fit.amplitude * np.cos(np.deg2rad(_TURN_deg))
        parts.append(series(say("signal.fit"), _TURN_deg, curve_V, "line"))
    parts.append(band(say("signal.scatter"), at_deg, mean_V - scatter_V, mean_V + scatter_V))
    caption = say("signal.caption", seconds=waveform.seconds, name=solution.sets[k].name)
    title = _with(say("signal.title"), kind)
    return [Figure(title, caption, say("axis.heading"), say("axis.output"), parts, group=_GROUP)]


def _lock_in(solution: Solution, number: int, kind: str) -> list[Figure]:
    """X against azimuth; a later index position stands for an azimuth that differs by 90 degrees."""
    letter, readings = ("B", solution.u1_V) if number == 1 else ("A", solution.u2_V)
    parts: list[Series] = []
    for sense in (1, -1):
        use = solution.good & (solution.sense == sense)
        if kind:
            use &= solution.with_parameters(kind)
        if use.any():
            azimuth_deg = (solution.by_method[LEAST_SQUARES].azimuth_deg - solution.tilt_deg)[use]
            phi_deg = phase_deg(azimuth_deg, sense)[:, None] + 90.0 * np.arange(POSITIONS)
            at_deg = np.remainder(heading_deg(phi_deg, sense), 360.0)
            parts.append(series(say("lock_in.read"), at_deg.ravel(), readings[use].ravel(), "points"))
        if use.any() and sense in solution.calibrations:
            curve_V = _curve_V(solution.calibrations[sense], number, phase_deg(_TURN_deg, sense))
            parts.append(series(say("lock_in.calibration"), _TURN_deg, curve_V, "line"))
    title = _with(say("lock_in.title", number=number, letter=letter), kind)
    labels = say("axis.azimuth"), say("axis.x")
    return [Figure(title, say("lock_in.caption"), *labels, parts, group=_GROUP)] if parts else []


def _curve_V(index: IndexCalibration, number: int, phi_deg: Floats) -> Floats:
    if number == 1:
        return index.f1 * np.sin(np.deg2rad(phi_deg + index.f2_deg)) + index.f3
    return index.f4 * np.cos(np.deg2rad(phi_deg + index.f5_deg)) + index.f6


def _phasors(solution: Solution) -> list[Figure]:
    """Return every simultaneous pair turned back by its index position: the four of one heading fall together."""
    use = solution.good & solution.of(TEST)
    if not use.any():
        return []
    u1_V = solution.u1_V[use] - solution.u1_V[use].mean(axis=1, keepdims=True)
    u2_V = solution.u2_V[use] - solution.u2_V[use].mean(axis=1, keepdims=True)
    z_V = (u2_V + 1j * u1_V) * (-1j) ** np.arange(POSITIONS)
    parts = [
        series(say("phasors.position", k=k + 1), z_V[:, k].real, z_V[:, k].imag, "points") for k in range(POSITIONS)
    ]
    mean_V = z_V.mean(axis=1)
    parts.append(series(say("phasors.mean"), mean_V.real, mean_V.imag, "points"))
    return [worded_figure(say, "phasors", ("axis.cosine", "axis.sine"), parts, equal=True)]


def _residual(solution: Solution) -> list[Figure]:
    """Return what the fundamental leaves of all waveforms, against the table angle."""
    angle_deg, left_V = [], []
    for north_set, fit in zip(solution.sets, solution.raw, strict=True):
        waveform = waveform_of(north_set)
        if waveform is not None and fit is not None:
            turn = np.deg2rad(waveform.theta_deg + fit.phi_deg)
            beside_V = waveform.u_V - fit.offset_V - fit.amplitude * np.sin(turn)
            kept = np.isfinite(beside_V)
            left_V.append(beside_V[kept])
            angle_deg.append(waveform.theta_deg[kept])
    if not left_V:
        return []
    at_deg, mean_V, scatter_V, count = _folded(np.concatenate(angle_deg), np.concatenate(left_V))
    reach_V = 1.96 * scatter_V / np.sqrt(count)
    parts = [series(say("signal.mean"), at_deg, 1e3 * mean_V, "points")]
    parts.append(band(say("residual.noise"), at_deg, -1e3 * reach_V, 1e3 * reach_V))
    return [worded_figure(say, "residual", ("axis.table_angle", "axis.residual"), parts, count=len(left_V))]


def error_figures(solution: Solution, method: str, limit_deg: float) -> list[Figure]:
    """Return all that the tests allow; nothing without a test at a known azimuth."""
    drawn = [figure for kind in solution.kinds for figure in _against_azimuth(solution, kind)]
    return [*drawn, *_histogram(solution, method), *_against_time(solution, method, limit_deg)]


def _against_azimuth(solution: Solution, kind: str) -> list[Figure]:
    at_deg = np.remainder(solution.known_deg, 360.0)
    bound_deg = solution.bound_deg[np.isfinite(solution.bound_deg)]
    points = {}
    for method in METHODS:
        error_deg = solution.error_deg(method)
        seen = np.isfinite(error_deg) & solution.with_parameters(kind)
        if seen.any():
            points[method] = series(method_name(method), at_deg[seen], error_deg[seen], "points")
    if not points:
        return []
    literal = points.pop(LITERAL, None)
    parts = list(points.values())
    if bound_deg.size:
        reach_deg = COVERAGE * rms(bound_deg)
        parts.append(band(say("against.bound"), [0.0, 360.0], [-reach_deg] * 2, [reach_deg] * 2))
    labels = say("axis.azimuth"), say("axis.azimuth_error")
    group = "errors" if kind else ""  # side by side, as in figure 6 of the paper
    title = _with(say("against.title"), kind)
    drawn = [Figure(title, say("against.caption"), *labels, parts, group=group)] if points else []
    if literal is not None:
        title, caption = _with(say("against.literal_title"), kind), say("against.literal_caption")
        drawn.append(Figure(title, caption, *labels, [literal], group=f"literal {group}" if kind else ""))
    return drawn


def _histogram(solution: Solution, method: str) -> list[Figure]:
    parts = []
    for name in dict.fromkeys((method, LIKELIHOOD)):
        error_deg = solution.error_deg(name)
        seen = error_deg[np.isfinite(error_deg)]
        if seen.size >= _FEWEST:
            parts.append(_steps(method_name(name), seen))
    return [worded_figure(say, "histogram", ("axis.azimuth_error", "axis.sets"), parts)] if parts else []


def _steps(name: str, error_deg: Floats) -> Series:
    """Return the outline of a histogram."""
    reach = max(float(np.max(np.abs(error_deg))), 1e-6)
    bins = min(40, max(6, 2 * math.ceil(math.sqrt(error_deg.size))))
    count, edges = np.histogram(error_deg, bins=bins, range=(-reach, reach))
    x = np.repeat(edges, 2)
    y = np.concatenate([[0.0], np.repeat(count, 2).astype(np.float64), [0.0]])
    return series(name, x, y, "line")


def _against_time(solution: Solution, method: str, limit_deg: float) -> list[Figure]:
    """Measured errors against measuring time, and what 1/sqrt(T) makes of the bound."""
    parts: list[Series] = []
    lengths_s, rms_deg = scatter_over_time(solution)
    if lengths_s.size:
        parts.append(series(method_name(LIKELIHOOD), lengths_s, rms_deg, "points"))
    if method != LIKELIHOOD:
        times_s, means_deg = _repeats(solution, method)
        if times_s.size:
            parts.append(series(method_name(method), times_s, means_deg, "points"))
    if not parts:
        return []
    shortest_s = min(min(part.x) for part in parts)
    longest_s = max(max(part.x) for part in parts)
    line_s = np.geomspace(shortest_s, longest_s if longest_s > shortest_s else 2.0 * shortest_s, 20)
    bound_deg = solution.bound_deg[np.isfinite(solution.bound_deg)]
    if bound_deg.size:
        bound = rms(bound_deg)
        parts.append(series(say("over_time.bound"), line_s, bound * np.sqrt(measured_s(solution) / line_s), "line"))
    parts.append(series(say("over_time.limit"), line_s, np.full(line_s.shape, limit_deg / COVERAGE), "line"))
    axes, name = ("axis.measuring_time", "axis.rms_error"), method_name(LIKELIHOOD)
    return [worded_figure(say, "over_time", axes, parts, logarithmic="xy", method=name)]


def _repeats(solution: Solution, method: str) -> tuple[Floats, Floats]:
    """RMS error of the phasor mean of the first m repeats of each heading, m = 1, 2, 4, ... as far as all have them."""
    azimuth_deg = solution.by_method[method].azimuth_deg
    groups: dict[tuple[str, str, float, str], list[complex]] = {}
    known: dict[tuple[str, str, float, str], float] = {}
    for north_set, at, due in zip(solution.sets, azimuth_deg, solution.known_deg, strict=True):
        if north_set.item == TEST and math.isfinite(at):
            groups.setdefault(north_set.group, []).append(complex(np.exp(1j * np.deg2rad(at))))
            known[north_set.group] = due
    most = min((len(phasors) for phasors in groups.values()), default=0)
    counts = [2**power for power in range(most.bit_length())] if most else []
    rms_deg = []
    for count in counts:
        means = {group: np.rad2deg(np.angle(np.mean(phasors[:count]))) for group, phasors in groups.items()}
        errors = [float(wrapped_deg(mean - known[group])) for group, mean in means.items()]
        rms_deg.append(rms(errors))
    return measured_s(solution) * np.array(counts, np.float64), np.array(rms_deg)


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
