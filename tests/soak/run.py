"""Soak seeds until as many as asked for stand in blocks.csv: ``make soak N=10000``, ``CAMPAIGN=`` a sequence.

Each block of seeds is a process, one for each core at a time, and a row as soon as it is done: it can be stopped at
any time and goes on where the rows end. A seed that violates an invariant is told with the faults that it needs. Exit
status 1 if there is one, 130 if it was stopped.
"""

import argparse
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

from block_rows import ROOT, add_row, in_blocks, read_rows, revision_of, seeds_left
from soak_blocks import ROWS, Block, Failure, soaked_block
from soak_campaign import ALLOCATOR, SHORT

LARGEST = 100  # seeds of the short campaign in a block: about a minute
JUDGED = ("bench", "instruments", "sim_instruments", "frames", "sequences", "stations", "tests/support")
STOPPED = 130


def main(words: Sequence[str]) -> int:
    """Soak what is left and print a line for each block; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, help="seeds, from 0 on, that shall stand in the file")
    parser.add_argument("campaign", nargs="?", default=SHORT, help="a sequence; without one the short campaign")
    asked = parser.parse_args(words)
    blocks = planned(seeds_left(done(asked.campaign), asked.count), asked.campaign)
    rows: list[Block] = []
    status = 0
    try:
        for block, failures in soaked(asked.campaign, blocks):
            add_row(block, ROWS)
            rows.append(block)
            print(told(block), flush=True)
            status = max([status, *(complained(block, failure) for failure in failures)])
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here")
        return STOPPED
    print(summary(read_rows(Block, ROWS), asked.campaign, rows))
    return status


def done(campaign: str) -> list[range]:
    """Return the seeds of a campaign that stand in the file."""
    return [block.seeds for block in read_rows(Block, ROWS) if block.campaign == campaign]


def planned(seeds: Sequence[int], campaign: str) -> list[range]:
    """Return the blocks that seeds are soaked in: a long campaign is one alone."""
    share = -(-len(seeds) // (os.cpu_count() or 1))
    return in_blocks(seeds, max(1, min(LARGEST, share)) if campaign == SHORT else 1)


def soaked(campaign: str, blocks: Sequence[range]) -> Iterator[tuple[Block, list[Failure]]]:
    """Yield each block and its failures as soon as it is done."""
    revision = revision_of(JUDGED)
    if campaign != SHORT:
        os.environ.update(ALLOCATOR)
    spawn = multiprocessing.get_context("spawn")
    workers = ProcessPoolExecutor(os.cpu_count(), mp_context=spawn, initializer=quiet_end, max_tasks_per_child=1)
    try:
        futures: list[Future[tuple[Block, list[Failure]]]] = [
            workers.submit(soaked_block, campaign, seeds, revision) for seeds in blocks
        ]
        for future in as_completed(futures):
            yield future.result()
    finally:
        workers.shutdown(wait=True, cancel_futures=True)


def quiet_end() -> None:
    """Die of Ctrl-C without a word: the row of an unfinished block is not written."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def complained(block: Block, failure: Failure) -> int:
    """Say what a seed violates and which faults it needs; return 1."""
    print(f"seed {failure.seed} of {block.campaign}: {'; '.join(failure.violations)}")
    needed = "".join(f"    {fault}\n" for fault in failure.faults)
    print(needed or "  not reproduced beside the other seeds of its block")
    return 1


def rate(blocks: Sequence[Block]) -> float:
    """Return virtual hours of campaign per minute of CPU."""
    return 60.0 * sum(block.hours for block in blocks) / max(sum(block.cpu_s for block in blocks), 1e-9)


def told(block: Block) -> str:
    """Return one line of a block."""
    return (
        f"{block.campaign} {block.first} to {block.last}: {block.ended}; {block.faults} faults, {block.estimates} "
        f"estimates held against the truth, {block.violations} violations; {block.hours:.1f} h in {block.cpu_s:.0f} s "
        f"of CPU, {rate([block]):.1f} virtual hours per minute of CPU"
    )


def summary(blocks: Sequence[Block], campaign: str, now: Sequence[Block]) -> str:
    """Return what stands in the file for a campaign, and how fast it went now."""
    mine = [block for block in blocks if block.campaign == campaign]
    total = (
        f"{sum(len(block.seeds) for block in mine)} seeds of {campaign} in {ROWS.relative_to(ROOT)}: "
        f"{sum(block.violations for block in mine)} violations, {sum(block.faults for block in mine)} faults, "
        f"{sum(block.hours for block in mine):.1f} virtual hours"
    )
    return f"{total}; now {rate(now):.1f} virtual hours per minute of CPU" if now else f"{total}; none was left to soak"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
