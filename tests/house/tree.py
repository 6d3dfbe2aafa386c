"""What the house tests look at: the files of this repository, read once."""

import ast
import functools
import os
import re
from collections.abc import Iterator
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
PRODUCT = ("bench", "instruments", "sim_instruments")
PACKAGES = (*PRODUCT, "benchmarks")
TEXT_SUFFIXES = {".py", ".yaml", ".md", ".toml", ".txt", ".in", ".j2", ".css", ".json", ".hex", ""}
_WITH_BODY = (ast.stmt, ast.excepthandler, ast.match_case)
_SKIP = {"__pycache__", "build", "dist", "sessions"}


@functools.cache
def python_files(*folders: str) -> list[Path]:
    """Return all Python files below some top-level folders, sorted; the one-line backend module with the product."""
    found = [path for folder in folders for path in sorted((TOP / folder).rglob("*.py"))]
    return found + ([TOP / "pyvisa_bench.py"] if "bench" in folders else [])


def files_that_say(pattern: str, *folders: str) -> list[Path]:
    """Return the Python files whose text matches somewhere: only these need to be parsed for what is looked for."""
    search = re.compile(pattern, re.IGNORECASE).search
    return [path for path in python_files(*folders) if search(text_of(path))]


@functools.cache
def text_of(path: Path) -> str:
    """Return the text of a file."""
    return path.read_text(encoding="utf-8")


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(text_of(path), str(path))


@functools.cache
def nodes_of(path: Path) -> list[ast.AST]:
    """Return all nodes of the syntax tree of a file."""
    return list(ast.walk(tree_of(path)))


def name_of(path: Path) -> str:
    """Return a path as a test name: relative to the top."""
    return path.relative_to(TOP).as_posix()


def module_of(path: Path) -> str:
    """Return the dotted name of a file of the product."""
    return ".".join(path.relative_to(TOP).with_suffix("").parts).removesuffix(".__init__")


def docstrings(tree: ast.Module) -> Iterator[ast.Constant]:
    """Yield the docstring nodes of a module, its classes and functions."""
    nodes: list[ast.AST] = [tree]
    for node in nodes:  # which grows; no expression holds one
        nodes += [one for one in ast.iter_child_nodes(node) if isinstance(one, _WITH_BODY)]
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                yield first.value


def imported(tree: ast.Module) -> Iterator[str]:
    """Yield full names of everything a module imports, with the members of ``from`` imports."""
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
