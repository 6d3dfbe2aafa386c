"""What an analysis gives back: estimates for results.json and everything that explains them in the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.analysis.estimates import Estimates
from bench.analysis.figures import Figure
from bench.analysis.tables import Table
from bench.model.errors import FitError

Documents = list[dict[str, Any]]


@dataclass(frozen=True)
class Analysis:
    """Result of an analysis; ``estimates`` are entries of results.json, the rest explains them in the report.

    ``missing`` names, one sentence each, what the campaign promises and has no result; empty if it is complete.
    ``compensation``: {"channel", "kind", "parameter", "unit", "reference_temperature_degC", "coefficients",
    "valid_degC"}, coefficient k in unit per degC^k; channel None for what belongs to the whole unit.
    ``attachments``: files that go with the results, by their path below the session's folder ``units``, as text.
    """

    campaign: str
    method: str
    uut: Mapping[str, Any]
    estimates: Estimates
    residuals: Documents = field(default_factory=list)  # one per row of the fit
    components: Documents = field(default_factory=list)  # uncertainty budget
    groups: Documents = field(default_factory=list)  # reduced chi-square per channel and temperature
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    compensation: Documents = field(default_factory=list)
    attachments: Mapping[str, str] = field(default_factory=dict)


def no_result(missing: Iterable[str]) -> list[str]:
    """Return the notes that name what a campaign promises and has no result, a sentence each."""
    return [f"No result: {sentence}." for sentence in missing]


def check_method(method: str, methods: Sequence[str]) -> None:
    """Refuse a method that an analysis does not have. Raises FitError B-FIT-004."""
    if method not in methods:
        raise FitError("B-FIT-004", f"unknown method {method!r}", next_step=f"use one of: {', '.join(methods)}")
