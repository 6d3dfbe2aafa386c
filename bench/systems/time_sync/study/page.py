"""The study as chapters of figures, tables and sentences, for the page that the report makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.systems.time_sync.study.documents import Document, Documents, table
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

Chapter = dict[str, Any]


def study_chapters(options: StudyOptions, document: Mapping[str, Any], found: Results) -> list[Chapter]:
    """Chapters: ``name``, ``paragraphs``, ``figures``, ``tables``."""
    offsets_ms, estimates = options.offsets_ms, Estimates(document["estimates"])
    uncompensated = [image_table(estimates, offsets_ms), paired_table(estimates, offsets_ms)]
    return [
        _chapter("tolerances", [], [tolerance_table(document["estimates"])], document["notes"]),
        _chapter(
            "errors",
            error_figures(found, offsets_ms),
            [*paper_tables(found, estimates, offsets_ms), bias_table(estimates, offsets_ms)],
        ),
        _chapter("image", image_figures(found, offsets_ms, augmented=False), uncompensated),
        _chapter(
            "recovery",
            [*offset_figure(found, offsets_ms), *recovered_figure(found)],
            [recovered_table(estimates), long_table(estimates, offsets_ms)],
        ),
        _chapter(
            "compensated", image_figures(found, offsets_ms, augmented=True), [several_table(estimates, offsets_ms)]
        ),
        _chapter("observability", observability_figures(found), [observability_table(estimates)]),
        _chapter("assumptions", [], _word_tables()),
    ]


def _chapter(name: str, figures: Documents, tables: Documents, paragraphs: Sequence[str] = ()) -> Chapter:
    return {"name": name, "figures": figures, "tables": tables, "paragraphs": list(paragraphs)}


def tolerance_table(estimates: Sequence[Mapping[str, Any]]) -> Document:
    """Everything that is judged, what failed first."""
    judged = [one for one in estimates if one["verdict"] != "none"]
    rows = [
        (
            one["quantity"].replace("_", " "),
            _where(one["conditions"]),
            said(one),
            one["unit"],
            _end(one["conditions"].get("at_least")),
            _end(one["conditions"].get("at_most")),
            one["verdict"],
        )
        for one in sorted(judged, key=lambda one: one["verdict"] != "fail")
    ]
    heads = ("quantity", "case", "value", "unit", "at least", "at most", "verdict")
    caption = "The value is judged; its standard uncertainty is that of the number of runs"
    return table("Tolerances", caption, heads, rows, prose=True)


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


def _word_tables() -> Documents:
    assumed = ("What the paper does not state", "Assumed here; another choice changes the numbers")
    cannot = ("What cannot be matched, and why", "")
    misprints = ("Equations as they must read", "Errors are estimate minus truth")
    return [
        table(*assumed, ("item", "assumption"), ASSUMED, prose=True),
        table(*cannot, ("item", "why"), UNMATCHED, prose=True),
        table(*misprints, ("equation", "printed", "here"), MISPRINTS, prose=True),
    ]
