"""Only the clock asks the time or sleeps, and nothing is random without a seeded generator."""

from __future__ import annotations

import ast

from tree import PACKAGES, PRODUCT, TOP, imported, name_of, python_files, tree_of

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


def asks(tree: ast.Module) -> set[str]:
    """Names of calls that ask the time or sleep, wherever they are called from."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ".".join(ast.unparse(node.func).rsplit(".", 2)[-2:])
            found |= {name} & ASKS
    return found


def test_product_has_one_clock() -> None:
    wrong = {}
    for path in python_files(*PRODUCT):
        modules = {name.split(".")[0] for name in imported(tree_of(path))}
        if path != CLOCK and (found := (modules & WATCHES) | asks(tree_of(path))):
            wrong[name_of(path)] = found
    assert wrong == {}, "ask the Clock that is handed in"


def test_benchmarks_count_cpu_time_only() -> None:
    assert {name_of(path): found for path in python_files("benchmarks") if (found := asks(tree_of(path)))} == {}


def chances(tree: ast.Module) -> set[str]:
    """Imports and calls that bring chance without a seed."""
    found = {name.split(".")[0] for name in imported(tree)} & CHANCE
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            call = ast.unparse(node.func)
            drawn = call.split("random.")[-1] if ".random." in f".{call}" else ""
            if drawn not in SEEDED or call == "os.urandom" or (call.endswith("default_rng") and not node.args):
                found.add(f"{call} in line {node.lineno}")
    return found


def test_no_chance_without_a_seed() -> None:
    drawn = {name_of(path): found for path in python_files(*PACKAGES) if (found := chances(tree_of(path)))}
    assert drawn == {"bench/web/security/tokens.py": {"secrets"}}, "nobody may guess a token; everything else is seeded"


def test_the_search_finds_what_it_forbids() -> None:
    tree = ast.parse("import time, datetime\nx = time.sleep(1)\ny = datetime.datetime.now()\nz = task.sleep(2)")
    assert asks(tree) == {"time.sleep", "datetime.now"}
    unseeded = ast.parse("import random\na = np.random.default_rng()\nb = np.random.normal()\nc = rng.normal()")
    assert chances(unseeded) == {"random", "np.random.default_rng in line 2", "np.random.normal in line 3"}
