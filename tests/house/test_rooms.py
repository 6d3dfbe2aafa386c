"""Rooms: no folder that nobody can overlook, and a package with a face is imported through it."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tree import PRODUCT, TOP, name_of, python_files, tree_of

MOST_FILES = 30
SIBLINGS = {"instruments", "sim_instruments", "tests/protocol"}  # one model each


def flat_folders(files: list[Path]) -> dict[str, int]:
    """Return folders that hold too many files, with their number."""
    counts = Counter(name_of(path.parent) for path in files)
    return {name: count for name, count in counts.items() if count > MOST_FILES and name not in SIBLINGS}


def test_no_flat_folder() -> None:
    assert flat_folders(python_files(*PRODUCT, "tests")) == {}, "build rooms: folders that say what is done there"


def test_the_measure_finds_a_flat_folder() -> None:
    assert flat_folders([TOP / "bench" / "plan" / f"part_{n}.py" for n in range(31)]) == {"bench/plan": 31}


def faces() -> set[str]:
    """Return the packages whose ``__init__`` hands names on (``__all__``)."""
    found = set()
    for path in python_files(*PRODUCT):
        if path.name == "__init__.py" and "__all__" in path.read_text(encoding="utf-8"):
            found.add(".".join(path.parent.relative_to(TOP).parts))
    return found


def imports(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield modules that are imported from, with the line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module, node.lineno


def past_a_face(module: str, tree: ast.Module, packages: set[str]) -> list[str]:
    """Return imports of modules that lie behind the face of a package the importer is not in."""
    return [
        f"{line} {target}"
        for target, line in imports(tree)
        for package in packages
        if target.startswith(f"{package}.") and not f"{module}.".startswith(f"{package}.")
    ]


def test_no_import_past_a_face() -> None:
    packages = faces()
    assert {"bench.record", "bench.frame", "bench.store"} <= packages
    wrong = {}
    for path in python_files(*PRODUCT):
        module = ".".join(path.relative_to(TOP).with_suffix("").parts).removesuffix(".__init__")
        if found := past_a_face(module, tree_of(path), packages):
            wrong[name_of(path)] = found
    assert wrong == {}, "import from the package, and let its __init__ hand the name on"


def test_the_search_finds_an_import_past_a_face() -> None:
    tree = ast.parse("from bench.record.layout import Message")
    assert past_a_face("bench.run.session", tree, {"bench.record"}) == ["1 bench.record.layout"]
    assert past_a_face("bench.record.writer", tree, {"bench.record"}) == []
