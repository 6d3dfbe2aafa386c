"""Run every analysis in two revisions on this machine and say what differs: ``make compare BASE=<revision>``.

Each revision runs its own code: by commands, and by ``views.py`` for what no command prints. Beside that the new one
replays each session of the base. The exit status is 1 for a difference that ``differences.toml`` does not name.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from cases import LOGS, MERGED, RUNS, STUDY, Case, checks, golden_sessions, imports, plans, resumptions
from documents import Difference, named_differences
from revisions import HERE, ROOT, Bench, checkout, compare

SIDES = ("base", "new")
SHOWN = 8  # differences of each file


def chosen_cases(base_tree: Path, logs: Path) -> list[Case]:
    """Return all cases; say which logs are not here."""
    imported = imports(ROOT / "docs" / "mappings", logs)
    for name in sorted(LOGS.keys() - {case.name for case in imported}):
        print(f"skipped: {name}, its log is not below {logs} (set BENCH_REAL_DATA)")
    golden = ROOT / "tests" / "golden"
    kept = [*resumptions(golden), *golden_sessions(golden)]
    sequences = [*plans(base_tree), *checks(base_tree)]
    return [*(run.of(base_tree) for run in RUNS), *imported, *kept, MERGED, *sequences, STUDY]


def report(compared: Iterator[tuple[Case, list[Difference]]], base: Path) -> bool:
    """Print a table of the cases and the first differences of each file, or "identical".

    Returns: whether ``differences.toml`` explains all.
    """
    names = named_differences(HERE / "differences.toml")
    print(f"\n{'case':40} {'files':>5} {'named':>6} {'unexplained':>12}", flush=True)
    unexplained: dict[str, list[Difference]] = {}
    explained = 0
    for case, differences in compared:
        left = [difference for difference in differences if not any(name.covers(difference) for name in names)]
        explained += len(differences) - len(left)
        files = sum(path.is_file() for path in (base / case.name).rglob("*"))
        print(f"{case.name:40} {files:5} {len(differences) - len(left):6} {len(left):12}", flush=True)
        for difference in left:
            unexplained.setdefault(difference.file, []).append(difference)
    for file, left in unexplained.items():
        print(f"\n{file}: {len(left)} differences")
        for difference in left[:SHOWN]:
            print(f"  {difference.place}: {difference.base} != {difference.new}")
    if unexplained:
        print(f"\ndifferent: {', '.join(unexplained)}")
    else:
        print("\nidentical" + (f", but for {explained} differences that are named" if explained else ""))
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
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
