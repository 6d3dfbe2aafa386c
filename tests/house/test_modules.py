"""Every module of the product, read once: size, names, one clock, no chance, no prose as data, processes, error codes.

Only files whose text holds what is looked for are parsed; the pattern lets none through that could break the rule.
"""

from __future__ import annotations

import ast
import gc
import re
from collections.abc import Iterable, Iterator
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
from bench.model.processes import STARTED

MOST_LINES_FILE = 400
MOST_LINES_FUNCTION = 40
EVERY_FILE = python_files(*PACKAGES, "tests")
EMPTY_WORDS = {"data", "info", "util", "utils", "helper", "helpers", "manager", "misc"}
NEVER = EMPTY_WORDS - {"data", "info"}  # "data_end" of a container format says something, "data" does not
NAME_THAT_MAY = r"\b(data|info)\b|util|helper|manager|misc"
CLOCK = TOP / "bench" / "model" / "clock.py"
WATCHES = {"time", "sched"}
ASKS = {
    "time.time",
    "time.time_ns",
    "time.monotonic",
    "time.monotonic_ns",
    "time.perf_counter",
    "time.perf_counter_ns",
    "time.sleep",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "date.today",
    "asyncio.sleep",
    "trio.sleep",
}
CHANCE = {"random", "secrets", "uuid"}
SEEDED = {"", "default_rng", "Generator", "SeedSequence", "PCG64", "Philox", "SFC64"}
MAY_ASK = r"\btime\s*\.\s*(time|mono|perf|sleep)|\b(from|import) .*\btime\b|\b(sched|datetime|date|asyncio|trio)\b"
MAY_DRAW = r"\b(random|secrets|uuid|urandom)\b|default_rng"
SPOKEN = {"message", "missing", "note", "reason", "said", "sentence", "text", "title", "what", "why", "words"}
BEGINS = {"startswith", "endswith", "removeprefix", "removesuffix"}
CUTS = {"split", "rsplit", "partition", "rpartition"}
FORMATS = {
    "bench/model/errors.py": "the stop at the end of a sentence",
    "bench/model/shipped.py": "the name of a file",
    "bench/model/yamlio.py": "pydantic begins its messages so",
    "bench/replay/delimited.py": "the text of a delimited file",
    "bench/report/batch/model.py": "what an analysis calls missing begins with its unit",
    "bench/tui/page.py": "the text of an error begins with its code (docs/errors.md)",
    "bench/web/serving.py": "a message of uvicorn",
}
"""Files in which a text has a format that is documented, or comes from a library that gives nothing else."""
LOOKS_INTO = r"startswith|endswith|removeprefix|removesuffix|split|partition|in str\(|\.message"
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


# --- size --------------------------------------------------------------------------------------------------------


def test_files_are_small() -> None:
    lines = {name_of(path): len(text_of(path).splitlines()) for path in EVERY_FILE}
    assert {name: count for name, count in lines.items() if count > MOST_LINES_FILE} == {}


def test_functions_are_small() -> None:
    too_long = {
        f"{name_of(path)}:{node.lineno} {node.name}": lines
        for path in EVERY_FILE
        for node in _functions(tree_of(path).body)
        if (lines := _lines(node)) > MOST_LINES_FUNCTION
    }
    assert too_long == {}


def _functions(statements: Iterable[ast.AST]) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the functions among statements, and those inside of statements."""
    for statement in statements:
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            yield statement
        for block in ("body", "orelse", "finalbody", "handlers", "cases"):
            if isinstance(inside := getattr(statement, block, None), list):
                yield from _functions(inside)


def _lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return lines from ``def`` to the end, without the docstring: a long explanation is no long function."""
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
    """Return whether it is a docstring, an import, a dunder constant, or what imports later (PEP 562)."""
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    public = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("__")
    later = isinstance(node, ast.FunctionDef) and node.name in {"__getattr__", "__dir__"}
    return docstring or public or later or isinstance(node, ast.Import | ast.ImportFrom)


def test_the_measure_finds_a_long_function() -> None:
    body = "\n".join(f"    x = {n}" for n in range(MOST_LINES_FUNCTION))
    function = ast.parse(f'def f():\n    """One.\n\n    Two.\n    """\n{body}').body[0]
    assert isinstance(function, ast.FunctionDef)
    assert _lines(function) == MOST_LINES_FUNCTION + 1
    hidden = "try: pass\nexcept E:\n if x: pass\n else:\n  def f():\n   match x:\n    case 1:\n     def g(): pass"
    assert [found.name for found in _functions(ast.parse(hidden).body)] == ["f", "g"]
    assert not _hands_on(function)


