"""Wrong worlds by seeds, every estimate sorted by somebody who knows the truth: ``make doubt``.

Each switch and size is a block of seeds, right worlds are blocks of fifty; a block is a row of rows.csv as soon as it
is done, so it goes on where the rows of this revision end; tables.md is then new. Exit status 1 if a number is
confidently wrong that could have been seen or that no assumption names, or if over 1 % of right campaigns are doubted.
"""

import argparse
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support" / "numbers"))

from block_rows import add_row, in_blocks, read_rows, revision_of, seeds_left
from doubt_blocks import BIASES, ROWS, Bias, Block, Worlds, all_worlds, done_block, module_of
from doubt_page import PAGE, faults_of, with_tables

SUPPORT = Path(__file__).resolve().parents[1] / "support"
JUDGED = ("bench", "tests/support")
RIGHT_BLOCK = 50
Task = tuple[str, str, float, range]


def main(words: Sequence[str]) -> int:
    """Do what is left and print a line for each block; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="of each switch and size")
    parser.add_argument("--right", type=int, default=500, help="right worlds of each system")
    parser.add_argument("systems", nargs="*", help="all systems without one")
    asked = parser.parse_args(words)
    sys.path.extend(str(folder) for folder in SUPPORT.iterdir() if folder.is_dir())
    revision = revision_of(JUDGED)
    worlds = [one for one in all_worlds() if not asked.systems or one.SYSTEM in asked.systems]
    done = [row for row in read_rows(Block, ROWS) if row.revision == revision]
    tasks = [task for one in worlds for task in left(one, done, asked.seeds, asked.right)]
    for block, biases in doing(tasks, revision):
        add_row(block, ROWS)
        for bias in biases:
            add_row(bias, BIASES)
        print(told(block), flush=True)
    rows = [row for row in read_rows(Block, ROWS) if row.revision == revision]
    biases_now = [row for row in read_rows(Bias, BIASES) if row.revision == revision]
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), rows, biases_now), encoding="utf-8")
    faults = faults_of(rows, {switch.name: switch.assumption for one in worlds for switch in one.SWITCHES})
    print("\n".join(faults) or f"{len(rows)} rows of {revision}: nothing confidently wrong that could have been seen")
    return 1 if faults else 0


def left(worlds: Worlds, done: Sequence[Block], seeds: int, right: int) -> Iterator[Task]:
    """Yield the blocks of a system that have no row yet."""
    kinds = [(switch.name, size, seeds, seeds) for switch in worlds.SWITCHES for size in switch.sizes]
    for name, size, count, most in [*kinds, ("", 0.0, right, RIGHT_BLOCK)]:
        mine = [row.seeds for row in done if (row.system, row.switch, row.size) == (worlds.SYSTEM, name, size)]
        for block in in_blocks(seeds_left(mine, count), most):
            yield module_of(worlds), name, size, block


def doing(tasks: Sequence[Task], revision: str) -> Iterator[tuple[Block, list[Bias]]]:
    """Yield each block as soon as it is done."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=spawn) as workers:
        for future in as_completed([workers.submit(done_block, *task, revision) for task in tasks]):
            yield future.result()


def told(block: Block) -> str:
    """Return one line of a block."""
    what = f"{block.switch} {block.size:g}" if block.switch else "right worlds"
    more = f"; {block.campaigns} campaigns doubted"
    if block.switch:
        more = f", {block.visible} of them to be seen; trace {block.trace:g}"
    return (
        f"{block.system}, {what}, seeds {block.first} to {block.last}: {block.right} right, {block.wide} wide, "
        f"{block.missed} missed, {block.doubted} doubted, {block.refused} refused, "
        f"{block.confidently_wrong} confidently wrong{more}; {block.cpu_s:.1f} s"
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
