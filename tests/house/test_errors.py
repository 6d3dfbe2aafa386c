"""Every error code is listed in docs/errors.md with its meaning, and is named by a test that triggers it."""

from __future__ import annotations

import ast
import functools
import re

from tree import PRODUCT, TOP, docstrings, name_of, python_files, tree_of

from bench.model.errors import ExitStatus

CODE = re.compile(r"B-[A-Z]+-\d{3}")
ROW = re.compile(r"\| (B-[A-Z]+-\d{3}) \| (\d+) \| (.+?) \| (.+?) \|")
PAGE = TOP / "docs" / "errors.md"


@functools.cache
def raised() -> dict[str, str]:
    """Return the codes in the source and the file of each; what a docstring promises does not count."""
    found: dict[str, str] = {}
    for path in python_files(*PRODUCT):
        if not CODE.search(path.read_text("utf-8")):
            continue
        explained = {id(node) for node in docstrings(tree_of(path))}
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in explained:
                found |= {code: name_of(path) for code in CODE.findall(node.value)}
    return found


def listed() -> list[str]:
    """Codes of the table, row by row."""
    return [match[1] for line in PAGE.read_text(encoding="utf-8").splitlines() if (match := ROW.fullmatch(line))]


def named_in_tests() -> set[str]:
    """Codes named in a test."""
    own = TOP / "tests" / "house"
    return {
        code
        for path in python_files("tests")
        if own not in path.parents
        for code in CODE.findall(path.read_text("utf-8"))
    }


def test_there_are_codes() -> None:
    assert len(raised()) > 20


def test_codes_are_listed() -> None:
    assert {code: path for code, path in raised().items() if code not in listed()} == {}


def test_codes_are_tested() -> None:
    named = named_in_tests()
    assert {code: path for code, path in raised().items() if code not in named} == {}


def test_the_list_names_no_other_code_and_none_twice() -> None:
    assert sorted(listed()) == sorted(set(listed()))
    assert set(listed()) - set(raised()) == set()


def test_rows_are_whole() -> None:
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| B-")]
    assert rows
    for line in rows:
        match = ROW.fullmatch(line)
        assert match is not None, line
        assert int(match[2]) in {status.value for status in ExitStatus}, line
