"""Small files, small functions, and __init__ files that only hand names on."""

from __future__ import annotations

import ast

from tree import PACKAGES, name_of, python_files, tree_of

MOST_LINES_FILE = 400
MOST_LINES_FUNCTION = 40

EVERY_FILE = python_files(*PACKAGES, "tests")


def test_files_are_small() -> None:
    lines = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in EVERY_FILE}
    assert {name: count for name, count in lines.items() if count > MOST_LINES_FILE} == {}


def test_functions_are_small() -> None:
    too_long = {
        f"{name_of(path)}:{node.lineno} {node.name}": lines
        for path in EVERY_FILE
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (lines := _lines(node)) > MOST_LINES_FUNCTION
    }
    assert too_long == {}


def _lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines from ``def`` to the end, without the docstring: a long explanation is no long function."""
    total = (function.end_lineno or function.lineno) - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function) is not None:
        total -= (first.end_lineno or first.lineno) - first.lineno + 1
    return total


def test_init_files_only_hand_names_on() -> None:
    wrong = [
        f"{name_of(path)}:{node.lineno}"
        for path in python_files(*PACKAGES)
        if path.name == "__init__.py"
        for node in tree_of(path).body
        if not _hands_on(node)
    ]
    assert wrong == []


def _hands_on(node: ast.stmt) -> bool:
    """A docstring, an import, ``__all__`` or another dunder constant."""
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    public = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("__")
    return docstring or public or isinstance(node, ast.Import | ast.ImportFrom)


def test_the_measure_finds_a_long_function() -> None:
    body = "\n".join(f"    x = {n}" for n in range(MOST_LINES_FUNCTION))
    function = ast.parse(f'def f():\n    """One.\n\n    Two.\n    """\n{body}').body[0]
    assert isinstance(function, ast.FunctionDef)
    assert _lines(function) == MOST_LINES_FUNCTION + 1
    assert not _hands_on(function)
