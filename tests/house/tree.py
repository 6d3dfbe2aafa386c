"""What the house tests look at: the files of this repository, read once."""

from __future__ import annotations

import ast
import functools
import os
from collections.abc import Iterator
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
PRODUCT = ("bench", "instruments", "sim_instruments")
PACKAGES = (*PRODUCT, "benchmarks")
TEXT_SUFFIXES = {".py", ".yaml", ".md", ".toml", ".txt", ".in", ".j2", ".css", ".json", ".hex", ""}
_SKIP = {"__pycache__", "build", "dist", "sessions"}


def python_files(*folders: str) -> list[Path]:
    """All Python files below some top-level folders, sorted; the one-line backend module with the product."""
    found = [path for folder in folders for path in sorted((TOP / folder).rglob("*.py"))]
    return found + ([TOP / "pyvisa_bench.py"] if "bench" in folders else [])


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def name_of(path: Path) -> str:
    """A path as a test name: relative to the top."""
    return path.relative_to(TOP).as_posix()


def docstrings(tree: ast.Module) -> Iterator[ast.Constant]:
    """The docstring nodes of a module, its classes and functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                yield first.value


def imported(tree: ast.Module) -> Iterator[str]:
    """Full names of everything a module imports, with the members of ``from`` imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def text_files() -> Iterator[Path]:
    """Yield every text file that belongs to the repository, wherever it lies; what a build leaves is not entered."""
    for place, folders, names in os.walk(TOP):
        folders[:] = sorted(name for name in folders if name == ".ci" or not (name[0] == "." or _is_left_out(name)))
        paths = (Path(place, name) for name in sorted(names) if name != ".git")  # a file in a tree beside the first
        yield from (path for path in paths if path.suffix in TEXT_SUFFIXES and path.is_file())


def _is_left_out(folder: str) -> bool:
    return folder in _SKIP or folder.endswith(".egg-info")
