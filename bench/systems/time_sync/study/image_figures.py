"""Figures 8 to 10 and 12 to 14 of the study: cuts, chips and indices of the target, numbered as in the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import Figure, picture, series
from bench.systems.time_sync.estimators.sar.image import levels_dB
from bench.systems.time_sync.study.images import figures_of, image_group
from bench.systems.time_sync.study.results import Results

_NUMBERS = {False: ("8", "9", "10"), True: ("12", "13", "14")}
_FLOOR_dB = -40.0
_INDICES = (
    ("azimuth_shift_m", "shift", "m"),
    ("azimuth_resolution_m", "resolution", "m"),
    ("pslr_dB", "PSLR", "dB"),
    ("islr_dB", "ISLR", "dB"),
)


def image_figures(results: Results, offsets_ms: Sequence[float], *, augmented: bool) -> list[Figure]:
    """Cut, chips and indices of one of the two filters."""
    return [
        *_cuts(results, offsets_ms, augmented),
        *_chips(results, (min(offsets_ms, key=abs), max(offsets_ms, key=abs)), augmented),
        *_indices(results, offsets_ms, augmented),
    ]


def _which(augmented: bool) -> str:
    return "with the offset as a state" if augmented else "without compensation"


def _cuts(results: Results, offsets_ms: Sequence[float], augmented: bool) -> list[Figure]:
    number, parts = _NUMBERS[augmented][0], []
    for offset_ms in offsets_ms:
        group = image_group(offset_ms, augmented=augmented)
        for cut in results.image(group)[0].cuts:
            if (cut.direction, cut.offset_ms, cut.solution) == ("azimuth", group.offset_ms, group.solution):
                level_dB = levels_dB(cut.amplitude, 1.0, _FLOOR_dB)
                parts.append(series(f"{offset_ms:g} ms", cut.at_m, level_dB))
    caption = (
        f"Figure {number}. Impulse response along the track, {_which(augmented)}, run 1; 0 m is where the target truly "
        "is, 0 dB the peak of a perfectly known track. The paper's axis: amplitude over azimuth."
    )
    labels = "along track / m", "level / dB"
    return [Figure(f"Fig. {number} impulse response", caption, *labels, parts, f"figure {number}")]


def _chips(results: Results, offsets_ms: Sequence[float], augmented: bool) -> list[Figure]:
    number, drawings = _NUMBERS[augmented][1], []
    caption = (
        f"Figure {number}. The target's image, {_which(augmented)}, run 1; level from -40 dB (white) to 0 dB (black)."
    )
    for letter, offset_ms in zip("ab", offsets_ms, strict=True):
        group = image_group(offset_ms, augmented=augmented)
        result, at = results.image(group)
        chip = result.chips[at]
        level_dB = np.minimum(levels_dB(chip.size, 1.0, _FLOOR_dB), 0.0)
        title = f"Fig. {number} ({letter}) {offset_ms:g} ms"
        parts = [picture(chip.azimuth_m, chip.range_m, np.round(level_dB.T, 1))]
        drawings.append(Figure(title, caption, "along track / m", "range / m", parts, f"figure {number}"))
    return drawings


def _indices(results: Results, offsets_ms: Sequence[float], augmented: bool) -> list[Figure]:
    number, drawings = _NUMBERS[augmented][2], []
    caption = (
        f"Figure {number}. Indices of the image over the offset, {_which(augmented)}: mean over the runs and its "
        "scatter (one standard deviation). The paper's axes: the same four indices over the offset, without scales in "
        "the text."
    )
    for name, title, unit in _INDICES:
        values = [figures_of(results, name, offset_ms, augmented=augmented) for offset_ms in offsets_ms]
        mean, std = np.array([of_runs.mean() for of_runs in values]), np.array([of_runs.std() for of_runs in values])
        part = series("mean", offsets_ms, mean, "points", low=mean - std, high=mean + std)
        labels = "offset / ms", f"{title} / {unit}"
        drawings.append(Figure(f"Fig. {number} {title}", caption, *labels, [part], f"figure {number}"))
    return drawings
