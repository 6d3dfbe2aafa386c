"""Names say what a thing is: no data, info, util, helper, manager, misc; decisions are numbered pages."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from tree import PACKAGES, TOP, name_of, python_files, tree_of

EMPTY_WORDS = {"data", "info", "util", "utils", "helper", "helpers", "manager", "misc"}
NEVER = EMPTY_WORDS - {"data", "info"}  # "data_end" of a container format says something, "data" does not
DECISIONS = sorted((TOP / "docs" / "decisions").glob("*"))


def says_nothing(name: str) -> bool:
    """True for a name that is one of the empty words, or carries one that never says anything."""
    return name.lower() in EMPTY_WORDS or bool(words(name) & NEVER)


def words(name: str) -> set[str]:
    """The words of a snake_case or CamelCase name, in small letters."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def test_names_of_files_classes_and_functions() -> None:
    defined = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    wrong = []
    for path in python_files(*PACKAGES):
        names = [(node.name, node.lineno) for node in ast.walk(tree_of(path)) if isinstance(node, defined)]
        wrong += [f"{name_of(path)}:{line} {name}" for name, line in names if says_nothing(name)]
        wrong += [name_of(path)] if says_nothing(path.stem) else []
    assert wrong == []


def test_names_of_variables() -> None:
    wrong = [
        f"{name_of(path)}:{node.lineno} {node.id}"
        for path in python_files(*PACKAGES)
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id.lower() in EMPTY_WORDS
    ]
    assert wrong == []


def test_words_of_a_name() -> None:
    assert words("DataManager") == {"data", "manager"}
    assert words("file_utils") == {"file", "utils"}
    assert says_nothing("data")
    assert says_nothing("DataManager")
    assert not says_nothing("database_information")
    assert not says_nothing("data_end_crc")


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
