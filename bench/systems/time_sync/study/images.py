"""Effect of the offset on the image, with and without its state in the filter: each run against itself at no offset."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bench.analysis import Estimate, Estimates, Floats
from bench.maths.arrays import rms
from bench.systems.time_sync.study.study import (
    ANY,
    ERRORLESS,
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
_WORST = {  # of the ratio of resolutions and the difference of the ISLR there, by whether the offset is a state
    False: ((1.01, math.inf), (0.3, math.inf)),
    True: ((-math.inf, 1.003), (-0.1, 0.1)),
}


def figures_of(results: Results, name: str, group: Group) -> Floats:
    """One figure of the focused targets of a group, (runs,)."""
    result, at = results.image(group)
    return np.asarray(getattr(result, name)[at])


def image_estimates(results: Results, offsets_ms: tuple[float, ...]) -> Estimates:
    """Return the ideal response, then figures of every offset and filter, then those against no offset."""
    documents = _ideal(results)
    for augmented in (False, True):
        for offset_ms in offsets_ms:
            group = Group(offset_ms, augmented, IMAGED)
            documents += _figures(results, group) + _identity(results, group)
            if offset_ms:
                documents += _paired(results, group)
    return documents


def _ideal(results: Results) -> Estimates:
    """Return nothing but the radar and the mechanisation."""
    ideal, conditions = results.ideal(), {"filter": ERRORLESS}
    along, across = ideal.response.azimuth, ideal.response.range

    def within(quantity: str, unit: str, value: float, due: float, by: float) -> Estimate:
        return measured(quantity, unit, value, 0.0, conditions, n=1, within=(due - by, due + by))

    return [
        measured("navigation_error", "m", ideal.position_m, 0.0, conditions, n=1, within=(-math.inf, NAVIGATED_m)),
        within("ideal_resolution", "m", along.resolution_m, IDEAL_RESOLUTION_m, 0.01 * IDEAL_RESOLUTION_m),
        within("ideal_range_resolution", "m", across.resolution_m, IDEAL_RANGE_m, 0.01 * IDEAL_RANGE_m),
        within("ideal_pslr", "dB", along.pslr_dB, IDEAL_PSLR_dB, 0.15),
        within("ideal_islr", "dB", along.islr_dB, IDEAL_ISLR_dB, 0.3),
    ]


def _mean_std(values: Floats) -> tuple[float, float]:
    """Mean over the runs and its standard uncertainty."""
    std = float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    return float(values.mean()), float(std)


def _figures(results: Results, group: Group) -> Estimates:
    documents, conditions = [], group.where("sar", noise=IMAGED)
    for name in FIGURES:
        values = figures_of(results, name, group)
        quantity, _, unit = name.rpartition("_")
        named = (quantity, unit) if quantity else (name, "1")
        documents.append(measured(*named, *_mean_std(values), conditions, n=len(values)))
    result, at = results.image(group)
    for number, shift_m in enumerate(result.several_m[at], 1):
        target = conditions | {"target": number, "run": 1}
        documents.append(measured("target_shift", "m", float(shift_m), 0.0, target, n=1))
    return documents


def _identity(results: Results, group: Group) -> Estimates:
    """The shift that is seen in the image is the one that the errors of navigation explain."""
    seen_m, said_m = (figures_of(results, name, group) for name in ("azimuth_shift_m", "predicted_m"))
    rms_m, conditions, most = rms(seen_m - said_m), group.where("sar", noise=IMAGED), (-math.inf, _IDENTITY_m)
    return [measured("shift_unexplained_rms", "m", rms_m, 0.0, conditions, n=len(seen_m), within=most)]


def _paired(results: Results, group: Group) -> Estimates:
    """Return every run against the same run without an offset."""
    names = ("azimuth_shift_m", "azimuth_resolution_m", "islr_dB")
    (with_m, wide_m, with_dB), (without_m, narrow_m, without_dB) = (
        [figures_of(results, name, one) for name in names] for one in (group, replace(group, offset_ms=0.0))
    )
    mean_m, std_m = _mean_std(with_m - without_m)
    conditions, n = group.where("sar", noise=IMAGED), len(with_m)
    within = (-_COMPENSATED_m, _COMPENSATED_m) if group.augmented else ANY
    documents = [measured("shift_against_none", "m", mean_m, std_m, conditions, n=n, within=within)]
    if not group.augmented:
        lag_m = IMAGE_SPEED_m_s * group.offset_ms * 1e-3
        ratio = -mean_m / lag_m
        documents.append(measured("shift_over_lag", "1", ratio, std_m / abs(lag_m), conditions, n=n, within=_SHIFT))
    wider, higher_dB = _WORST[group.augmented] if group.offset_ms == _WORST_ms else (ANY, ANY)
    ratio, lobes_dB = float(wide_m.mean() / narrow_m.mean()), _mean_std(with_dB - without_dB)
    documents.append(measured("resolution_ratio", "1", ratio, 0.0, conditions, n=n, within=wider))
    documents.append(measured("islr_against_none", "dB", *lobes_dB, conditions, n=n, within=higher_dB))
    return documents
