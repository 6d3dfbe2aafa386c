"""Main estimates of a session that is still being recorded; a process of its own, niced, like early verdicts.

``python -m bench.session.partial SESSION``: reads the committed part of the session, prints one JSON document
``{"records": n, "rows": [...]}`` and exits with 0. While nothing is determined, ``why`` says so. Estimates that the
plan predicts have ``predicted_uncertainty`` and ``expected_uncertainty`` at the end, both expanded.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

from bench.analysis import (
    Estimate,
    Estimates,
    by_foreseen_name,
    doubt_lines,
    is_sound,
    results_json,
    rule_of,
    stated_estimates,
)
from bench.model.errors import BenchError
from bench.model.posix import give_way
from bench.model.texts import quantity_titles
from bench.record import UNIT_TEMPERATURE, SessionReader
from bench.session.one_unit import serials_of
from bench.session.service import read_view
from bench.session.view import Expected, SessionView, analysis_of, expectations, main_quantities

NICE = 19
KEYS = (
    "quantity", "unit", "conditions", "value", "std_uncertainty", "expanded_uncertainty", "limit", "limits", "verdict",
    "quality",
)  # fmt: skip
NOT_YET = {"value": None, "std_uncertainty": None, "expanded_uncertainty": None, "verdict": "none", "quality": None}


def partial(folder: Path) -> dict[str, Any]:
    """Return the main estimates of the analysis, or others where there is none of these: determined so far or expected.

    Those that the plan predicts come first, in its order, whether they are determined or not.
    Raises: InputError B-REC-010 (no session); SessionDamaged B-REC-012 (no manifest).
    """
    if serials_of(SessionReader(folder).manifest):
        return {"records": 0, "rows": [], "why": "results of several units are made when the run has ended"}
    view = read_view(folder)
    document: dict[str, Any] = {"records": len(view.rows), "rows": []}
    if not view.has_analysis:
        return {**document, "why": "this sequence asks for no analysis"}
    entries: Estimates = []
    try:
        entries = stated_estimates(analysis_of(view), rule_of(view.manifest["campaign"].get("decision")))
        document["doubt"] = doubt_lines(entries)
    except BenchError as error:  # most often: too few records yet
        document["why"] = error.message
    rows = _rows(view, entries)
    return {**document, "rows": rows} if rows else {"why": "no estimate is determined yet", **document}


def _rows(view: SessionView, entries: Estimates) -> list[dict[str, Any]]:
    analysis = str(view.manifest["campaign"]["analysis"])
    named = by_foreseen_name(entries)
    determined = {name: entry for name, entry in named.items() if _is_number(entry.value) or not is_sound(entry)}
    expected = expectations(view, determined)
    rows = [_row(determined.get(name), expected.get(name), analysis) for name in {**expected, **determined}]
    main = main_quantities(view)
    return [row for row in rows if row["quantity"] in main] or rows


def _row(entry: Estimate | None, expected: Expected | None, analysis: str) -> dict[str, Any]:
    """Return what is measured of the conditions changes with each record; what is left names the estimate."""
    if entry is None:
        assert expected is not None
        document = expected.predicted.document | NOT_YET
    else:
        document = entry.document
    row = {key: document.get(key) for key in KEYS}
    if expected is not None:
        row["predicted_uncertainty"] = expected.predicted.expanded_uncertainty
        row["expected_uncertainty"] = expected.at_end_U
    conditions = {key: value for key, value in dict(row["conditions"] or {}).items() if key != UNIT_TEMPERATURE}
    return {**row, "conditions": conditions, "titles": quantity_titles(analysis, str(row["quantity"]))}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def main(words: list[str]) -> int:
    """Entry point of the process: 0 for every session that can be read."""
    give_way(NICE)
    try:
        document = partial(Path(words[0]))
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return int(error.exit_status)
    sys.stdout.write(results_json(document))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
