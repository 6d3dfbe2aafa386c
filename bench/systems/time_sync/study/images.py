"""Effect of the offset on the image, with and without its state in the filter: each run against itself at no offset."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis import Estimate, Estimates, Floats
from bench.maths.arrays import rms
from bench.systems.time_sync.study.study import (
    AUGMENTED,
    ERRORLESS,
    UNAUGMENTED,
    Group,
    IMAGE_SPEED_m_s,
    Results,
    measured,
)
from bench.systems.time_sync.study.tasks import FIGURES, IMAGED

IDEAL_RESOLUTION_m, IDEAL_RANGE_m, IDEAL_PSLR_dB, IDEAL_ISLR_dB = 0.2490, 2.656, -13.26, -10.12
NAVIGATED_m = 1e-3
_IDENTITY_m, _SHIFT, _COMPENSATED_m = 0.02, (1.00, 1.15), 0.25
_WORST_ms = 30.0
_WORSE, _NOT_WORSE, _WORSE_dB, _NOT_WORSE_dB = 1.01, 1.003, 0.3, 0.1
_UNITS = {
    "azimuth_shift_m": "m", "range_shift_m": "m", "azimuth_resolution_m": "m", "range_resolution_m": "m",
    "pslr_dB": "dB", "islr_dB": "dB", "peak": "1",
}  # fmt: skip


def image_group(offset_ms: float, *, augmented: bool) -> Group:
    """A filter whose navigation is focused."""
    return Group(offset_ms * 1e-3, augmented, IMAGED)


def figures_of(results: Results, name: str, offset_ms: float, *, augmented: bool) -> Floats:
    """One figure of the focused targets, (runs,)."""
    result, at = results.image(image_group(offset_ms, augmented=augmented))
    return np.asarray(getattr(result, name)[at])


def image_estimates(results: Results, offsets_ms: tuple[float, ...]) -> Estimates:
    """Return the ideal response, then figures of every offset and filter, then those against no offset."""
    documents = _ideal(results)
    for augmented in (False, True):
        for offset_ms in offsets_ms:
            documents += _figures(results, offset_ms, augmented)
            documents += _identity(results, offset_ms, augmented)
            if offset_ms:
                documents += _paired(results, offset_ms, augmented)
    return documents


def _ideal(results: Results) -> Estimates:
    """Return nothing but the radar and the mechanisation."""
    ideal, conditions = results.ideal(), {"filter": ERRORLESS}
    along, across = ideal.response.azimuth, ideal.response.range

    def within(quantity: str, unit: str, value: float, due: float, by: float) -> Estimate:
        return measured(quantity, unit, value, 0.0, conditions, n=1, at_least=due - by, at_most=due + by)

    return [
        measured("navigation_error", "m", ideal.position_m, 0.0, conditions, n=1, at_most=NAVIGATED_m),
        within("ideal_resolution", "m", along.resolution_m, IDEAL_RESOLUTION_m, 0.01 * IDEAL_RESOLUTION_m),
        within("ideal_range_resolution", "m", across.resolution_m, IDEAL_RANGE_m, 0.01 * IDEAL_RANGE_m),
        within("ideal_pslr", "dB", along.pslr_dB, IDEAL_PSLR_dB, 0.15),
        within("ideal_islr", "dB", along.islr_dB, IDEAL_ISLR_dB, 0.3),
    ]


def _conditions(offset_ms: float, augmented: bool, **more: Any) -> dict[str, Any]:
    name = AUGMENTED if augmented else UNAUGMENTED
    return {"manoeuvre": "sar", "offset_ms": offset_ms, "filter": name, "noise": IMAGED, **more}


def _mean_std(values: Floats) -> tuple[float, float]:
    """Mean over the runs and its standard uncertainty."""
    std = float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    return float(values.mean()), float(std)


def _figures(results: Results, offset_ms: float, augmented: bool) -> Estimates:
    documents = []
    for name in FIGURES:
        values = figures_of(results, name, offset_ms, augmented=augmented)
        mean, std = _mean_std(values)
        quantity = name.removesuffix("_m").removesuffix("_dB")
        documents.append(measured(quantity, _UNITS[name], mean, std, _conditions(offset_ms, augmented), n=len(values)))
    result, at = results.image(image_group(offset_ms, augmented=augmented))
    for number, shift_m in enumerate(result.several_m[at], 1):
        conditions = _conditions(offset_ms, augmented, target=number, run=1)
        documents.append(measured("target_shift", "m", float(shift_m), 0.0, conditions, n=1))
    return documents


def _identity(results: Results, offset_ms: float, augmented: bool) -> Estimates:
    """The shift that is seen in the image is the one that the errors of navigation explain."""
    seen_m, said_m = (
        figures_of(results, name, offset_ms, augmented=augmented) for name in ("azimuth_shift_m", "predicted_m")
    )
    rms_m = rms(seen_m - said_m)
    conditions = _conditions(offset_ms, augmented)
    return [measured("shift_unexplained_rms", "m", rms_m, 0.0, conditions, n=len(seen_m), at_most=_IDENTITY_m)]


def _paired(results: Results, offset_ms: float, augmented: bool) -> Estimates:
    """Return every run against the same run without an offset."""
    moved_m = _difference(results, "azimuth_shift_m", offset_ms, augmented)
    mean_m, std_m = _mean_std(moved_m)
    conditions, n = _conditions(offset_ms, augmented), len(moved_m)
    resolution = [
        figures_of(results, "azimuth_resolution_m", offset, augmented=augmented) for offset in (offset_ms, 0.0)
    ]
    ratio = float(resolution[0].mean() / resolution[1].mean())
    islr_dB, islr_std_dB = _mean_std(_difference(results, "islr_dB", offset_ms, augmented))
    worst = offset_ms == _WORST_ms
    documents = []
    if augmented:
        ends = {"at_least": -_COMPENSATED_m, "at_most": _COMPENSATED_m}
        documents.append(measured("shift_against_none", "m", mean_m, std_m, conditions, n=n, **ends))
        ratio_ends = {"at_most": _NOT_WORSE} if worst else {}
        islr_ends = {"at_least": -_NOT_WORSE_dB, "at_most": _NOT_WORSE_dB} if worst else {}
    else:
        lag_m, (low, high) = IMAGE_SPEED_m_s * offset_ms * 1e-3, _SHIFT
        documents.append(measured("shift_against_none", "m", mean_m, std_m, conditions, n=n))
        documents.append(
            measured(
                "shift_over_lag", "1", -mean_m / lag_m, std_m / abs(lag_m), conditions, n=n, at_least=low, at_most=high
            )
        )
        ratio_ends, islr_ends = ({"at_least": _WORSE}, {"at_least": _WORSE_dB}) if worst else ({}, {})
    documents.append(measured("resolution_ratio", "1", ratio, 0.0, conditions, n=n, **ratio_ends))
    documents.append(measured("islr_against_none", "dB", islr_dB, islr_std_dB, conditions, n=n, **islr_ends))
    return documents


def _difference(results: Results, name: str, offset_ms: float, augmented: bool) -> Floats:
    with_it, without = (figures_of(results, name, offset, augmented=augmented) for offset in (offset_ms, 0.0))
    return with_it - without
