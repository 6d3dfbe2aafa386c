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
from bench.systems.lock_in.tables import LABELS

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
    title = f"Beat round a turnaround, {chosen[-1].name}"
    caption = (
        "Figure 7: measured crossings of the beat round one turnaround, the wave through them as a parabola of the "
        "phase gives it, and one crossing among the ticks of each clock."
    )
    parts = [
        curve("beat", 1e6 * at_s, np.sin(curved(at_s)), "line"),
        curve("crossings", 1e6 * near, np.zeros(near.size), "points"),
    ]
    wave = Figure(title, caption, "time, µs", "beat", parts, group="Beat and crossings")
    rate_rad_s = float((phase_rad[side + 2] - phase_rad[side]) / (time_s[side + 2] - time_s[side]))
    zoom_s = np.linspace(-_ZOOM_s, _ZOOM_s, 101)
    series = [curve("beat", 1e9 * zoom_s, np.sin(rate_rad_s * zoom_s), "line")]
    for laser in reversed(chosen):
        ticks = (
            np.arange(-math.floor(_ZOOM_s * laser.clock_Hz), math.floor(_ZOOM_s * laser.clock_Hz) + 1) / laser.clock_Hz
        )
        series.append(
            curve(f"ticks of {laser.clock_Hz / 1e6:g} MHz", 1e9 * ticks, np.sin(rate_rad_s * ticks), "points")
        )
    zoom = replace(wave, title="One crossing and the ticks of the clocks", x_label="time, ns", series=series)
    return [wave, zoom]


def _periods(laser: LaserResult) -> Figure:
    """Figure 8: beat period next to the turnaround, after minus before."""
    time_s = laser.found.shown.time_s[:_TURNAROUNDS]
    side = time_s.shape[1] // 2
    before, after = time_s[:, side - 1] - time_s[:, side - 3], time_s[:, side + 2] - time_s[:, side]
    return Figure(
        f"{laser.clock_Hz / 1e6:g} MHz",
        "Figure 8: period of the beat next to the turnaround, after it minus before it; the differences are whole "
        "ticks of the clock.",
        "turnaround",
        "difference of periods, ns",
        [_known("after minus before", np.arange(1.0, len(time_s) + 1), 1e9 * (after - before))],
        group="Differences of beat periods",
    )


def _estimated(laser: LaserResult) -> Figure:
    """Figure 9: jumps by each method, turnaround by turnaround."""
    jumps = laser.found.shown.jumps
    place = np.arange(1.0, _TURNAROUNDS + 1)
    series = []
    if GLOBAL in jumps:
        known = jumps[GLOBAL][:_TURNAROUNDS]
        series.append(_known(LABELS[GLOBAL], place[: known.size], 1e3 * known, "line"))
    for method in COMPENSATORS[1:]:
        if method in jumps:
            known = jumps[method][:_TURNAROUNDS]
            series.append(_known(LABELS[method], place[: known.size], 1e3 * known))
    return Figure(
        f"{laser.clock_Hz / 1e6:g} MHz",
        "Figure 9: error estimated at single turnarounds. Nobody knows the true one: the line is the global fit, "
        "which the others are compared with.",
        "turnaround",
        "phase jump, mrad",
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
            series.append(_known(LABELS[method], time_s, _detrended(_added(off)) / laser.gain * _ARCSEC, style))
    caption = (
        "Figure 10: estimated errors added up, as an angle, without its linear trend. Line: global fit, the "
        "reference; points: the other methods."
    )
    return Figure(f"Integrated error, {laser.name}", caption, "time, s", "integrated error, arcsec", series)


def _angle(laser: LaserResult) -> Figure:
    """Figure 11: angle before and after compensation."""
    series = []
    for method in (RAW, *COMPENSATORS):
        if method in laser.walks and method in (RAW, GLOBAL, "fresnel", "dither_shape"):
            time_s, increment = _cycles(laser, method)
            angle = _detrended(_added(increment)) / laser.gain * _ARCSEC
            series.append(_known(LABELS[method], time_s, angle, "line"))
    title = f"Angle before and after compensation, {laser.name}"
    caption = "Figure 11: net angle by the latched counts at the dither's zeros, without its linear trend."
    return Figure(title, caption, "time, s", "angle, arcsec", series)


def _left(laser: LaserResult) -> list[Figure]:
    """Return what the global fit leaves, and what single-turnaround methods get wrong, against the phase."""
    shown = laser.found.shown
    turn = np.mod(shown.psi0_rad, math.tau) / math.pi
    if not np.isfinite(shown.left_rad).any():
        return []
    parts = [_known("behind the global fit", turn, 1e3 * shown.left_rad)]
    reference = shown.jumps.get(GLOBAL)
    for method in ("dither_shape", "fresnel"):
        if method in shown.jumps and reference is not None:
            wrong = 1e3 * (shown.jumps[method] - reference)
            parts.append(_known(f"{LABELS[method]}, less global", turn[: wrong.size], wrong))
    title = f"Residual against the phase at the turnaround, {laser.name}"
    caption = (
        "Jump that the crossings still show behind the global fit, and by how much single-turnaround "
        "methods differ from it. A pattern is an error of the model or of the method; noise has none."
    )
    return [Figure(title, caption, "phase at the turnaround, pi", "jump, mrad", parts)]


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


def _known(label: str, x: Floats, y: Floats, style: Style = "points") -> Series:
    good = np.isfinite(x) & np.isfinite(y)
    return curve(label, x[good], y[good], style)
