"""Figures of a campaign of ring lasers: alignment, random walk over path length, ratios, Allan deviations.

Numbers of figures are those of paper 004. What single turnarounds show is in ``rlg_turnaround_figures``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.verdict import coverage_factor
from bench.systems.gnc.report import curve
from bench.systems.lock_in.compensation import COMPENSATORS, RAW
from bench.systems.lock_in.estimates import alignment_s, paths_of
from bench.systems.lock_in.estimators.random_walk import RandomWalk, alignment_time_s
from bench.systems.lock_in.limits import NATO_MIL_DEG, Requirement
from bench.systems.lock_in.result import LaserResult, walk_std_deg_rth
from bench.systems.lock_in.tables import LABELS

Floats = NDArray[np.float64]
Figure = dict[str, Any]
Documents = list[Figure]
_TIMES_s = np.geomspace(1.0, 3600.0, 61)
_WALKS = (0.001, 0.002, 0.005, 0.01)  # deg/sqrt(h), of figure 1
_SCATTERING_ppm = (10.0, 30.0, 100.0)
# Figure 2 of the paper, which states no constant for its equation (4): 0.001 deg/sqrt(h) at 30 cm with 10 ppm.
_REFERENCE = (0.001, 0.30, 10.0)
_FEWEST_PHASES = 3


def campaign_figures(results: Sequence[LaserResult], requirement: Requirement, method: str) -> Documents:
    """Figures 1, 2 and 12, the ratio against the backscatter phase, and the Allan deviations."""
    return [
        _alignment(results, requirement, method),
        _path_length(results, method),
        *_ratios(results),
        *_backscatter(results),
        *_allan(results, method),
    ]


def best_by_path(results: Sequence[LaserResult]) -> list[LaserResult]:
    """The first record of each path at the fastest clock."""
    return [
        max((one for one in results if one.record.path_length_m == path_m), key=lambda one: one.clock_Hz)
        for path_m in paths_of(results)
    ]


def _alignment(results: Sequence[LaserResult], requirement: Requirement, method: str) -> Figure:
    def error_mil(time_to_one_mil_s: float) -> Floats:
        return np.asarray(np.sqrt(time_to_one_mil_s / _TIMES_s))

    series = []
    for walk in _WALKS:
        time_s = alignment_time_s(walk, requirement.latitude_deg, NATO_MIL_DEG)
        series.append(curve(f"{walk:g} deg/√h", _TIMES_s, error_mil(time_s), "line"))
    one_mil = Requirement(NATO_MIL_DEG, None, requirement.latitude_deg)
    for one in best_by_path(results)[:3]:
        for name in (RAW, method):
            measured = one.walks.get(name)
            if measured is not None and measured.n_deg_rth > 0.0:
                points = slice(0, None, 6)
                label = f"{100 * one.record.path_length_m:g} cm, {LABELS[name]}"
                error = error_mil(alignment_s(measured, one_mil).value)
                series.append(curve(label, _TIMES_s[points], error[points], "points"))
    return {
        "title": "Figure 1: alignment error against alignment time",
        "caption": (
            f"Equation (2) at latitude {requirement.latitude_deg:g} deg: lines for given random walks, points for "
            "those measured here at the fastest clock; one standard deviation, 1 mil = 360/6400 deg."
        ),
        "x_label": "alignment time, s",
        "y_label": "alignment error, mil",
        "x_log": True,
        "y_log": True,
        "series": series,
    }


def _path_length(results: Sequence[LaserResult], method: str) -> Figure:
    walk, path_m, ppm = _REFERENCE
    at_m = np.linspace(0.12, 0.40, 57)
    series = [
        curve(f"{one:g} ppm", 100 * at_m, walk * np.sqrt(one / ppm) * (path_m / at_m) ** 2.5, "line")
        for one in _SCATTERING_ppm
    ]
    for name in (RAW, method):
        chosen = [one for one in best_by_path(results) if name in one.walks]
        series.append(_points(LABELS[name], [100 * one.record.path_length_m for one in chosen],
                              [one.walks[name] for one in chosen]))  # fmt: skip
    return {
        "title": "Figure 2: random walk against path length",
        "caption": (
            "Lines: equations (4) and (6), for mirrors of this scattering, set to the paper's example of 0.001 "
            "deg/h^0.5 at 30 cm and 10 ppm. Points: measured, fastest clock, with 95 % intervals."
        ),
        "x_label": "optical path, cm",
        "y_label": "random walk, deg/h^0.5",
        "y_log": True,
        "series": series,
    }


def _points(label: str, x: Sequence[float], walks: Sequence[RandomWalk]) -> dict[str, Any]:
    value = np.array([one.n_deg_rth for one in walks])
    reach = coverage_factor() * np.array([walk_std_deg_rth(one) for one in walks])
    low = np.maximum(value - reach, 1e-3 * value)  # the axis is logarithmic
    bars = {"low": low.tolist(), "high": (value + reach).tolist()}
    return {"label": label, "x": list(x), "y": value.tolist(), "style": "points"} | bars


def _ratios(results: Sequence[LaserResult]) -> Documents:
    """Figure 12: one panel per clock. At several phase settings the sweep shows more."""
    figures = []
    for clock_Hz in sorted({one.clock_Hz for one in results}):
        chosen = [one for one in results if one.clock_Hz == clock_Hz and one.record.phase_setting_deg is None]
        if chosen:
            x = [100 * one.record.path_length_m for one in chosen]
            figures.append(
                {
                    "title": f"{clock_Hz / 1e6:g} MHz",
                    "caption": (
                        "Figure 12: random walk behind each compensator over that before it, with 95 % intervals; "
                        "above 1 it does harm."
                    ),
                    "x_label": "optical path, cm",
                    "y_label": "ratio of random walks",
                    "y_log": True,
                    "group": "Random walk behind over before",
                    "series": [_ratio_points(method, chosen, x) for method in COMPENSATORS],
                }
            )
    return figures


def _ratio_points(method: str, results: Sequence[LaserResult], x: Sequence[float]) -> dict[str, Any]:
    seen = [(at, ratio) for at, ratio in zip(x, (one.ratio(method) for one in results), strict=True) if ratio]
    seen = [(at, ratio) for at, ratio in seen if ratio.value > 0.0 and np.isfinite(ratio.std)]
    reach = coverage_factor()
    return {
        "label": LABELS[method],
        "style": "points",
        "x": [at for at, _ in seen],
        "y": [ratio.value for _, ratio in seen],
        "low": [max(ratio.value - reach * ratio.std, 1e-3 * ratio.value) for _, ratio in seen],
        "high": [ratio.value + reach * ratio.std for _, ratio in seen],
    }


def _backscatter(results: Sequence[LaserResult]) -> Documents:
    """Ratio against the backscatter phase that the global fit found, if the records have several."""
    chosen = [one for one in results if one.backscatter_deg is not None and one.record.phase_setting_deg is not None]
    if len({one.record.phase_setting_deg for one in chosen}) < _FEWEST_PHASES:
        return []
    x = [one.backscatter_deg.value for one in chosen if one.backscatter_deg is not None]
    return [
        {
            "title": "Ratio against backscatter phase",
            "caption": (
                "Random walk behind each compensator over that before it, against the phase that the global fit found. "
                "A fit of the crossings on each side alone works near ±90 deg only: elsewhere the ripple of the "
                "beat's phase sits on the crossings next to the turnaround."
            ),
            "x_label": "backscatter phase, deg",
            "y_label": "ratio of random walks",
            "y_log": True,
            "series": [_ratio_points(method, chosen, x) for method in COMPENSATORS],
        }
    ]


def _allan(results: Sequence[LaserResult], method: str) -> Documents:
    """Allan deviation before and after, with the fit of random walk and quantisation; one panel per path."""
    figures = []
    for one in best_by_path(results):
        series = []
        for name in (RAW, method):
            walk = one.walks.get(name)
            if walk is None:
                continue
            series.append(
                {"label": LABELS[name], "style": "points", "x": walk.tau_s.tolist(), "y": walk.deviation_deg_h.tolist(),
                 "low": walk.low_deg_h.tolist(), "high": walk.high_deg_h.tolist()}
            )  # fmt: skip
            series.append(curve(f"{LABELS[name]}, fit", walk.tau_s, walk.fitted_deg_h, "line"))
        figures.append(
            {
                "title": one.name,
                "caption": (
                    "Overlapping Allan deviation of the latched counts before and after compensation, 95 % intervals, "
                    "and random walk with quantisation noise fitted together."
                ),
                "x_label": "averaging time, s",
                "y_label": "Allan deviation, deg/h",
                "x_log": True,
                "y_log": True,
                "group": "Allan deviation before and after compensation",
                "series": series,
            }
        )
    return figures
