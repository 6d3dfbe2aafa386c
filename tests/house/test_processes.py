"""A process of the bench's own takes no module from the folder it happens to be started in."""

from __future__ import annotations

import ast

import pytest
from tree import PRODUCT, TOP, name_of, python_files, tree_of

from bench.model.processes import STARTED


def commands(tree: ast.Module) -> list[list[str]]:
    """Words of every list or tuple that begins with the Python that runs."""
    return [
        [ast.unparse(word) for word in node.elts]
        for node in ast.walk(tree)
        if isinstance(node, ast.List | ast.Tuple) and node.elts and ast.unparse(node.elts[0]) == "sys.executable"
    ]


def test_own_processes_ignore_the_folder_they_start_in() -> None:
    every = {name_of(path): found for path in python_files(*PRODUCT) if (found := commands(tree_of(path)))}
    assert set(every) == {"bench/model/processes.py", "bench/run/preflight/of_bench.py"}, "use bench.model.processes"
    assert {name: words for name, found in every.items() for words in found if words[1] != "'-P'"} == {}


@pytest.mark.parametrize("module", STARTED)
def test_a_started_module_is_there_and_has_an_entry(module: str) -> None:
    path = TOP / module.replace(".", "/")
    source = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
    assert "__main__" in source.name or 'if __name__ == "__main__":' in source.read_text(encoding="utf-8")


def test_the_search_finds_a_command() -> None:
    assert commands(ast.parse("x = [sys.executable, '-m', 'bench']")) == [["sys.executable", "'-m'", "'bench'"]]
