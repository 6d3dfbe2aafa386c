"""Every row of the fault matrix names tests that exist, and make targets that run them."""

from __future__ import annotations

import ast
import re

import pytest
from tree import TOP, tree_of

MATRIX = TOP / "docs" / "faults.md"
TEST = re.compile(r"`(tests/[a-z_0-9/]+\.py)::(test_\w+)`")
IN_CI = {1, 8, 10, 12, 13, 14, 15, 16, 20, 21, 22, 23, 24, 25, 28}
ROWS = 29


def rows() -> dict[int, list[str]]:
    found = {}
    for line in MATRIX.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|") and cells[0].isdigit():
            found[int(cells[0])] = cells
    return found


def marks(path: str, name: str) -> set[str]:
    """Marks on a test function itself; parameters may have marks of their own."""
    for node in tree_of(TOP / path).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return {ast.unparse(mark).removeprefix("pytest.mark.").split("(")[0] for mark in node.decorator_list}
    raise AssertionError(f"{path} has no test {name}")


def test_every_row_is_there() -> None:
    assert sorted(rows()) == list(range(1, ROWS + 1))
    assert {len(cells) for cells in rows().values()} == {8}


@pytest.mark.parametrize("number", range(1, ROWS + 1))
def test_row_names_its_tests(number: int) -> None:
    *_, in_ci, in_sweep, target = rows()[number]
    named = TEST.findall(in_ci)
    assert named
    assert not [name for path, name in named if "sweep" in marks(path, name)]
    for path, name in TEST.findall(in_sweep):
        marks(path, name)
    assert bool(in_sweep) == bool(target)


def test_the_rows_that_a_change_must_pass_have_a_short_form() -> None:
    assert {number for number, cells in rows().items() if TEST.findall(cells[5])} >= IN_CI


def test_targets_exist() -> None:
    makefile = (TOP / "Makefile").read_text(encoding="utf-8")
    targets = {cells[7].strip("`") for cells in rows().values() if cells[7]}
    assert targets
    assert [target for target in targets if f"\n{target}:" not in makefile] == []
