"""Nothing branches on the words of a message: what a reader must know is a field of its own.

Replies of instruments are formats of their manuals, so drivers and simulators may look into them.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest
from tree import name_of, python_files, tree_of

SPOKEN = {"message", "missing", "note", "reason", "said", "sentence", "text", "title", "what", "why", "words"}
BEGINS = {"startswith", "endswith", "removeprefix", "removesuffix"}
CUTS = {"split", "rsplit", "partition", "rpartition"}
FORMATS = {
    "bench/model/errors.py": "the stop at the end of a sentence",
    "bench/model/shipped.py": "the name of a file",
    "bench/model/yamlio.py": "pydantic begins its messages so",
    "bench/replay/delimited.py": "the text of a delimited file",
    "bench/report/batch/model.py": "what an analysis calls missing begins with its unit",
    "bench/systems/time_sync/figures.py": "the short form of a label",
    "bench/tui/now.py": "the text of an error begins with its code (docs/errors.md)",
    "bench/web/serving.py": "a message of uvicorn",
}
"""Files in which a text has a format that is documented, or comes from a library that gives nothing else."""


def prose_as_data(tree: ast.Module) -> Iterator[str]:
    """Every place that looks into a sentence."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _looks_into(node, node.func):
            yield f"{node.lineno} {ast.unparse(node)}"
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn) and _is_error(node):
            yield f"{node.lineno} {ast.unparse(node)}"


def _looks_into(call: ast.Call, method: ast.Attribute) -> bool:
    literals = [part.value for argument in call.args for part in ast.walk(argument) if isinstance(part, ast.Constant)]
    if method.attr in CUTS:
        return ": " in literals
    spoken = _name(method.value) in SPOKEN or any(
        isinstance(word, str) and " " in word.strip("\n") for word in literals
    )
    return method.attr in BEGINS and spoken


def _is_error(compared: ast.Compare) -> bool:
    """``"words" in str(error)`` or ``"words" in error.message``."""
    text = compared.comparators[0]
    if isinstance(text, ast.Call) and isinstance(text.func, ast.Name) and text.func.id == "str":
        return bool(text.args) and _name(text.args[0]) in {"error", "problem", "exception"}
    return isinstance(text, ast.Attribute) and text.attr == "message"


def _name(node: ast.expr) -> str:
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case ast.Subscript(slice=ast.Constant(value=str(name))):
            return name
    return ""


def test_nothing_branches_on_the_words_of_a_message() -> None:
    places = {name_of(path): list(prose_as_data(tree_of(path))) for path in python_files("bench")}
    assert {path: found for path, found in places.items() if found and path not in FORMATS} == {}
    assert [path for path in FORMATS if not places.get(path)] == [], "no longer needed"


@pytest.mark.parametrize(
    "line",
    [
        'any(word.startswith("counter") for word in how) or text.startswith("x")', 'key.startswith("stimulus ")',
        'text.split(": ")[1]', '"no answer" in str(error)', '"no answer" in error.message',
        'note.removeprefix(DAMAGED)',
    ],
)  # fmt: skip
def test_a_planted_place_is_found(line: str) -> None:
    assert list(prose_as_data(ast.parse(line)))
