"""Run every analysis in two revisions on this machine and say what differs: ``make compare BASE=<revision>``.

Each revision runs its own code, by commands only. Beside that the new one replays each session of the base. The exit
status is 1 for a difference that ``differences.toml`` does not name.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cases import LOGS, MERGED, RUNS, STUDY, Case, checks, imports, resumptions
from documents import Difference, compare_folders, named_differences

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SIDES = ("base", "new")
SHOWN = 8  # differences of each file
_PACKAGES = "import bench, instruments, sim_instruments as s; print(bench.__file__, instruments.__file__, s.__file__)"


@dataclass(frozen=True)
class Bench:
    """One revision: the folder of its tree, and the folder in which its commands run."""

    tree: Path
    work: Path

    def environment(self) -> dict[str, str]:
        """Return what makes the interpreter import this tree."""
        own = {"PYTHONPATH": str(self.tree), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "COLUMNS": "200"}
        return os.environ | own | {"PYTHONDONTWRITEBYTECODE": "", "PYTHONHASHSEED": "0"}

    def python(self, words: Sequence[str | Path], cwd: Path) -> subprocess.CompletedProcess[str]:
        """Run the interpreter of this process with this tree in front of everything."""
        command = [sys.executable, *map(str, words)]
        return subprocess.run(
            command, cwd=cwd, env=self.environment(), capture_output=True, text=True, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip

    def check_imports(self) -> None:
        """Print which packages run. Raises: SystemExit if they are not those of this tree."""
        files = self.python(["-c", _PACKAGES], self.work).stdout.split()
        print(f"{self.tree}: {' '.join(files) or 'nothing can be imported'}")
        if len(files) != 3 or not all(Path(file).is_relative_to(self.tree) for file in files):
            sys.exit(f"error: the packages that run are not those of {self.tree}")

    def run(self, case: Case) -> None:
        """Give the command of a case; its output and exit status stand beside its files."""
        folder = self.work / case.name
        done = self.python(["-m", "bench", *case.command()], folder)
        (folder / "status.json").write_text(json.dumps({"exit": done.returncode, "stderr": done.stderr.splitlines()}))
        name = "stdout.json" if done.stdout.startswith("{") else "stdout.txt"
        (folder / name).write_text(done.stdout)


@contextmanager
def checkout(revision: str, place: Path) -> Iterator[Path]:
    """A worktree of a revision, removed again at the end."""
    git = ["git", "-C", str(ROOT), "worktree"]
    subprocess.run([*git, "add", "--quiet", "--detach", str(place), revision], check=True)
    try:
        yield place
    finally:
        subprocess.run([*git, "remove", "--force", str(place)], check=True)


def not_done(side: Bench, case: Case) -> Iterator[Difference]:
    """Yield what says that a command failed or left no results: two equal failures compare nothing."""
    folder = side.work / case.name
    status = json.loads((folder / "status.json").read_text())
    if status["exit"] not in (0, 1):
        yield Difference(
            f"{case.name}/status.json", "exit", side.work.name, f"{status['exit']} {status['stderr'][-1:]}"
        )
    if case.is_session and not list(folder.glob("out/*/results.json")):
        yield Difference(f"{case.name}/results.json", "file", side.work.name, "no session with results")


def replayed(new: Bench, base: Bench, case: Case) -> list[Difference]:
    """Let the new revision replay the sessions of the base; a number that differs is a difference."""
    differences = []
    for results in sorted((base.work / case.name).glob("out/*/results.json")):
        done = new.python(["-m", "bench", "replay", results.parent, "--json"], new.work)
        if done.returncode:
            said = " ".join(done.stderr.split())[-300:]
            differences.append(Difference(f"{case.name}/{results.parent.name}", "replay", "identical", said))
    return differences


def chosen_cases(base_tree: Path, logs: Path) -> list[Case]:
    """Return all cases; say which logs are not here."""
    imported = imports(ROOT / "docs" / "mappings", logs)
    for name in sorted(LOGS.keys() - {case.name for case in imported}):
        print(f"skipped: {name}, its log is not below {logs} (set BENCH_REAL_DATA)")
    return [*RUNS, *imported, *resumptions(ROOT / "tests" / "golden"), MERGED, *checks(base_tree), STUDY]


def compare(sides: Sequence[Bench], cases: Sequence[Case]) -> Iterator[tuple[Case, list[Difference]]]:
    """Run all cases on both sides, two processes at once; yield each case with its differences."""
    base, new = sides
    with ThreadPoolExecutor(2) as pool:
        replays = []
        for case in cases:
            for side in sides:
                case.prepare(side.work / case.name, base.tree)
            list(pool.map(lambda side, case=case: side.run(case), sides))
            differences = [
                Difference(f"{case.name}/{found.file}", found.place, found.base, found.new)
                for found in compare_folders(base.work / case.name, new.work / case.name)
            ]
            differences += [failure for side in sides for failure in not_done(side, case)]
            if case.is_session:
                replays.append((case, differences, pool.submit(replayed, new, base, case)))
            else:
                yield case, differences
            while replays and replays[0][2].done():
                waited, found_before, replay = replays.pop(0)
                yield waited, found_before + replay.result()
        for waited, found_before, replay in replays:
            yield waited, found_before + replay.result()


def report(compared: Iterator[tuple[Case, list[Difference]]], base: Path) -> bool:
    """Print a table of the cases and the first differences of each file; return whether all are explained."""
    names = named_differences(HERE / "differences.toml")
    print(f"\n{'case':34} {'files':>5} {'named':>6} {'unexplained':>12}", flush=True)
    unexplained: dict[str, list[Difference]] = {}
    for case, differences in compared:
        left = [difference for difference in differences if not any(name.covers(difference) for name in names)]
        files = sum(path.is_file() for path in (base / case.name).rglob("*"))
        print(f"{case.name:34} {files:5} {len(differences) - len(left):6} {len(left):12}", flush=True)
        for difference in left:
            unexplained.setdefault(difference.file, []).append(difference)
    for file, left in unexplained.items():
        print(f"\n{file}: {len(left)} differences")
        for difference in left[:SHOWN]:
            print(f"  {difference.place}: {difference.base} != {difference.new}")
    return not unexplained


def main() -> int:
    """Compare the checkout with a revision."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--base", required=True, help="git revision to compare with")
    parser.add_argument("--only", help="names of cases, with commas between them")
    chosen = parser.parse_args()
    began_s = time.monotonic()
    logs = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data"))
    with tempfile.TemporaryDirectory() as place, checkout(chosen.base, Path(place, "tree")) as base_tree:
        sides = [Bench(tree, Path(place, side)) for side, tree in zip(SIDES, (base_tree, ROOT), strict=True)]
        for side in sides:
            side.work.mkdir()
            side.check_imports()
        cases = chosen_cases(base_tree, logs)
        if chosen.only:
            cases = [case for case in cases if case.name in chosen.only.split(",")]
        same = report(compare(sides, cases), sides[0].work)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"\n{used.ru_utime + used.ru_stime:.0f} s of CPU, {time.monotonic() - began_s:.0f} s on the clock")
    print("no unexplained difference" if same else "there are unexplained differences")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
