"""Mean temperature of each record: the mean of its readings with the standard uncertainty of that mean."""

from __future__ import annotations

import numpy as np

from bench.analysis import Analysis, Material, check_method, estimate
from bench.model.declaration import AnalysisDeclaration

METHODS: tuple[str, ...] = ("mean",)
DECLARATION = AnalysisDeclaration(
    "air_mean", __name__, METHODS, made_of="readings", conditions=("place",), main=("temperature",)
)


def analyse(material: Material, method: str = "mean") -> Analysis:
    """Return the mean of each record, degC, with s / sqrt(n) and n - 1 degrees of freedom.

    Raises: FitError B-FIT-004 for an unknown method.
    Source: JCGM 100:2008, 4.2.1 to 4.2.3 (mean of repeated readings and its experimental standard deviation).
    """
    check_method(method, METHODS)
    estimates, missing = [], []
    for row in material.rows:
        place = row.window.conditions["place"]
        values = [reading.value for reading in material.readings_of(row) if reading.value is not None]
        if len(values) < 2:
            missing.append(f"the record at {place} has fewer than two readings")
            continue
        uncertainty = float(np.std(values, ddof=1) / np.sqrt(len(values)))
        mean = float(np.mean(values))
        conditions = {"place": place, "record": row.window.number}
        estimates.append(
            estimate("temperature", "degC", mean, uncertainty, conditions, n=len(values), dof=len(values) - 1)
        )
    return Analysis("air_mean", method, material.campaign["uut"], estimates, missing=missing)
