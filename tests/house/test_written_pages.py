"""Pages: links lead somewhere, and what a page says of tests is so."""

from __future__ import annotations

import ast
import re

import pytest
from tree import TOP, files_that_say, name_of, text_of, tree_of

LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
PAGES = [TOP / "README.md", TOP / "CHANGELOG.md", *sorted((TOP / "docs").rglob("*.md"))]
MATRIX = TOP / "docs" / "faults.md"
TEST = re.compile(r"`(tests/[a-z_0-9/]+\.py)::(test_\w+)`")
ROWS = 30
RECORD = TOP / "docs" / "validation.md"
_ROW = re.compile(
    r"^\| (?P<what>[^|]+) \| (?P<against>[^|]+) \| (?P<figure>[^|]+) \| `(?P<test>[^`]+)` \|$", re.MULTILINE
)

# --- links -------------------------------------------------------------------------------------------------------


def test_links_lead_somewhere() -> None:
    broken = [
        f"{name_of(page)}: {target}"
        for page in PAGES
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert broken == []


# --- fault matrix ------------------------------------------------------------------------------------------------


def fault_rows() -> dict[int, list[str]]:
    found = {}
    for line in text_of(MATRIX).splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|") and cells[0].isdigit():
            found[int(cells[0])] = cells
    return found


def marks(path: str, name: str) -> set[str]:
    """Return the marks on a test function itself; parameters may have marks of their own."""
    for node in tree_of(TOP / path).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return {ast.unparse(mark).removeprefix("pytest.mark.").split("(")[0] for mark in node.decorator_list}
    raise AssertionError(f"{path} has no test {name}")


@pytest.mark.parametrize("number", range(1, ROWS + 1))
def test_row_names_its_tests_and_its_target(number: int) -> None:
    *_, in_ci, in_sweep, target = fault_rows()[number]
    named = TEST.findall(in_ci)
    assert named
    assert not [name for path, name in named if "sweep" in marks(path, name)]
    for path, name in TEST.findall(in_sweep):
        marks(path, name)
    assert bool(in_sweep) == bool(target)
    assert not target or f"\n{target.strip('`')}:" in text_of(TOP / "Makefile")


# --- validation record -------------------------------------------------------------------------------------------


def marked() -> dict[str, tuple[str, str]]:
    """Return the marked tests by path and name -> (what, against)."""
    found: dict[str, tuple[str, str]] = {}
    for path in files_that_say(r"pytest\.mark\.validates", "tests"):
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
