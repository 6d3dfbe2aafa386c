"""Figures of a time offset: offset and interval over time, observability, innovations, receive stamps, image."""

from __future__ import annotations

import numpy as np

from bench.analysis import Figure, Floats, Series, band, picture, series
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.estimators.sar.image import levels_dB
from bench.systems.time_sync.filtering import COMPENSATED, GROUPS, METHODS, NONE
from bench.systems.time_sync.image import Image
from bench.systems.time_sync.wording import filter_name, say

_MOST_POINTS = 1200
_FLOOR_dB = -40.0
_LEAST = 1e-9


def figures(result: SyncResult) -> list[Figure]:
    """Return all that the recording allows."""
    drawn = [*_offsets(result), *_seen(result), *_innovations(result), *_stamps(result)]
    return drawn + ([*_chips(result.image), *_responses(result.image)] if result.image else [])


def _offsets(result: SyncResult) -> list[Figure]:
    drawn = []
    for name in METHODS:
        offset_s, std_s = result.found.history_s(name)
        t_s, offset_ms, reach_ms = _thin(result.found.run.t_s, 1e3 * offset_s, 1e3 * coverage_factor() * std_s)
        parts = [
            series(say("offset.series"), t_s, offset_ms, "line"),
            band(say("offset.band"), t_s, offset_ms - reach_ms, offset_ms + reach_ms),
        ]
        if result.clocks.offset_s is not None:
            stamps_ms = 1e3 * result.clocks.offset_s
            ends_s = [float(t_s[0]), float(t_s[-1])]
            parts.append(series(say("result.stamps"), ends_s, [stamps_ms, stamps_ms], "line"))
        title = say("offset.title", name=filter_name(name))
        labels = say("offset.caption"), say("time"), say("result.head.offset")
        drawn.append(Figure(title, *labels, parts, group=say("offset.group")))
    return drawn


def _seen(result: SyncResult) -> list[Figure]:
    parts: list[Series] = []
    for name in METHODS:
        group = GROUPS.index(name)
        t_s, variance, value = _thin(
            result.found.run.t_s, result.seen.offset_variance[:, group], result.seen.associated[:, group]
        )
        short = say(f"seen.{name}")
        parts.append(series(say("seen.variance", name=short), t_s, np.maximum(variance, _LEAST), "line"))
        parts.append(series(say("seen.eigenvalue", name=short), t_s, np.maximum(value, _LEAST), "line"))
    return [Figure(say("seen.title"), say("seen.caption"), say("time"), say("seen.y"), parts, y_log=True)]


def _innovations(result: SyncResult) -> list[Figure]:
    run, parts = result.found.run, []
    for group, name in enumerate(GROUPS):
        ratio = run.nis[:, group, 0] / run.nis_dof[0]
        use = np.isfinite(ratio) & (ratio > 0.0)
        if use.any():
            t_s, value = _thin(run.t_s[use], ratio[use])
            parts.append(series(filter_name(name), t_s, value, "points"))
    labels = say("innovations.title"), say("innovations.caption"), say("time"), say("innovations.y")
    return [Figure(*labels, parts, y_log=True)] if parts else []


def _stamps(result: SyncResult) -> list[Figure]:
    clocks, drawn = result.clocks, []
    for unit, at_s, port in ((say("imu"), clocks.imu_s, clocks.imu), ("EGI", clocks.egi_s, clocks.egi)):
        every = max(1, at_s.size // _MOST_POINTS)
        x, y = at_s[::every], 1e3 * port.above_s[::every]
        labels = say("stamps.title", unit=unit), say("stamps.caption"), say("stamps.x"), say("stamps.y")
        frames = series(say("clocks.head.frames"), x, y, "points")
        drawn.append(Figure(*labels, [frames], group=say("result.stamps")))
    return drawn


def _chips(image: Image) -> list[Figure]:
    """Return both images about the place of the strongest target, as it was found with the compensated solution."""
    drawn = []
    for name, chip in zip((COMPENSATED, NONE), image.chips, strict=True):
        level_dB = np.round(levels_dB(chip.value, np.abs(chip.value).max(), _FLOOR_dB).T, 1)
        parts = [picture(chip.azimuth_m, chip.range_m, level_dB)]
        labels = say(f"chip.{name}"), say("chip.caption"), say("cut.azimuth.x"), say("cut.range.x")
        drawn.append(Figure(*labels, parts, group=say("path.image")))
    return drawn


def _responses(image: Image) -> list[Figure]:
    """Cuts through the strongest target, each about its own peak; the shift stands in the label of the second."""
    drawn = []
    compensated, plain = image.compensated[0], image.plain[0]
    for name, cut, second, shift_m in (
        ("azimuth", compensated.azimuth_cut, plain.azimuth_cut, float(image.shifts_m[0])),
        ("range", compensated.range_cut, plain.range_cut, plain.range_shift_m - compensated.range_shift_m),
    ):  # fmt: skip
        top = float(np.max(np.abs(cut.value)))
        parts = [
            series(filter_name(COMPENSATED), cut.offset_m, levels_dB(cut.value, top, _FLOOR_dB), "line"),
            series(filter_name(NONE), second.offset_m + shift_m, levels_dB(second.value, top, _FLOOR_dB), "line"),
        ]
        labels = say(f"cut.{name}"), say("cut.caption"), say(f"cut.{name}.x"), say("cut.y")
        drawn.append(Figure(*labels, parts, group=say("cut.group")))
    return drawn


def _thin(t_s: Floats, *values: Floats) -> tuple[Floats, ...]:
    every = max(1, t_s.size // _MOST_POINTS)
    return tuple(column[::every] for column in (t_s, *values))
