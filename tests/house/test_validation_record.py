"""docs/validation.md names every test marked ``validates``, with what it is held against, and no other."""

from __future__ import annotations

import ast
import re

from tree import TOP, name_of, python_files, tree_of

RECORD = TOP / "docs" / "validation.md"
_ROW = re.compile(
    r"^\| (?P<what>[^|]+) \| (?P<against>[^|]+) \| (?P<figure>[^|]+) \| `(?P<test>[^`]+)` \|$", re.MULTILINE
)


def marked() -> dict[str, tuple[str, str]]:
    """Tests by path and name -> (what, against)."""
    found: dict[str, tuple[str, str]] = {}
    for path in python_files("tests"):
        for node in ast.walk(tree_of(path)):
            for mark in getattr(node, "decorator_list", ()):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.validates":
                    assert isinstance(node, ast.FunctionDef)
                    against = next(ast.literal_eval(word.value) for word in mark.keywords if word.arg == "against")
                    found[f"{name_of(path)}::{node.name}"] = (ast.literal_eval(mark.args[0]), against)
    return found


def recorded() -> dict[str, re.Match[str]]:
    return {row["test"]: row for row in _ROW.finditer(RECORD.read_text(encoding="utf-8"))}


def test_the_record_lists_the_marked_tests() -> None:
    listed = {test: (row["what"], row["against"]) for test, row in recorded().items()}
    assert listed == marked(), "run 'make validate'"


def test_nothing_in_the_record_has_failed_and_every_row_is_a_comparison() -> None:
    rows = recorded()
    assert len(rows) >= 70
    assert [test for test, row in rows.items() if "FAILED" in row["figure"]] == []
    assert [test for test, row in rows.items() if len(row["against"]) < 10] == []
