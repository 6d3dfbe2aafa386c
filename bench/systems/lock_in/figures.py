"""Figures of a campaign of ring lasers: alignment, random walk over path length, ratios, Allan deviations.

What single turnarounds show is in ``turnaround_figures``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import Figure, Floats, Series, curve, series
from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.compensation import COMPENSATORS, RAW
from bench.systems.lock_in.estimates import NATO_MIL_DEG, Requirement, alignment_s
from bench.systems.lock_in.estimators.random_walk import RandomWalk, alignment_time_s
from bench.systems.lock_in.result import LaserResult, walk_std_deg_rth
from bench.systems.lock_in.wording import label, say

_TIMES_s = np.geomspace(1.0, 3600.0, 61)
_WALKS = (0.001, 0.002, 0.005, 0.01)  # deg/sqrt(h), of figure 1
_SCATTERING_ppm = (10.0, 30.0, 100.0)
# Figure 2 of the paper, which states no constant for its equation (4): 0.001 deg/sqrt(h) at 30 cm with 10 ppm.
_REFERENCE = (0.001, 0.30, 10.0)
_FEWEST_PHASES = 3


def campaign_figures(results: Sequence[LaserResult], requirement: Requirement, method: str) -> list[Figure]:
    """Return figures 1, 2 and 12, the ratio against the backscatter phase, and the Allan deviations."""
    return [
        _alignment(results, requirement, method),
        _path_length(results, method),
        *_ratios(results),
        *_backscatter(results),
        *_allan(results, method),
    ]


def best_by_path(results: Sequence[LaserResult]) -> list[LaserResult]:
    """Return the first record of each path at the fastest clock."""
    return [
        max((laser for laser in results if laser.record.path_length_m == path_m), key=lambda laser: laser.clock_Hz)
        for path_m in sorted({laser.record.path_length_m for laser in results})
    ]


def _alignment(results: Sequence[LaserResult], requirement: Requirement, method: str) -> Figure:
    def error_mil(time_to_one_mil_s: float) -> Floats:
        return np.asarray(np.sqrt(time_to_one_mil_s / _TIMES_s))

    parts = []
    for walk in _WALKS:
        time_s = alignment_time_s(walk, requirement.latitude_deg, NATO_MIL_DEG)
        parts.append(curve(f"{walk:g} deg/√h", _TIMES_s, error_mil(time_s), "line"))
    one_mil = Requirement(NATO_MIL_DEG, None, requirement.latitude_deg)
    for laser in best_by_path(results)[:3]:
        for name in (RAW, method):
            measured = laser.walks.get(name)
            if measured is not None and measured.n_deg_rth > 0.0:
                points = slice(0, None, 6)
                words = say("figure1.measured", path=100 * laser.record.path_length_m, method=label(name))
                error = error_mil(alignment_s(measured, one_mil).value)
                parts.append(curve(words, _TIMES_s[points], error[points], "points"))
    caption = say("figure1.caption", latitude=requirement.latitude_deg)
    axes = say("axis.alignment_time"), say("axis.alignment_error")
    return Figure(say("figure1.title"), caption, *axes, parts, x_log=True, y_log=True)


def _path_length(results: Sequence[LaserResult], method: str) -> Figure:
    walk, path_m, ppm = _REFERENCE
    at_m = np.linspace(0.12, 0.40, 57)
    parts = [
        curve(
            f"{scattering_ppm:g} ppm", 100 * at_m, walk * np.sqrt(scattering_ppm / ppm) * (path_m / at_m) ** 2.5, "line"
        )
        for scattering_ppm in _SCATTERING_ppm
    ]
    for name in (RAW, method):
        chosen = [laser for laser in best_by_path(results) if name in laser.walks]
        parts.append(_points(label(name), [100 * laser.record.path_length_m for laser in chosen],
                              [laser.walks[name] for laser in chosen]))  # fmt: skip
    axes = say("axis.path"), say("axis.random_walk")
    return Figure(say("figure2.title"), say("figure2.caption"), *axes, parts, y_log=True)


def _points(name: str, x: Sequence[float], walks: Sequence[RandomWalk]) -> Series:
    value = np.array([walk.n_deg_rth for walk in walks])
    reach = coverage_factor() * np.array([walk_std_deg_rth(walk) for walk in walks])
    low = np.maximum(value - reach, 1e-3 * value)  # the axis is logarithmic
    return series(name, x, value, "points", low=low, high=value + reach)


def _ratios(results: Sequence[LaserResult]) -> list[Figure]:
    """Figure 12: one panel per clock. At several phase settings the sweep shows more."""
    figures = []
    for clock_Hz in sorted({laser.clock_Hz for laser in results}):
        chosen = [laser for laser in results if laser.clock_Hz == clock_Hz and laser.record.phase_setting_deg is None]
        if chosen:
            x = [100 * laser.record.path_length_m for laser in chosen]
            figures.append(
                Figure(
                    say("figure.clock", clock=clock_Hz / 1e6),
                    say("figure12.caption"),
                    say("axis.path"),
                    say("axis.ratio"),
                    [_ratio_points(method, chosen, x) for method in COMPENSATORS],
                    y_log=True,
                    group="Random walk behind over before",
                )
            )
    return figures


def _ratio_points(method: str, results: Sequence[LaserResult], x: Sequence[float]) -> Series:
    seen = [(at, ratio) for at, ratio in zip(x, (laser.ratio(method) for laser in results), strict=True) if ratio]
    seen = [(at, ratio) for at, ratio in seen if ratio.value > 0.0 and np.isfinite(ratio.std)]
    reach = coverage_factor()
    return series(
        label(method),
        [at for at, _ in seen],
        [ratio.value for _, ratio in seen],
        "points",
        low=[max(ratio.value - reach * ratio.std, 1e-3 * ratio.value) for _, ratio in seen],
        high=[ratio.value + reach * ratio.std for _, ratio in seen],
    )


def _backscatter(results: Sequence[LaserResult]) -> list[Figure]:
    """Ratio against the backscatter phase that the global fit found, if the records have several."""
    chosen = [
        laser for laser in results if laser.backscatter_deg is not None and laser.record.phase_setting_deg is not None
    ]
    if len({laser.record.phase_setting_deg for laser in chosen}) < _FEWEST_PHASES:
        return []
    x = [laser.backscatter_deg.value for laser in chosen if laser.backscatter_deg is not None]
    return [
        Figure(
            say("backscatter.title"),
            say("backscatter.caption"),
            say("axis.backscatter"),
            say("axis.ratio"),
            [_ratio_points(method, chosen, x) for method in COMPENSATORS],
            y_log=True,
        )
    ]


def _allan(results: Sequence[LaserResult], method: str) -> list[Figure]:
    """Allan deviation before and after, with the fit of random walk and quantisation; one panel per path."""
    figures = []
    for laser in best_by_path(results):
        parts = []
        for name in (RAW, method):
            walk = laser.walks.get(name)
            if walk is None:
                continue
            parts.append(
                series(label(name), walk.tau_s, walk.deviation_deg_h, "points",
                       low=walk.low_deg_h, high=walk.high_deg_h)
            )  # fmt: skip
            parts.append(curve(say("figure.fit", method=label(name)), walk.tau_s, walk.fitted_deg_h, "line"))
        figures.append(
            Figure(
                laser.name,
                say("allan.caption"),
                say("axis.averaging_time"),
                say("axis.allan"),
                parts,
                x_log=True,
                y_log=True,
                group="Allan deviation before and after compensation",
            )
        )
    return figures
