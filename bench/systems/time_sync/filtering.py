"""Filters of a recording: the offset as a state with loose and tight measurement noise, and without it for comparison.

The offset is constant in the filter. What the receive stamps say of the drift of both clocks is taken out of the EGI's
tags beforehand, about the middle of the recording; how uncertain that is goes into the interval by as much as the
filter learnt the offset away from the middle. The covariance of the filter takes errors of the EGI for white noise;
what they really leave is the covariance of the same gains under the errors that are stated.

Figures of the flight by the EGI's own solutions: track over ground with times, and height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis import Figure, series, worded_figure
from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.differences import block_edges_s
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.innovation import NIS_DOF
from bench.systems.time_sync.estimators.kalman.setup import (
    LOOSE,
    OFFSET,
    TIGHT,
    EgiSamples,
    EgiSpread,
    FilterRun,
    FilterSetup,
    ImuDensities,
    ImuSamples,
)
from bench.systems.time_sync.records import Clocks, Stream
from bench.systems.time_sync.samples import Prepared
from bench.systems.time_sync.wording import say

AUGMENTED_LOOSE, AUGMENTED_TIGHT = "augmented_loose", "augmented_tight"
NONE = "not_compensated"
COMPENSATED = AUGMENTED_TIGHT  # for the image, which needs velocity and tilt: the noise of the one without offset
GROUPS = (AUGMENTED_LOOSE, AUGMENTED_TIGHT, NONE)
METHODS = GROUPS[:2]
OFFSET_STD_s = 0.03  # what is known of an offset beforehand
SEEN = 0.5  # variance of the offset, of that at first: above, the motion has not shown it
_KEPT = 1500  # epochs
_BIASES = slice(9, 15)  # states
_BEFORE_RADAR_s = 0.1
_LEAST_SHARE = 0.5  # of the inertial unit's time that solutions must cover
_MISFIT = 25.0  # mean normalised innovation squared: five times what the filter believes is another motion
_BEGIN_s = 0.2  # over which the motion at the begin is taken
_WIDE = 3.0  # an offset moves the first state; it must not look like knowledge about it (position: 10 m for 100 m/s)
_LEAST_m = 50.0  # a table in a laboratory does not go as far, whatever the noise of its GPS
_MOST_POINTS, _MOST_MARKS = 1200, 10
_STEPS_s = (5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)


@dataclass(frozen=True)
class Offset:
    """Offset by one filter, in the middle of the recording.

    ``offset_s``, ``std_s``: with everything that makes it uncertain.   ``filter_std_s``: by the covariance of the
    filter alone.   ``error_std_s``: what the stated errors of both units leave.   ``prior_std_s``: of what was assumed
    beforehand and still counts.   ``inflation``: by which the innovations are larger than they should be, 1 at the
    least.   ``drift_std_s``: part of the drift.   ``normalised``: variance at the end, of that at first.   ``seen``:
    False if the motion does not show the offset.
    """

    method: str
    offset_s: float
    std_s: float
    filter_std_s: float
    error_std_s: float
    prior_std_s: float
    inflation: float
    drift_std_s: float
    normalised: float
    seen: bool


@dataclass(frozen=True)
class Filtered:
    """Result of all filters.

    ``run``: groups in the order of ``GROUPS``, one lane each.   ``egi``: solutions as the filters took them.
    ``offsets``: by method.   ``shift_s``: of the EGI's tags, taken out beforehand; what the filter says is on top of
    it.   ``at_s``: time of the inertial unit.
    """

    run: FilterRun
    egi: EgiSamples
    offsets: dict[str, Offset]
    shift_s: float
    at_s: float
    samples: int

    def history_s(self, method: str) -> tuple[Floats, Floats]:
        """Return offset of one method over time and its standard uncertainty by the filter, (m,) each."""
        group = GROUPS.index(method)
        return self.run.offset_s[:, group, 0] + self.shift_s, self.run.sigma[:, group, OFFSET]

    def bias_std(self, method: str) -> Floats:
        """Return what the stated errors of both units leave of the biases, (6,): accelerometers m/s^2, gyros rad/s."""
        variances = np.diagonal(_real(self.run)[GROUPS.index(method)])[_BIASES]
        return np.asarray(self.offsets[method].inflation * np.sqrt(variances))


def filtered(
    ready: Prepared, clocks: Clocks, imu: ImuDensities, spread: EgiSpread, radar_from_s: float = math.inf
) -> Filtered:
    """Run the filters.

    Args:    ready: samples.   clocks: by the receive stamps.   imu: errors of the inertial unit.   spread: of the EGI.
             radar_from_s: first pulse of a radar, from which only the attitude is corrected.
    Raises:  FitError B-SYNC-003 if the solutions of the EGI do not overlap the samples of the inertial unit, B-SYNC-011
             if they do not fit them.
    """
    middle_s = ready.middle_s
    egi = _in_step(ready, clocks, middle_s)
    hold_s = radar_from_s - _BEFORE_RADAR_s
    velocity_m_s, attitude_deg = _moved_by_offset(ready.imu, egi)
    standard = FilterSetup((), ())
    setup = FilterSetup(
        augmented=(True, True, False),
        sigma_r=(LOOSE, TIGHT, TIGHT),
        latitude_deg=egi.frame.latitude_deg,
        offset_sigma_s=OFFSET_STD_s,
        velocity_sigma_m_s=math.hypot(standard.velocity_sigma_m_s, velocity_m_s),
        attitude_sigma_deg=math.hypot(standard.attitude_sigma_deg, attitude_deg),
        imu=imu,
        egi=spread,
        keep_every=max(1, egi.t_s.size // _KEPT),
        fine_from_s=hold_s,
        hold_position_from_s=hold_s,
        edges_s=block_edges_s(egi.t_s),
    )
    run = run_filter(ready.imu, egi, setup)
    _check_fit(run)
    drift_std = clocks.difference.drift_std
    offsets = {name: _offset(run, name, clocks.coarse_s, drift_std, middle_s) for name in METHODS}
    return Filtered(run, egi, offsets, clocks.coarse_s, middle_s, int(egi.t_s.size))


def _moved_by_offset(imu: ImuSamples, egi: EgiSamples) -> tuple[float, float]:
    """How far an offset may put the first velocity (m/s) and attitude (deg) off: a recording may begin in a manoeuvre.

    The filter begins at the first solution, which is old. Where the vehicle turns then, a filter that is sure of its
    first heading would be sure of an offset near zero.
    """
    last = int(np.searchsorted(egi.t_s, egi.t_s[0] + _BEGIN_s))
    acceleration = (egi.v[last] - egi.v[0]) / (egi.t_s[last] - egi.t_s[0])
    begin, end = np.searchsorted(imu.t_s, (egi.t_s[0], egi.t_s[last]))
    rate = imu.dtheta[begin + 1 : end + 1, 0].sum(axis=0) / (imu.t_s[end] - imu.t_s[begin])
    wide_s = _WIDE * OFFSET_STD_s
    return wide_s * float(np.linalg.norm(acceleration)), wide_s * math.degrees(float(np.linalg.norm(rate)))


def _in_step(ready: Prepared, clocks: Clocks, middle_s: float) -> EgiSamples:
    """Solutions with tags that run as the clock of the inertial unit runs, inside its samples."""
    tags_s = ready.egi.t_s - clocks.coarse_s
    tags_s = tags_s - clocks.difference.drift * (tags_s - middle_s)
    inside = (tags_s >= ready.imu.t_s[0]) & (tags_s <= ready.imu.t_s[-1])
    if not inside.any() or np.ptp(tags_s[inside]) < _LEAST_SHARE * ready.span_s:
        raise FitError(
            "B-SYNC-003",
            f"{int(inside.sum())} solutions of the EGI lie within the {ready.span_s:.1f} s of the inertial unit",
            next_step="record both links over the whole motion; look at the lost frames of the EGI",
        )
    return replace(ready.egi.part(inside), t_s=tags_s[inside])


def _offset(run: FilterRun, name: str, coarse_s: float, drift_std: float, middle_s: float) -> Offset:
    group = GROUPS.index(name)
    std_s = run.sigma[:, group, OFFSET]
    first_std_s = math.sqrt(float(run.first_covariance[group, OFFSET, OFFSET]))
    normalised = float(std_s[-1] / first_std_s) ** 2
    seen = normalised <= SEEN
    inflation = math.sqrt(max(1.0, ratio_of(run, group)))
    drift_std_s = abs(_learnt_s(run.t_s, std_s, first_std_s) - middle_s) * drift_std
    prior_std_s = first_std_s * (normalised if seen else 1.0)  # of an estimate that is drawn to what was assumed
    error_std_s = inflation * math.sqrt(float(_real(run)[group, OFFSET, OFFSET]))
    total_s = math.hypot(error_std_s, prior_std_s, drift_std_s)
    offset_s = float(run.offset_s[-1, group, 0]) + coarse_s
    return Offset(name, offset_s, total_s, float(std_s[-1]), error_std_s, prior_std_s, inflation, drift_std_s,
                  normalised, seen)  # fmt: skip


def _real(run: FilterRun) -> Floats:
    return np.zeros_like(run.first_covariance) if run.real_covariance is None else run.real_covariance


def _check_fit(run: FilterRun) -> None:
    """Solutions and increments must be of one motion: no interval covers what a filter makes of two."""
    ratio = ratio_of(run, GROUPS.index(AUGMENTED_LOOSE))
    if not ratio > _MISFIT:
        return
    worst_s = float(run.t_s[np.nanargmax(run.nis[:, GROUPS.index(AUGMENTED_LOOSE), 0])])
    raise FitError(
        "B-SYNC-011",
        "solutions of the EGI and increments of the inertial unit do not fit one motion: innovations are "
        f"{math.sqrt(ratio):.0f} times as large as even the loose filter believes, most so {worst_s:.1f} s after the "
        "first sample of the inertial unit",
        next_step="record one flight, begun once; see that both units have the same axes, and look at the EGI's modes",
    )


def ratio_of(run: FilterRun, group: int, block: int = 0) -> float:
    """Mean of the normalised innovations squared of one block over what is expected, 1 if the filter is consistent."""
    count = run.nis_count[:, group, block]
    use = (count > 0) & np.isfinite(run.nis[:, group, block])
    if not use.any():
        return math.nan
    return float(np.average(run.nis[use, group, block], weights=count[use]) / NIS_DOF[block])


def _learnt_s(t_s: Floats, std_s: Floats, first_std_s: float) -> float:
    """When the filter learnt the offset: mean time by how much each moment added to the information."""
    gained = np.diff(1.0 / std_s**2, prepend=1.0 / first_std_s**2)
    gained = np.maximum(gained, 0.0)
    return float(np.average(t_s, weights=gained)) if gained.sum() > 0.0 else float(t_s.mean())


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
        worded_figure(say, "height", ("height.x", "height.y"), heights),
    ]


def _spread(size: int, most: int) -> Integers:
    """Return places of at most so many samples, the first and the last among them."""
    return np.unique(np.rint(np.linspace(0, size - 1, min(size, most))).astype(np.int64))
