"""Figures of a campaign of ring lasers: alignment, random walk over path length, ratios, Allan deviations.

Then what happens at single turnarounds of the dither, and how it adds up (figures 7 to 11 of paper 004).
There is no truth in an analysis: the reference of the estimated jumps is the global fit, and the figures say so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.analysis import Figure, Floats, Series, Style, curve, series, worded_figure
from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.compensation import COMPENSATORS, GLOBAL, RAW
from bench.systems.lock_in.estimators.random_walk import RandomWalk, alignment_time_s
from bench.systems.lock_in.result import NATO_MIL_DEG, LaserResult, Requirement, alignment_s, walk_std_deg_rth
from bench.systems.lock_in.wording import label, say

_TIMES_s = np.geomspace(1.0, 3600.0, 61)
_WALKS = (0.001, 0.002, 0.005, 0.01)  # deg/sqrt(h), of figure 1
_SCATTERING_ppm = (10.0, 30.0, 100.0)
# Figure 2 of the paper, which states no constant for its equation (4): 0.001 deg/sqrt(h) at 30 cm with 10 ppm.
_REFERENCE = (0.001, 0.30, 10.0)
_FEWEST_PHASES = 3
_PAPER_PATH_M = 0.28  # the laser of the paper's figures 7 to 11
_TURNAROUNDS = 80  # of figures that show single ones
_WAVE_s, _ZOOM_s = 120e-6, 0.4e-6
_CLEAR_s = 50e-6  # between the innermost crossings: the phase turned well away from a level, where it is a parabola
_ARCSEC = math.degrees(1.0) * 3600.0


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
        return np.sqrt(time_to_one_mil_s / _TIMES_s)

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
    axes, latitude_deg = ("axis.alignment_time", "axis.alignment_error"), requirement.latitude_deg
    return worded_figure(say, "figure1", axes, parts, logarithmic="xy", latitude=latitude_deg)


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
    return worded_figure(say, "figure2", ("axis.path", "axis.random_walk"), parts, logarithmic="y")


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
    parts = [_ratio_points(method, chosen, x) for method in COMPENSATORS]
    return [worded_figure(say, "backscatter", ("axis.backscatter", "axis.ratio"), parts, logarithmic="y")]


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


def turnaround_figures(results: Sequence[LaserResult]) -> list[Figure]:
    """Figures 7 to 11 and what the global fit leaves, of the path nearest to the paper's and each of its clocks."""
    path_m = min((laser.record.path_length_m for laser in results), key=lambda path: abs(path - _PAPER_PATH_M))
    chosen = _one_per_clock([laser for laser in results if laser.record.path_length_m == path_m])
    last = chosen[-1]
    return [
        *_beat(chosen),
        *map(_periods, chosen),
        *map(_estimated, chosen),
        _integrated(last),
        _angle(last),
        *_left(last),
    ]


def _one_per_clock(results: Sequence[LaserResult]) -> list[LaserResult]:
    first: dict[float, LaserResult] = {}
    for laser in results:
        first.setdefault(laser.clock_Hz, laser)
    return [first[clock_Hz] for clock_Hz in sorted(first)]


def _beat(chosen: Sequence[LaserResult]) -> list[Figure]:
    """Figure 7: the beat round one turnaround, and one crossing among the ticks of each clock."""
    shown = chosen[-1].found.shown
    side = shown.time_s.shape[1] // 2
    whole = np.flatnonzero(shown.time_s[:, side] - shown.time_s[:, side - 1] > _CLEAR_s)
    if not whole.size:
        return []
    time_s, phase_rad = shown.time_s[whole[0]], shown.phase_rad[whole[0]]
    curved = np.polynomial.Polynomial.fit(time_s, phase_rad, 2)
    at_s = np.linspace(-_WAVE_s, _WAVE_s, 481)
    near = time_s[np.abs(time_s) <= _WAVE_s]
    parts = [
        curve(say("beat.beat"), 1e6 * at_s, np.sin(curved(at_s)), "line"),
        curve(say("beat.crossings"), 1e6 * near, np.zeros(near.size), "points"),
    ]
    axes, group = ("axis.time_us", "axis.beat"), "Beat and crossings"
    wave = worded_figure(say, "beat", axes, parts, group=group, name=chosen[-1].name)
    rate_rad_s = float((phase_rad[side + 2] - phase_rad[side]) / (time_s[side + 2] - time_s[side]))
    zoom_s = np.linspace(-_ZOOM_s, _ZOOM_s, 101)
    series = [curve(say("beat.beat"), 1e9 * zoom_s, np.sin(rate_rad_s * zoom_s), "line")]
    for laser in reversed(chosen):
        ticks = (
            np.arange(-math.floor(_ZOOM_s * laser.clock_Hz), math.floor(_ZOOM_s * laser.clock_Hz) + 1) / laser.clock_Hz
        )
        series.append(
            curve(say("beat.ticks", clock=laser.clock_Hz / 1e6), 1e9 * ticks, np.sin(rate_rad_s * ticks), "points")
        )
    zoom = replace(wave, title=say("beat.zoom"), x_label=say("axis.time_ns"), series=series)
    return [wave, zoom]