# --- names -------------------------------------------------------------------------------------------------------


def says_nothing(name: str) -> bool:
    """Return whether a name is one of the empty words, or carries one that never says anything."""
    return name.lower() in EMPTY_WORDS or bool(words(name) & NEVER)


def words(name: str) -> set[str]:
    """Return the words of a snake_case or CamelCase name, in small letters."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def test_names_of_files_classes_and_functions() -> None:
    defined = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    wrong = []
    for path in files_that_say(NAME_THAT_MAY, *PACKAGES):
        names = [(node.name, node.lineno) for node in nodes_of(path) if isinstance(node, defined)]
        wrong += [f"{name_of(path)}:{line} {name}" for name, line in names if says_nothing(name)]
    wrong += [name_of(path) for path in python_files(*PACKAGES) if says_nothing(path.stem)]
    assert wrong == []


def test_names_of_variables() -> None:
    wrong = [
        f"{name_of(path)}:{node.lineno} {node.id}"
        for path in files_that_say(NAME_THAT_MAY, *PACKAGES)
        for node in nodes_of(path)
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


# --- time and chance ---------------------------------------------------------------------------------------------


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


def test_benchmarks_count_cpu_time_only() -> None:
    assert {
        name_of(path): found for path in files_that_say(MAY_ASK, "benchmarks") if (found := asks(nodes_of(path)))
    } == {}


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


# --- no prose as data --------------------------------------------------------------------------------------------


def prose_as_data(tree: ast.Module) -> Iterator[str]:
    """Yield every place that looks into a sentence."""
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
    """Return whether it is ``"words" in str(error)`` or ``"words" in error.message``."""
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
    places = {name_of(path): list(prose_as_data(tree_of(path))) for path in files_that_say(LOOKS_INTO, "bench")}
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


# --- processes ---------------------------------------------------------------------------------------------------


def commands(tree: ast.Module) -> list[list[str]]:
    """Return the words of every list or tuple that begins with the Python that runs."""
    return [
        [ast.unparse(word) for word in node.elts]
        for node in ast.walk(tree)
        if isinstance(node, ast.List | ast.Tuple) and node.elts and ast.unparse(node.elts[0]) == "sys.executable"
    ]


def test_own_processes_ignore_the_folder_they_start_in() -> None:
    every = {
        name_of(path): found
        for path in files_that_say("sys.executable", *PRODUCT)
        if (found := commands(tree_of(path)))
    }
    assert set(every) == {"bench/model/processes.py", "bench/run/preflight/of_bench.py"}, "use bench.model.processes"
    assert {name: words for name, found in every.items() for words in found if words[1] != "'-P'"} == {}


@pytest.mark.parametrize("module", STARTED)
def test_a_started_module_is_there_and_has_an_entry(module: str) -> None:
    path = TOP / module.replace(".", "/")
    source = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
    assert "__main__" in source.name or 'if __name__ == "__main__":' in text_of(source)


def test_the_search_finds_a_command() -> None:
    assert commands(ast.parse("x = [sys.executable, '-m', 'bench']")) == [["sys.executable", "'-m'", "'bench'"]]


# --- error codes -------------------------------------------------------------------------------------------------


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
    """Return the codes named in a test."""
    own = TOP / "tests" / "house"
    return {code for path in python_files("tests") if own not in path.parents for code in CODE.findall(text_of(path))}


def test_there_are_codes() -> None:
    assert len(raised()) > 20


def test_codes_are_listed() -> None:
    known = set(listed())
    assert {code: path for code, path in raised().items() if code not in known} == {}


def test_codes_are_tested() -> None:
    named = named_in_tests()
    assert {code: path for code, path in raised().items() if code not in named} == {}


def test_the_list_names_no_other_code_and_none_twice() -> None:
    assert sorted(listed()) == sorted(set(listed()))
    assert set(listed()) - set(raised()) == set()


def test_rows_are_whole() -> None:
    rows = [line for line in text_of(ERRORS).splitlines() if line.startswith("| B-")]
    assert rows
    for line in rows:
        match = ROW.fullmatch(line)
        assert match is not None, line
        assert int(match[2]) in {status.value for status in ExitStatus}, line
