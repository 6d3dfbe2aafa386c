"""What an analysis gives back: estimates for results.json and everything that explains them in the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Documents = list[dict[str, Any]]


@dataclass(frozen=True)
class Analysis:
    """Result of an analysis; ``estimates`` are entries of results.json, the rest explains them in the report.

    ``missing`` names, one sentence each, what the campaign promises and has no result; empty if it is complete.
    ``figures``: {"title", "caption", "x_label", "y_label", "series"}, optional "x_log", "y_log", "group", "equal" (both
    axes to the same scale); a series is {"label", "x", "y", "style": "line" | "points" | "band"}, a band has "low" and
    "high" instead of "y".
    ``tables``: {"title", "caption", "headers", "rows"}, optional "prose", and "lead": True for what is read first.
    ``compensation``: {"channel", "kind", "parameter", "unit", "reference_temperature_degC", "coefficients",
    "valid_degC"}, coefficient k in unit per degC^k; channel None for what belongs to the whole unit.
    ``attachments``: files that go with the results, by their path below the session's folder ``units``, as text.
    """

    campaign: str
    method: str
    uut: Mapping[str, Any]
    estimates: Documents
    residuals: Documents = field(default_factory=list)  # one per row of the fit
    components: Documents = field(default_factory=list)  # uncertainty budget
    groups: Documents = field(default_factory=list)  # reduced chi-square per channel and temperature
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    figures: Documents = field(default_factory=list)
    tables: Documents = field(default_factory=list)
    compensation: Documents = field(default_factory=list)
    attachments: Mapping[str, str] = field(default_factory=dict)
