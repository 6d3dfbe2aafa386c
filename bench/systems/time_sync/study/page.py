"""The study as chapters of figures, tables and sentences, for the page that the report makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import Chapter, Table
from bench.systems.time_sync.study.flight_figures import (
    error_figures,
    observability_figures,
    offset_figure,
    recovered_figure,
)
from bench.systems.time_sync.study.image_figures import image_figures
from bench.systems.time_sync.study.notes import ASSUMED, MISPRINTS, UNMATCHED
from bench.systems.time_sync.study.results import Results
from bench.systems.time_sync.study.study import ERRORLESS, StudyOptions
from bench.systems.time_sync.study.tables import (
    Estimates,
    bias_table,
    image_table,
    long_table,
    observability_table,
    paired_table,
    paper_tables,
    plain,
    recovered_table,
    said,
    several_table,
)


def study_chapters(options: StudyOptions, document: Mapping[str, Any], results: Results) -> list[Chapter]:
    """Return the chapters in the order of the page."""
    offsets_ms, estimates = options.offsets_ms, Estimates(document["estimates"])
    uncompensated = [image_table(estimates, offsets_ms), paired_table(estimates, offsets_ms)]
    return [
        Chapter("tolerances", [], [tolerance_table(document["estimates"])], document["notes"]),
        Chapter(
            "errors",
            error_figures(results, offsets_ms),
            [*paper_tables(results, estimates, offsets_ms), bias_table(estimates, offsets_ms)],
        ),
        Chapter("image", image_figures(results, offsets_ms, augmented=False), uncompensated),
        Chapter(
            "recovery",
            [*offset_figure(results, offsets_ms), *recovered_figure(results)],
            [recovered_table(estimates), long_table(estimates, offsets_ms)],
        ),
        Chapter(
            "compensated", image_figures(results, offsets_ms, augmented=True), [several_table(estimates, offsets_ms)]
        ),
        Chapter("observability", observability_figures(results), [observability_table(estimates)]),
        Chapter("assumptions", [], _word_tables()),
    ]


def tolerance_table(estimates: Sequence[Mapping[str, Any]]) -> Table:
    """Return everything that is judged, what failed first."""
    judged = [estimate for estimate in estimates if estimate["verdict"] != "none"]
    rows = [
        (
            estimate["quantity"].replace("_", " "),
            _where(estimate["conditions"]),
            said(estimate),
            estimate["unit"],
            _end(estimate["conditions"].get("at_least")),
            _end(estimate["conditions"].get("at_most")),
            estimate["verdict"],
        )
        for estimate in sorted(judged, key=lambda estimate: estimate["verdict"] != "fail")
    ]
    heads = ("quantity", "case", "value", "unit", "at least", "at most", "verdict")
    caption = "The value is judged; its standard uncertainty is that of the number of runs"
    return Table("Tolerances", caption, heads, rows, prose=True)


def _end(value: float | None) -> str:
    return "–" if value is None else plain(value)


def _where(conditions: Mapping[str, Any]) -> str:
    if conditions["filter"] == ERRORLESS:
        return "without errors"
    shown = {
        name: value for name, value in conditions.items() if name not in ("at_least", "at_most") and value is not None
    }
    units = {"offset_ms": "{} ms", "at_s": "at {} s"}
    return ", ".join(
        units.get(name, "{}").format(f"{value:g}" if isinstance(value, float) else value)
        for name, value in shown.items()
    )


def _word_tables() -> list[Table]:
    assumed = ("What the paper does not state", "Assumed here; another choice changes the numbers")
    cannot = ("What cannot be matched, and why", "")
    misprints = ("Equations as they must read", "Errors are estimate minus truth")
    return [
        Table(*assumed, ("item", "assumption"), ASSUMED, prose=True),
        Table(*cannot, ("item", "why"), UNMATCHED, prose=True),
        Table(*misprints, ("equation", "printed", "here"), MISPRINTS, prose=True),
    ]
