"""Figures of a time offset: offset and interval over time, observability, innovations, receive stamps, image."""

from __future__ import annotations

import numpy as np

from bench.analysis import Figure, Floats, Series, band, picture, series
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.estimators.sar.image import levels_dB
from bench.systems.time_sync.filtering import COMPENSATED, GROUPS, METHODS, NONE
from bench.systems.time_sync.image import Image
from bench.systems.time_sync.tables import LABELS

_MOST_POINTS = 1200
_TIME = "time of the inertial unit, s"
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
            series("offset", t_s, offset_ms, "line"),
            band("95 % by the filter", t_s, offset_ms - reach_ms, offset_ms + reach_ms),
        ]
        if result.clocks.offset_s is not None:
            stamps_ms = 1e3 * result.clocks.offset_s
            parts.append(series("receive stamps", [float(t_s[0]), float(t_s[-1])], [stamps_ms, stamps_ms], "line"))
        caption = "Offset while the filter learns it, the drift of the clocks taken out."
        drawn.append(Figure(f"Filter {LABELS[name]}", caption, _TIME, "offset, ms", parts, group="time offset"))
    return drawn


def _seen(result: SyncResult) -> list[Figure]:
    parts: list[Series] = []
    for name in METHODS:
        group = GROUPS.index(name)
        t_s, variance, value = _thin(
            result.found.run.t_s, result.seen.offset_variance[:, group], result.seen.associated[:, group]
        )
        short = LABELS[name].removeprefix("augmented, ")
        parts.append(series(f"variance, {short}", t_s, np.maximum(variance, _LEAST), "line"))
        parts.append(series(f"eigenvalue, {short}", t_s, np.maximum(value, _LEAST), "line"))
    caption = (
        "Observability: variance of the offset over that at first, and the eigenvalue of the normalised covariance "
        "that belongs to it. At 1 nothing is learnt."
    )
    return [Figure("Observability of the offset", caption, _TIME, "normalised, 1", parts, y_log=True)]


def _innovations(result: SyncResult) -> list[Figure]:
    run, parts = result.found.run, []
    for group, name in enumerate(GROUPS):
        ratio = run.nis[:, group, 0] / run.nis_dof[0]
        use = np.isfinite(ratio) & (ratio > 0.0)
        if use.any():
            t_s, value = _thin(run.t_s[use], ratio[use])
            parts.append(series(LABELS[name], t_s, value, "points"))
    caption = "Normalised innovations squared over their degrees of freedom; far below 1 the filter is careful."
    return [Figure("Innovations", caption, _TIME, "NIS / degrees of freedom", parts, y_log=True)] if parts else []


def _stamps(result: SyncResult) -> list[Figure]:
    clocks, drawn = result.clocks, []
    for title, at_s, port in (("inertial unit", clocks.imu_s, clocks.imu), ("EGI", clocks.egi_s, clocks.egi)):
        every = max(1, at_s.size // _MOST_POINTS)
        x, y = at_s[::every], 1e3 * port.above_s[::every]
        caption = "Delay of the frames above the line of the least delay, which tells rate and offset of the clock."
        axes = "time of the unit, s", "delay above the line, ms"
        drawn.append(Figure(f"Receive stamps, {title}", caption, *axes, [series("frames", x, y, "points")],
                            group="receive stamps"))  # fmt: skip
    return drawn


def _chips(image: Image) -> list[Figure]:
    """Return both images about the place of the strongest target, as it was found with the compensated solution."""
    drawn = []
    for name, chip in zip((COMPENSATED, NONE), image.chips, strict=True):
        level_dB = np.round(levels_dB(chip.value, np.abs(chip.value).max(), _FLOOR_dB).T, 1)
        caption = "Radar image about the strongest target, 0 dB (black) to -40 dB (white)."
        parts = [picture(chip.azimuth_m, chip.range_m, level_dB)]
        title = LABELS[name].capitalize()
        drawn.append(Figure(title, caption, "azimuth, m", "range, m", parts, group="radar image"))
    return drawn


def _responses(image: Image) -> list[Figure]:
    """Cuts through the strongest target, each about its own peak; the shift stands in the label of the second."""
    drawn = []
    compensated, plain = image.compensated[0], image.plain[0]
    for title, cut, second, shift_m in (
        ("Azimuth", compensated.azimuth_cut, plain.azimuth_cut, float(image.shifts_m[0])),
        ("Range", compensated.range_cut, plain.range_cut, plain.range_shift_m - compensated.range_shift_m),
    ):  # fmt: skip
        top = float(np.max(np.abs(cut.value)))
        parts = [
            series(LABELS[COMPENSATED], cut.offset_m, levels_dB(cut.value, top, _FLOOR_dB), "line"),
            series(LABELS[NONE], second.offset_m + shift_m, levels_dB(second.value, top, _FLOOR_dB), "line"),
        ]
        caption = "Response of the strongest target, from the place of its compensated image."
        labels = f"{title.lower()}, m", "power, dB"
        drawn.append(Figure(f"{title} cut", caption, *labels, parts, group="impulse response"))
    return drawn


def _thin(t_s: Floats, *values: Floats) -> tuple[Floats, ...]:
    every = max(1, t_s.size // _MOST_POINTS)
    return tuple(column[::every] for column in (t_s, *values))
