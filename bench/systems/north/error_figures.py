"""Figures of the errors of a north finder: against azimuth (paper figure 6), as a histogram, against measuring time."""

from __future__ import annotations

import math

import numpy as np

from bench.analysis import Figure, Floats, Series, band, series
from bench.systems.north.accuracy import COVERAGE, measured_s, scatter_over_time
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import TEST
from bench.systems.north.solution import LIKELIHOOD, LITERAL, METHODS, Solution

_FEWEST = 4  # errors of a histogram


def error_figures(solution: Solution, method: str, limit_deg: float) -> list[Figure]:
    """Return all that the tests allow; nothing without a test at a known azimuth."""
    return [*_against_azimuth(solution), *_histogram(solution, method), *_against_time(solution, method, limit_deg)]


def _against_azimuth(solution: Solution) -> list[Figure]:
    at_deg = np.remainder(solution.known_deg, 360.0)
    bound_deg = solution.bound_deg[np.isfinite(solution.bound_deg)]
    points = {}
    for method in METHODS:
        error_deg = solution.error_deg(method)
        seen = np.isfinite(error_deg)
        if seen.any():
            points[method] = series(method, at_deg[seen], error_deg[seen], "points")
    if not points:
        return []
    literal = points.pop(LITERAL, None)
    parts = list(points.values())
    caption = "Error of each set against its stated azimuth, folded into one turn; Cramer-Rao bound."
    if bound_deg.size:
        reach_deg = COVERAGE * float(np.sqrt(np.mean(bound_deg**2)))
        parts.append(band("95 % at the bound", [0.0, 360.0], [-reach_deg] * 2, [reach_deg] * 2))
    labels = "azimuth, deg", "azimuth error, deg"
    drawn = [Figure("Errors", caption, *labels, parts)] if points else []
    if literal is not None:
        caption = "The paper's formulas as printed: errors of half a turn where an arctangent has left its branch."
        drawn.append(Figure("Error of the literal formulas", caption, *labels, [literal]))
    return drawn


def _histogram(solution: Solution, method: str) -> list[Figure]:
    parts = []
    for name in dict.fromkeys((method, LIKELIHOOD)):
        error_deg = solution.error_deg(name)
        seen = error_deg[np.isfinite(error_deg)]
        if seen.size >= _FEWEST:
            parts.append(_steps(name, seen))
    caption = "Number of sets by error; the whole range is drawn, folded into one turn."
    return [Figure("Histogram of the errors", caption, "azimuth error, deg", "sets", parts)] if parts else []


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
        parts.append(series(LIKELIHOOD, lengths_s, rms_deg, "points"))
    if method != LIKELIHOOD:
        times_s, means_deg = _repeats(solution, method)
        if times_s.size:
            parts.append(series(method, times_s, means_deg, "points"))
    if not parts:
        return []
    shortest_s = min(min(part.x) for part in parts)
    longest_s = max(max(part.x) for part in parts)
    line_s = np.geomspace(shortest_s, longest_s if longest_s > shortest_s else 2.0 * shortest_s, 20)
    bound_deg = solution.bound_deg[np.isfinite(solution.bound_deg)]
    if bound_deg.size:
        bound = float(np.sqrt(np.mean(bound_deg**2)))
        parts.append(series("bound", line_s, bound * np.sqrt(measured_s(solution) / line_s), "line"))
    parts.append(series("limit / 1.96", line_s, np.full(line_s.shape, limit_deg / COVERAGE), "line"))
    caption = (
        f"RMS error at the known azimuths against measuring time, without the settling: {LIKELIHOOD} by pieces of the "
        "waveform, the other by means of repeats; the bound falls as 1/sqrt(T)."
    )
    labels = ("measuring time, s", "RMS error, deg")
    return [Figure("Errors over time", caption, *labels, parts, x_log=True, y_log=True)]


def _repeats(solution: Solution, method: str) -> tuple[Floats, Floats]:
    """RMS error of the phasor mean of the first m repeats of each heading, m = 1, 2, 4, ... as far as all have them."""
    azimuth_deg = solution.by_method[method].azimuth_deg
    groups: dict[tuple[str, str, float], list[complex]] = {}
    known: dict[tuple[str, str, float], float] = {}
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
        rms_deg.append(float(np.sqrt(np.mean(np.square(errors)))))
    return measured_s(solution) * np.array(counts, np.float64), np.array(rms_deg)
