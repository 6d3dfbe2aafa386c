"""Draw mutants of a room and say how many no test sees: ``make survivors ROOM=bench/maths``, also ``SEED=`` and ``N=``.

The mutants are those of cosmic-ray (extra ``mutation``), applied in a copy of the tree. The tests of a mutant are the
nearest: files of tests that import its module, then those of the room, as many as take ``BUDGET_S`` of CPU without it;
so one that comes to ``LONGEST_S`` is the mutant's doing. Rows are added to ``survivors.csv``.
"""

import argparse
import ast
import csv
import math
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

TOP = Path(__file__).resolve().parents[2]
ROWS = Path(__file__).with_name("survivors.csv")
COLUMNS = ("revision", "room", "seed", "place", "operator", "fate", "cpu_s")
LEFT_OUT = ("__pycache__", ".*_cache", "*.egg-info")
NOT_AT_THE_TOP = (".git", ".venv*", "build", "dist", "sessions")
LONGEST_S = 60  # of CPU for one mutant
BUDGET_S = 40.0  # of it for the tests without a mutant: a slower machine or a cold cache needs some more
NOTHING_COLLECTED = 5  # exit status of pytest: all tests of a file wait or are sweeps
WAITS = 10  # a mutant that waits for ever uses no CPU: so many times the CPU it may use on the clock
Span = tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True)
class Mutant:
    """One change: the operator of cosmic-ray and at which of its places in the file, counted from 0."""

    file: str
    line: int
    operator: str
    occurrence: int

    def text(self, plain: str) -> str:
        """Return the text of the file with the change. Raises: ValueError if it changes nothing."""
        from cosmic_ray.mutating import mutate_code
        from cosmic_ray.plugins import get_operator

        mutated: str | None = mutate_code(plain, get_operator(self.operator)(), self.occurrence)
        if mutated is None:
            raise ValueError(f"{self.file}:{self.line}: {self.operator} changes nothing")
        return mutated


def annotations(text: str) -> list[Span]:
    """Return where annotations of types begin and end (line, column): nothing executes them."""
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.AnnAssign | ast.arg):
            found.append(node.annotation)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.append(node.returns)
    return [
        ((node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0))
        for node in found
        if node is not None
    ]


def mutants_of(file: str, text: str) -> dict[Span, list[Mutant]]:
    """Return the mutants of a file by the place that they change, so that a place with many is drawn no more often."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    ignored, tree = annotations(text), get_ast(text)
    places: dict[Span, list[Mutant]] = {}
    for name in sorted(operator_names()):
        if get_operator(name).arguments():  # it wants names of variables
            continue
        operator = get_operator(name)()
        spans = (span for node in ast_nodes(tree) for span in operator.mutation_positions(node))
        for occurrence, (start, stop) in enumerate(spans):
            if not any(first <= start and stop <= last for first, last in ignored):
                places.setdefault((start, stop), []).append(Mutant(file, start[0], name, occurrence))
    return places


def drawn(room: Path, count: int, seed: int) -> list[Mutant]:
    """Return mutants of the files below a folder, one at each of ``count`` places that a seed draws."""
    rng = random.Random(seed)
    places = [
        mutants
        for path in sorted(room.rglob("*.py"))
        for _, mutants in sorted(mutants_of(path.relative_to(TOP).as_posix(), path.read_text(encoding="utf-8")).items())
    ]
    return [rng.choice(mutants) for mutants in rng.sample(places, min(count, len(places)))]


def beside(room: str) -> tuple[str, ...]:
    """Return the folders of the tests of a room; those of drivers and of their simulators see both."""
    if room in ("instruments", "sim_instruments"):
        return ("tests/unit/instruments/", "tests/unit/sim_instruments/", "tests/protocol/")
    return (f"tests/unit/{room.removeprefix('bench/')}/",)


def nearest(mutant: Mutant, room: str, tests: dict[str, str]) -> list[str]:
    """Return the files among ``tests`` (name: text) of the module of a mutant, then those of its room.

    A test of a module imports it or names the driver that it holds.
    """
    module = mutant.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    package, _, name = module.rpartition(".")
    driver = rf'|"{re.escape(name)}"' if package in ("instruments", "sim_instruments") else ""
    own = re.compile(rf"\b{re.escape(module)}\b|from {re.escape(package)} import [^\n]*\b{name}\b{driver}")
    any_of_room = re.compile(rf"\b{re.escape(room.replace('/', '.'))}\b")
    ranks = {
        test: 0 if own.search(text) else 1 if test.startswith(beside(room)) else 2 if any_of_room.search(text) else 3
        for test, text in sorted(tests.items())
    }
    return sorted((test for test, rank in ranks.items() if rank < 3), key=lambda test: ranks[test])


def wilson(count: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """Return the 95 % interval of a rate. Source: Wilson, J. Am. Stat. Assoc. 22 (1927) 209."""
    if total == 0:
        return 0.0, 1.0
    rate, scale = count / total, 1.0 + z * z / total
    middle = (rate + z * z / (2 * total)) / scale
    half = z / scale * math.sqrt(rate * (1.0 - rate) / total + z * z / (4 * total * total))
    return max(0.0, middle - half), min(1.0, middle + half)


def cpu_s() -> float:
    """Return the CPU that all processes have taken which were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def left_out(folder: str, names: list[str]) -> set[str]:
    """Return what is not copied of a folder: what tools leave there, and at the top what was built or recorded."""
    patterns = (*LEFT_OUT, *NOT_AT_THE_TOP) if Path(folder) == TOP else LEFT_OUT
    return shutil.ignore_patterns(*patterns)(folder, names)