def _periods(laser: LaserResult) -> Figure:
    """Figure 8: beat period next to the turnaround, after minus before."""
    time_s = laser.found.shown.time_s[:_TURNAROUNDS]
    side = time_s.shape[1] // 2
    before, after = time_s[:, side - 1] - time_s[:, side - 3], time_s[:, side + 2] - time_s[:, side]
    return Figure(
        say("figure.clock", clock=laser.clock_Hz / 1e6),
        say("periods.caption"),
        say("axis.turnaround"),
        say("axis.periods"),
        [_known(say("periods.series"), np.arange(1.0, len(time_s) + 1), 1e9 * (after - before))],
        group="Differences of beat periods",
    )


def _estimated(laser: LaserResult) -> Figure:
    """Figure 9: jumps by each method, turnaround by turnaround."""
    jumps = laser.found.shown.jumps
    place = np.arange(1.0, _TURNAROUNDS + 1)
    series = []
    if GLOBAL in jumps:
        known = jumps[GLOBAL][:_TURNAROUNDS]
        series.append(_known(label(GLOBAL), place[: known.size], 1e3 * known, "line"))
    for method in COMPENSATORS[1:]:
        if method in jumps:
            known = jumps[method][:_TURNAROUNDS]
            series.append(_known(label(method), place[: known.size], 1e3 * known))
    return Figure(
        say("figure.clock", clock=laser.clock_Hz / 1e6),
        say("estimated.caption"),
        say("axis.turnaround"),
        say("axis.phase_jump"),
        series,
        group="Estimated error at the turnarounds",
    )


def _integrated(laser: LaserResult) -> Figure:
    """Figure 10: what the compensators take off, added up over the record."""
    time_s, raw = _cycles(laser, RAW)
    series = []
    for method in COMPENSATORS:
        if method in laser.walks:
            off = raw - _cycles(laser, method)[1]
            style: Style = "line" if method == GLOBAL else "points"
            series.append(_known(label(method), time_s, _detrended(_added(off)) / laser.gain * _ARCSEC, style))
    return worded_figure(say, "integrated", ("axis.time", "axis.integrated"), series, name=laser.name)


def _angle(laser: LaserResult) -> Figure:
    """Figure 11: angle before and after compensation."""
    series = []
    for method in (RAW, *COMPENSATORS):
        if method in laser.walks and method in (RAW, GLOBAL, "fresnel", "dither_shape"):
            time_s, increment = _cycles(laser, method)
            angle = _detrended(_added(increment)) / laser.gain * _ARCSEC
            series.append(_known(label(method), time_s, angle, "line"))
    return worded_figure(say, "angle", ("axis.time", "axis.angle"), series, name=laser.name)


def _left(laser: LaserResult) -> list[Figure]:
    """Return what the global fit leaves, and what single-turnaround methods get wrong, against the phase."""
    shown = laser.found.shown
    turn = np.mod(shown.psi0_rad, math.tau) / math.pi
    if not np.isfinite(shown.left_rad).any():
        return []
    parts = [_known(say("left.behind"), turn, 1e3 * shown.left_rad)]
    reference = shown.jumps.get(GLOBAL)
    for method in ("dither_shape", "fresnel"):
        if method in shown.jumps and reference is not None:
            wrong = 1e3 * (shown.jumps[method] - reference)
            parts.append(_known(say("left.less", method=label(method)), turn[: wrong.size], wrong))
    return [worded_figure(say, "left", ("axis.phase", "axis.jump"), parts, name=laser.name)]


def _cycles(laser: LaserResult, method: str) -> tuple[Floats, Floats]:
    increment = laser.found.increments[method]
    return np.arange(1, increment.size + 1, dtype=np.float64) * laser.found.interval_s, increment


def _added(increment: Floats) -> Floats:
    """Return the sum up to each dither period; a period without a value adds nothing and has no sum."""
    return np.where(np.isfinite(increment), np.nancumsum(increment), np.nan)


def _detrended(values: Floats) -> Floats:
    good = np.isfinite(values)
    place = np.arange(values.size, dtype=np.float64)
    if np.count_nonzero(good) < 2:
        return values
    trend = np.polynomial.Polynomial.fit(place[good], values[good], 1)
    return values - trend(place)


def _known(name: str, x: Floats, y: Floats, style: Style = "points") -> Series:
    good = np.isfinite(x) & np.isfinite(y)
    return curve(name, x[good], y[good], style)
