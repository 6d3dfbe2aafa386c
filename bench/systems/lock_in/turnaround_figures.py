"""Figures of what happens at single turnarounds of the dither, and of how it adds up (figures 7 to 11 of paper 004).

There is no truth in an analysis: the reference of the estimated jumps is the global fit, and the figures say so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.analysis import Figure, Floats, Series, Style, curve
from bench.systems.lock_in.compensation import COMPENSATORS, GLOBAL, RAW
from bench.systems.lock_in.result import LaserResult
from bench.systems.lock_in.wording import label, say

_PAPER_PATH_M = 0.28  # the laser of the paper's figures 7 to 11
_TURNAROUNDS = 80  # of figures that show single ones
_WAVE_s, _ZOOM_s = 120e-6, 0.4e-6
_CLEAR_s = 50e-6  # between the innermost crossings: the phase turned well away from a level, where it is a parabola
_ARCSEC = math.degrees(1.0) * 3600.0


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
    title, axes = say("beat.title", name=chosen[-1].name), (say("axis.time_us"), say("axis.beat"))
    parts = [
        curve(say("beat.beat"), 1e6 * at_s, np.sin(curved(at_s)), "line"),
        curve(say("beat.crossings"), 1e6 * near, np.zeros(near.size), "points"),
    ]
    wave = Figure(title, say("beat.caption"), *axes, parts, group="Beat and crossings")
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
    title, axes = say("integrated.title", name=laser.name), (say("axis.time"), say("axis.integrated"))
    return Figure(title, say("integrated.caption"), *axes, series)


def _angle(laser: LaserResult) -> Figure:
    """Figure 11: angle before and after compensation."""
    series = []
    for method in (RAW, *COMPENSATORS):
        if method in laser.walks and method in (RAW, GLOBAL, "fresnel", "dither_shape"):
            time_s, increment = _cycles(laser, method)
            angle = _detrended(_added(increment)) / laser.gain * _ARCSEC
            series.append(_known(label(method), time_s, angle, "line"))
    title, caption = say("angle.title", name=laser.name), say("angle.caption")
    return Figure(title, caption, say("axis.time"), say("axis.angle"), series)


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
    title, caption = say("left.title", name=laser.name), say("left.caption")
    return [Figure(title, caption, say("axis.phase"), say("axis.jump"), parts)]


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
    return np.asarray(values - trend(place))


def _known(name: str, x: Floats, y: Floats, style: Style = "points") -> Series:
    good = np.isfinite(x) & np.isfinite(y)
    return curve(name, x[good], y[good], style)
