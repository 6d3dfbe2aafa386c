"""Compares two calibrations of one unit, parameter by parameter."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.maths.drift import NO_STANDARD, en_scores
from bench.store.errors import StoreError
from bench.store.series import read_pair


def compare_pair(url: str, first: str, second: str) -> dict[str, Any]:
    """Change of every parameter, its expanded uncertainty and E_n, the standard common to both being left out.

    Args:   url: of the history.   first, second: sessions or the beginnings of their SHA-256.
    Raises: StoreError B-STORE-011 if they have nothing in common, B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    series = read_pair(url, first, second)
    value, expanded = series.value, series.std * series.factor
    both = np.flatnonzero(np.isfinite(value).all(axis=0))
    if not both.size:
        raise StoreError(
            "B-STORE-011",
            "these have no parameter in common",
            where=f"{first}, {second}",
            next_step="compare two calibrations of one unit by the same campaign",
        )
    same = (series.standard[0] == series.standard[1]) & (series.standard[0] != NO_STANDARD)
    shared = np.where(same, np.minimum(series.shared, series.std) * series.factor, 0.0)
    change = value[1] - value[0]
    en = en_scores(change, (expanded[0], expanded[1]), (shared[0], shared[1]))
    spread = np.sqrt(np.maximum(expanded[0] ** 2 + expanded[1] ** 2 - 2.0 * shared[0] * shared[1], 0.0))
    return {
        "uut_model": series.uut[0],
        "uut_serial": series.uut[1],
        "sessions": [row["session"] for row in series.calibrations],
        "methods": [row["method"] for row in series.calibrations],
        "parameters": [
            {
                **vars(series.parameters[column]),
                "values": value[:, column].tolist(),
                "expanded_uncertainties": expanded[:, column].tolist(),
                "change": float(change[column]),
                "change_expanded_uncertainty": float(spread[column]),
                "en": float(en[column]) if np.isfinite(en[column]) else None,
                "shared_standard": bool(same[column]),
            }
            for column in both
        ],
    }
