"""Campaigns by seeds, each interval held against the truth: ``python tests/coverage/run.py``.

A block of seeds is written to rows.csv as soon as it is done, so it can be stopped at any time and goes on where the
rows of this revision end. Exit status 1 if 95 % lies outside the exact 99.9 % interval of what a quantity shows.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support" / "numbers"))

from block_rows import add_row, in_blocks, read_rows, revision_of, seeds_left
from coverage_blocks import ROWS, Covered, all_campaigns, done_block, loaded, summed, told

SUPPORT = Path(__file__).resolve().parents[1] / "support"
JUDGED = ("bench", "tests/support")
BLOCK = 250


def main(words: Sequence[str]) -> int:
    """Do what is left and print a line for each quantity; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2000, help="campaigns of each kind")
    parser.add_argument("systems", nargs="*", help="all systems without one")
    asked = parser.parse_args(words)
    sys.path.extend(str(folder) for folder in SUPPORT.iterdir() if folder.is_dir())
    revision = revision_of(JUDGED)
    chosen = [module for module in all_campaigns() if not asked.systems or loaded(module).SYSTEM in asked.systems]
    for module in chosen:
        done = [row.seeds for row in _rows(revision) if row.system == loaded(module).SYSTEM]
        for block in in_blocks(seeds_left(done, asked.seeds), BLOCK):
            for row in done_block(module, block, revision):
                add_row(row, ROWS)
    systems = [loaded(module).SYSTEM for module in chosen]
    sums = summed([row for row in _rows(revision) if row.system in systems])
    print("\n".join(told(row) for row in sums))
    return 0 if all(row.as_stated for row in sums) else 1


def _rows(revision: str) -> list[Covered]:
    return [row for row in read_rows(Covered, ROWS) if row.revision == revision]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
