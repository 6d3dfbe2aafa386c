"""Figures of the flight by the EGI's own solutions: track over ground with times, and height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Figure, series
from bench.systems.time_sync.records import Stream
from bench.systems.time_sync.samples import EgiSamples
from bench.systems.time_sync.wording import say

_LEAST_m = 50.0  # a table in a laboratory does not go as far, whatever the noise of its GPS
_MOST_POINTS, _MOST_MARKS = 1200, 10
_STEPS_s = (5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)


def trajectory_figures(egi: EgiSamples, radar: Stream | None) -> list[Figure]:
    """Return track and height; nothing of a vehicle that stays where it is.

    Args:    egi: sound solutions.   radar: pulses, whose time tags are those of the inertial unit; None without.
    Source:  paper 003, figure 2.
    """
    if float(np.max(np.ptp(egi.p, axis=0))) < _LEAST_m:
        return []
    drawn = _spread(egi.t_s.size, _MOST_POINTS)
    flown_s, east_km, north_km = egi.t_s - egi.t_s[0], 1e-3 * egi.p[:, 1], 1e-3 * egi.p[:, 0]
    step_s = next((step for step in _STEPS_s if flown_s[-1] < _MOST_MARKS * step), _STEPS_s[-1])
    marks = np.searchsorted(flown_s, np.arange(step_s, flown_s[-1], step_s))
    height_m = egi.frame.heights_m(egi.p)
    track = [
        series(say("path.track"), east_km[drawn], north_km[drawn], "line"),
        series(say("path.each", step=step_s), east_km[marks], north_km[marks], "points"),
        series(say("path.start"), east_km[:1], north_km[:1], "points"),
        series(say("path.end"), east_km[-1:], north_km[-1:], "points"),
    ]
    heights = [series(say("path.height"), flown_s[drawn], height_m[drawn], "line")]
    caption = say("path.caption")
    if radar is not None and len(radar):
        seen = (egi.t_s >= radar.tick_s[0]) & (egi.t_s <= radar.tick_s[-1])
        track.append(series(say("path.image"), east_km[seen], north_km[seen], "line"))
        heights.append(series(say("path.image"), flown_s[seen], height_m[seen], "line"))
        caption = say("path.caption_image", start=float(radar.tick_s[0] - egi.t_s[0]))
    return [
        Figure(say("path.title"), caption, say("path.east"), say("path.north"), track, equal=True),
        Figure(say("height.title"), say("height.caption"), say("height.x"), say("height.y"), heights),
    ]


def _spread(size: int, most: int) -> NDArray[np.int64]:
    """Return places of at most so many samples, the first and the last among them."""
    return np.unique(np.rint(np.linspace(0, size - 1, min(size, most))).astype(np.int64))
