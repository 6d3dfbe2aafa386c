"""Pages: links lead somewhere, decisions are numbered, and what a page says of tests is so."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from tree import TOP, files_that_say, name_of, text_of, tree_of

LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
PAGES = [TOP / "README.md", TOP / "CHANGELOG.md", *sorted((TOP / "docs").rglob("*.md"))]
DECISIONS = sorted((TOP / "docs" / "decisions").glob("*"))
MATRIX = TOP / "docs" / "faults.md"
TEST = re.compile(r"`(tests/[a-z_0-9/]+\.py)::(test_\w+)`")
IN_CI = {1, 8, 10, 12, 13, 14, 15, 16, 20, 21, 22, 23, 24, 25, 28, 30}
ROWS = 30
RECORD = TOP / "docs" / "validation.md"
_ROW = re.compile(
    r"^\| (?P<what>[^|]+) \| (?P<against>[^|]+) \| (?P<figure>[^|]+) \| `(?P<test>[^`]+)` \|$", re.MULTILINE
)

# --- links and decisions -----------------------------------------------------------------------------------------


def test_links_lead_somewhere() -> None:
    broken = [
        f"{name_of(page)}: {target}"
        for page in PAGES
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert broken == []


def test_every_page_of_the_docs_is_in_its_index() -> None:
    index = LINK.findall((TOP / "docs" / "README.md").read_text(encoding="utf-8"))
    pages = {page.name for page in (TOP / "docs").glob("*.md")} - {"README.md"}
    assert pages - set(index) == set()


@pytest.mark.parametrize("path", DECISIONS, ids=lambda path: path.name)
def test_a_decision_is_a_numbered_page(path: Path) -> None:
    assert re.fullmatch(r"\d{4}-[a-z0-9-]+\.md", path.name)
    headings = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert headings[0].startswith("# ")
    text = " ".join(headings).lower()
    assert all(word in text for word in ("context", "decision", "consequence")), headings


def test_decision_numbers_are_unique() -> None:
    numbers = [path.name[:4] for path in DECISIONS]
    assert len(numbers) == len(set(numbers))
    assert "0001" in numbers


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


def test_every_row_is_there() -> None:
    assert sorted(fault_rows()) == list(range(1, ROWS + 1))
    assert {len(cells) for cells in fault_rows().values()} == {8}


@pytest.mark.parametrize("number", range(1, ROWS + 1))
def test_row_names_its_tests(number: int) -> None:
    *_, in_ci, in_sweep, target = fault_rows()[number]
    named = TEST.findall(in_ci)
    assert named
    assert not [name for path, name in named if "sweep" in marks(path, name)]
    for path, name in TEST.findall(in_sweep):
        marks(path, name)
    assert bool(in_sweep) == bool(target)


def test_the_rows_that_a_change_must_pass_have_a_short_form() -> None:
    assert {number for number, cells in fault_rows().items() if TEST.findall(cells[5])} >= IN_CI


def test_targets_exist() -> None:
    makefile = (TOP / "Makefile").read_text(encoding="utf-8")
    targets = {cells[7].strip("`") for cells in fault_rows().values() if cells[7]}
    assert targets
    assert [target for target in targets if f"\n{target}:" not in makefile] == []


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
