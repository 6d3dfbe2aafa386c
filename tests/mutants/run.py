"""Apply each mutant of the catalogue to a copy of the tree and tell whether the tests named for it fail.

``make mutants``; words after the command choose mutants by parts of their names. Exit status 1 if a mutant survives,
if its text is no longer found once, or if its tests fail or are missing without it.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from catalogue import MUTANTS, Mutant

TOP = Path(__file__).resolve().parents[2]
COPIED = ("bench", "instruments", "sim_instruments", "tests", "frames", "sequences", "stations", "docs")
FILES = ("pyproject.toml", "pyvisa_bench.py")
LONGEST_S = 300.0
ALL_PASSED, ONE_FAILED = 0, 1  # exit statuses of pytest; any other one tells nothing of a mutant


def main(words: list[str]) -> int:
    """Apply the mutants whose names contain one of the words, all without words; return the exit status."""
    chosen = [mutant for mutant in MUTANTS if not words or any(word in mutant.name for word in words)]
    with TemporaryDirectory() as place:
        copy = Path(place)
        for name in COPIED:
            shutil.copytree(TOP / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in FILES:
            shutil.copy(TOP / name, copy / name)
        if tests_of(copy, {test for mutant in chosen for test in mutant.tests}, "--tb=short") != ALL_PASSED:
            print("the tests fail without any mutant")
            return 1
        fates = [tried(mutant, copy) for mutant in chosen]
    print(f"{fates.count('caught')} of {len(fates)} mutants caught")
    return int(set(fates) != {"caught"})


def tried(mutant: Mutant, copy: Path) -> str:
    """Return what became of a mutant, and print it."""
    began_s = time.monotonic()
    path = copy / mutant.file
    plain = path.read_text(encoding="utf-8") if path.is_file() else ""
    if plain.count(mutant.old) != 1:
        fate = f"TEXT FOUND {plain.count(mutant.old)} TIMES"
    else:
        path.write_text(plain.replace(mutant.old, mutant.new), encoding="utf-8")
        status = tests_of(copy, mutant.tests, "-x", "--tb=no")
        fate = {ONE_FAILED: "caught", ALL_PASSED: "SURVIVED"}.get(status, f"NOT JUDGED, pytest ended with {status}")
        path.write_text(plain, encoding="utf-8")
    print(f"{fate:9} {time.monotonic() - began_s:5.1f} s  {mutant.name} ({mutant.file})", flush=True)
    return fate


def tests_of(copy: Path, tests: Iterable[str], *words: str) -> int | None:
    """Return the exit status of pytest in the copy, None if it does not end."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words, *sorted(tests)]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}  # two texts in one second
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return None
    if done.returncode not in (ALL_PASSED, ONE_FAILED) or ("--tb=short" in words and done.returncode):
        print(done.stdout[-4000:], done.stderr[-2000:])
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
