"""Every module of the product, read once: size, one clock, no chance, processes, error codes.

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
    imported,
    name_of,
    nodes_of,
    python_files,
    text_of,
    tree_of,
)

from bench.model.errors import ExitStatus

MOST_LINES_FILE = 500
EVERY_FILE = python_files(*PACKAGES, "tests")
CLOCK = TOP / "bench" / "model" / "clock.py"
WATCHES = {"time", "sched"}
ASKS = {f"time.{name}" for name in ("sleep", "time", "monotonic", "perf_counter")}
ASKS |= {f"{name}_ns" for name in ASKS} | {"datetime.now", "datetime.utcnow", "datetime.today", "date.today"}
ASKS |= {"asyncio.sleep", "trio.sleep"}
CHANCE = {"random", "secrets", "uuid"}
SEEDED = {"", "default_rng", "Generator", "SeedSequence", "PCG64", "Philox", "SFC64"}
MAY_ASK = r"\btime\s*\.\s*(time|mono|perf|sleep)|\b(from|import) .*\btime\b|\b(sched|datetime|date|asyncio|trio)\b"
MAY_DRAW = r"\b(random|secrets|uuid|urandom)\b|default_rng"
CODE = re.compile(r"B-[A-Z]+-\d{3}")
ROW = re.compile(r"\| (B-[A-Z]+-\d{3}) \| (\d+) \| (.+?) \| (.+?) \|")
ERRORS = TOP / "docs" / "errors.md"


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


def asks(nodes: list[ast.AST]) -> set[str]:
    """Return names of calls that ask the time or sleep, wherever they are called from."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Call):
            name = ".".join(ast.unparse(node.func).rsplit(".", 2)[-2:])
            found |= {name} & ASKS
    return found


def test_product_has_one_clock() -> None:
    wrong = {}
    for path in files_that_say(MAY_ASK, *PRODUCT):
        modules = {name.split(".")[0] for name in imported(tree_of(path))}
        if path != CLOCK and (found := (modules & WATCHES) | asks(nodes_of(path))):
            wrong[name_of(path)] = found
    assert wrong == {}, "ask the Clock that is handed in"


def chances(tree: ast.Module) -> set[str]:
    """Return imports and calls that bring chance without a seed."""
    found = {name.split(".")[0] for name in imported(tree)} & CHANCE
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            call = ast.unparse(node.func)
            drawn = call.split("random.")[-1] if ".random." in f".{call}" else ""
            if drawn not in SEEDED or call == "os.urandom" or (call.endswith("default_rng") and not node.args):
                found.add(f"{call} in line {node.lineno}")
    return found


def test_no_chance_without_a_seed() -> None:
    drawn = {name_of(path): found for path in files_that_say(MAY_DRAW, *PACKAGES) if (found := chances(tree_of(path)))}
    assert drawn == {"bench/web/security/tokens.py": {"secrets"}}, "nobody may guess a token; everything else is seeded"


def test_the_search_finds_what_it_forbids() -> None:
    tree = ast.parse("import time, datetime\nx = time.sleep(1)\ny = datetime.datetime.now()\nz = task.sleep(2)")
    assert asks(list(ast.walk(tree))) == {"time.sleep", "datetime.now"}
    unseeded = ast.parse("import random\na = np.random.default_rng()\nb = np.random.normal()\nc = rng.normal()")
    assert chances(unseeded) == {"random", "np.random.default_rng in line 2", "np.random.normal in line 3"}


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
    assert set(every) == {"bench/model/posix.py", "bench/run/preflight/of_bench.py"}, "use bench.model.posix"
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
    return [match[1] for line in text_of(ERRORS).splitlines() if (match := ROW.fullmatch(line))]


def named_in_tests() -> set[str]:
    """Return the codes named in a test, or in a table of one."""
    own, tables = TOP / "tests" / "house", (TOP / "tests" / "unit").rglob("*.yaml")
    files = (path for path in (*python_files("tests"), *tables) if own not in path.parents)
    return {code for path in files for code in CODE.findall(text_of(path))}


def test_every_code_is_listed_once_and_tested() -> None:
    assert len(raised()) > 20
    assert sorted(listed()) == sorted(raised())
    assert sorted(raised().keys() - named_in_tests()) == []


def test_rows_are_whole() -> None:
    rows = [ROW.fullmatch(line) for line in text_of(ERRORS).splitlines() if line.startswith("| B-")]
    assert {int(row[2]) if row else None for row in rows} <= {status.value for status in ExitStatus}
