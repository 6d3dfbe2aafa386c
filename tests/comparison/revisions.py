"""The two sides of a comparison: trees of this repository whose commands run on this machine, each on its own code."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cases import Case
from documents import Difference, compare_folders, unavailable_views

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
VIEWS = HERE / "views.py"
_PACKAGES = "import bench, instruments, sim_instruments as s; print(bench.__file__, instruments.__file__, s.__file__)"
_LEFT = re.compile(r"\s*\d+:\d\d:\d\d left$")  # of a study: how long this machine will need


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
        """Give the command of a case; its output and exit status stand beside its files, and the state a page shows."""
        folder = self.work / case.name
        place = case.prepare(folder, self.tree)
        if case.is_of_plans:
            done = self.python([VIEWS, "plans", folder, *case.words], place)
        else:
            done = self.python(["-m", "bench", *case.command()], place)
        lines = [_LEFT.sub("", line) for line in done.stderr.splitlines()]
        (folder / "status.json").write_text(json.dumps({"exit": done.returncode, "stderr": lines}))
        name = "stdout.json" if done.stdout.startswith("{") else "stdout.txt"
        (folder / name).write_text(done.stdout)
        if sessions := sorted({path.parent for path in folder.glob("out/*/session.*.mcap")}):
            self.python([VIEWS, "states", *sessions], folder)


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
    for path, reason in unavailable_views(folder):
        yield Difference(f"{case.name}/{path}", "own code", side.work.name, f"not available: {reason}")
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


def compare(sides: Sequence[Bench], cases: Sequence[Case]) -> Iterator[tuple[Case, list[Difference]]]:
    """Run all cases on both sides, two processes at once; yield each case with its differences."""
    base, new = sides
    with ThreadPoolExecutor(2) as pool:
        replays = []
        for case in cases:
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
