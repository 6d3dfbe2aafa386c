"""A session recorded by an earlier release is read, replayed, and gives the results it gave then."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from bench.analysis.results import validate_results
from bench.session.service import read_view
from bench.session.view import analyse_view, report_html

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "sessions"
SESSIONS = sorted(path.parent for path in GOLDEN.glob("*/*/session.0001.mcap"))
MOST_BYTES = 300_000
REL_TOL = 1e-9
LEFT_OUT = {"provenance", "notes"}  # they name the software and may say more than they did


def differences(stored: Any, found: Any, path: str = "") -> list[str]:
    """What was stored and is not found again; fields that are new are no difference."""
    if isinstance(stored, dict) and isinstance(found, dict):
        return [one for key in stored for one in differences(stored[key], found.get(key, "(absent)"), f"{path}.{key}")]
    if isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found):
        return [
            one for i, pair in enumerate(zip(stored, found, strict=True)) for one in differences(*pair, f"{path}[{i}]")
        ]
    numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in (stored, found))
    same = math.isclose(stored, found, rel_tol=REL_TOL, abs_tol=1e-300) if numbers else stored == found
    return [] if same else [f"{path}: {stored!r} != {found!r}"]


def test_there_is_one() -> None:
    assert SESSIONS


@pytest.mark.validates(
    "results of a recorded session, limit 1e-9",
    against="the results stored with it by release 0.1.0",
)
@pytest.mark.parametrize("folder", SESSIONS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_an_earlier_release_stays_readable(folder: Path) -> None:
    stored = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    validate_results(stored, str(folder))
    view = read_view(folder, strict=True)
    assert view.session_sha256 == stored["provenance"]["session_sha256"]
    results, analysis = analyse_view(view, stored["method"])
    kept = {name: value for name, value in stored.items() if name not in LEFT_OUT}
    assert differences(kept, results) == []
    assert "<html" in report_html(view, results, analysis)


@pytest.mark.parametrize("folder", SESSIONS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_golden_session_is_small(folder: Path) -> None:
    assert sum(path.stat().st_size for path in folder.iterdir()) < MOST_BYTES


def test_differences_are_found() -> None:
    assert differences({"a": [1.0]}, {"a": [1.0 + 1e-12], "b": 2}) == []
    assert differences({"a": [1.0]}, {"a": [1.0 + 1e-6]}) == [".a[0]: 1.0 != 1.000001"]
    assert differences({"a": [1.0]}, {"a": []}) == [".a: [1.0] != []"]
    assert differences({"a": "x"}, {}) == [".a: 'x' != '(absent)'"]