class Copy:
    """A copy of the tree in which mutants are tried."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(TOP, folder, ignore=left_out, ignore_dangling_symlinks=True)
        self._cost_s: dict[str, float] = {}

    def tests(self, room: str) -> dict[str, str]:
        """Return the texts of all files of tests that could be near a room."""
        paths = (
            path
            for path in sorted(self.folder.glob("tests/**/test_*.py"))
            if not {"browser", "mutants"} & set(path.parts)
        )
        texts = {path.relative_to(self.folder).as_posix(): path.read_text(encoding="utf-8") for path in paths}
        stem = room.replace("/", ".")
        return {name: text for name, text in texts.items() if stem in text or name.startswith(beside(room))}

    def chosen(self, tests: Sequence[str]) -> list[str]:
        """Return the first of these files that together stay in the budget; at half of it no more are looked at."""
        chosen, spent_s = [], 0.0
        for test in tests:
            if spent_s > 0.5 * BUDGET_S:
                break
            if test not in self._cost_s:
                self._cost_s[test] = self._measured(test)
            if spent_s + self._cost_s[test] <= BUDGET_S:
                chosen.append(test)
                spent_s += self._cost_s[test]
        return chosen

    def _measured(self, test: str) -> float:
        """Return the CPU that a file of tests takes without a mutant, infinite if it fails or takes too much."""
        before_s = cpu_s()
        status = self._pytest([test], BUDGET_S)
        if status not in (0, None, NOTHING_COLLECTED):
            print(f"left out, it fails without a mutant: {test}")
        return cpu_s() - before_s if status == 0 else math.inf

    def fate(self, mutant: Mutant, tests: Sequence[str]) -> str:
        """Return what became of a mutant: killed, survived, timed out, no test where none is near, or not made."""
        if not tests:
            return "no test"
        path = self.folder / mutant.file
        plain = path.read_text(encoding="utf-8")
        try:
            path.write_text(mutant.text(plain), encoding="utf-8")
            status = self._pytest(["-x", *tests], LONGEST_S)
        except AttributeError:  # cosmic-ray does not replace an exception whose name has dots
            return "not made"
        finally:
            path.write_text(plain, encoding="utf-8")
        return {0: "survived", None: "timed out"}.get(status, "killed")

    def _pytest(self, words: Sequence[str], longest_s: float) -> int | None:
        """Return the exit status of pytest, None if it comes to the limit of CPU or waits for ever."""
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "--tb=no", "-p", "no:cacheprovider", *words]
        limits = (int(longest_s), int(longest_s) + 5)
        mutated = "-x" in words  # its machine code must not outlive it
        environment = os.environ | {"PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1" if mutated else ""}
        try:
            done = subprocess.run(
                [*command, "-m", "not sweep and not waits"], cwd=self.folder, env=environment, capture_output=True,
                timeout=WAITS * longest_s, check=False,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limits),
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return None
        return done.returncode if done.returncode >= 0 else None


def tried(room: str, count: int, seed: int) -> Iterator[tuple[Mutant, str, float]]:
    """Draw mutants of a room and yield each with its fate and the CPU that it took in s."""
    mutants = drawn(TOP / room, count, seed)
    with TemporaryDirectory() as place:
        copy = Copy(Path(place) / "tree")
        tests = copy.tests(room)
        for mutant in mutants:
            chosen = copy.chosen(nearest(mutant, room, tests))
            before_s = cpu_s()
            yield mutant, copy.fate(mutant, chosen), cpu_s() - before_s


def main() -> None:
    """Try mutants of a room, print each and the rate of survivors, and add the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("room", help="folder of the product, for example bench/maths")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=20)
    chosen = parser.parse_args()
    room = chosen.room.strip("/")
    began_s, fates = time.monotonic(), []
    git = ["git", "-C", str(TOP), "describe", "--always", "--dirty"]
    revision = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    with ROWS.open("a", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        if stream.tell() == 0:
            rows.writerow(COLUMNS)
        for mutant, fate, cpu_s in tried(room, chosen.count, chosen.seed):
            name, place = mutant.operator.rpartition("/")[2], f"{mutant.file}:{mutant.line}"
            print(f"{fate:9} {cpu_s:5.1f} s  {place}  {name}", flush=True)
            rows.writerow((revision, room, chosen.seed, place, name, fate, f"{cpu_s:.1f}"))
            stream.flush()  # what is known stays if this is stopped
            fates.append(fate)
    survived, judged = fates.count("survived"), fates.count("survived") + fates.count("killed")
    low, high = wilson(survived, judged)
    print(", ".join(f"{fates.count(fate)} {fate}" for fate in ("killed", "survived", "timed out", "no test")))
    print(f"survivors: {survived} of {judged}, {low:.0%} to {high:.0%} (95 %); {time.monotonic() - began_s:.0f} s")


if __name__ == "__main__":
    main()
