"""Every module of the product, read once: size, seeds, processes, error codes.

Only files whose text holds what is looked for are parsed; the pattern lets none through that could break the rule.
"""

import ast
import gc
import re
from collections.abc import Iterator
from functools import cache

import pytest
from tree import (
    PACKAGES,
    PRODUCT,
    TOP,
    docstrings,
    files_that_say,
    name_of,
    nodes_of,
    python_files,
    text_of,
    tree_of,
)

from bench.commands.lookup import error_codes
from bench.model.errors import ExitStatus

MOST_LINES_FILE = 500
EVERY_FILE = python_files(*PACKAGES, "tests")
CODE = re.compile(r"B-[A-Z]+-\d{3}")
ERRORS = TOP / "bench" / "model" / "errors.json"


@pytest.fixture(scope="module", autouse=True)
def _without_collector() -> Iterator[None]:
    """The collector would look at millions of nodes again and again, none of which is garbage."""
    gc.disable()
    yield
    tree_of.cache_clear()
    nodes_of.cache_clear()
    gc.enable()


def test_files_are_small() -> None:
    lines = {name_of(path): len(text_of(path).splitlines()) for path in EVERY_FILE}
    assert {name: count for name, count in lines.items() if count > MOST_LINES_FILE} == {}


def test_no_generator_without_a_seed() -> None:
    """Other clocks and other chance are banned in pyproject.toml."""
    assert files_that_say(r"default_rng\(\)", *PACKAGES) == []


def commands(tree: ast.Module) -> list[list[str]]:
    """Return the words of every list or tuple that begins with the Python that runs."""
    return [
        [ast.unparse(word) for word in node.elts]
        for node in ast.walk(tree)
        if isinstance(node, ast.List | ast.Tuple) and node.elts and ast.unparse(node.elts[0]) == "sys.executable"
    ]


def test_own_processes_ignore_the_folder_they_start_in() -> None:
    places = files_that_say("sys.executable", *PRODUCT)
    every = {name_of(path): found for path in places if (found := commands(tree_of(path)))}
    assert set(every) == {"bench/model/posix.py", "bench/run/preflight/survey.py"}, "use bench.model.posix"
    assert {words[1] for found in every.values() for words in found} == {"'-P'"}


@cache
def raised() -> dict[str, str]:
    """Return the codes in the source and the file of each; what a docstring promises does not count."""
    found: dict[str, str] = {}
    for path in files_that_say(CODE.pattern, *PRODUCT):
        explained = {id(node) for node in docstrings(tree_of(path))}
        for node in nodes_of(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in explained:
                found |= {code: name_of(path) for code in CODE.findall(node.value)}
    return found


def listed() -> list[str]:
    """Return the codes of the table, row by row."""
    return re.findall(r'^  "(B-[^"]+)": ', text_of(ERRORS), re.MULTILINE)


def named_in_tests() -> set[str]:
    """Return the codes named in a test, or in a table of one."""
    own, tables = TOP / "tests" / "house", (TOP / "tests" / "unit").rglob("*.yaml")
    files = (path for path in (*python_files("tests"), *tables) if own not in path.parents)
    return {code for path in files for code in CODE.findall(text_of(path))}


def test_every_code_is_listed_once_and_tested() -> None:
    assert len(raised()) > 20
    assert listed() == sorted(raised())
    assert sorted(raised().keys() - named_in_tests()) == []


def test_rows_are_whole() -> None:
    rows = error_codes().values()
    assert {row["exit"] for row in rows} <= {status.value for status in ExitStatus}
    assert all(row.keys() == {"exit", "what", "next"} and row["what"] and row["next"] for row in rows)
