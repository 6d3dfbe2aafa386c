"""Published campaigns in right worlds: which of them are doubted: ``make published KEEP=FOLDER``.

Each sequence that has an analysis is run with seeds 1 to 20 and recorded below the folder as SEQUENCE/SEED; what is
recorded there already is fitted again. Each is a row of published.csv, and rows of this revision are not done again.
Exit status 1 if more than four campaigns are doubted, or if one has no results.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

from block_rows import ROOT, add_row, read_rows, revision_of

from bench.analysis import estimates_of

ROWS = ROOT / "tests" / "doubt" / "published.csv"
JUDGED = ("bench", "sim_instruments", "sequences", "stations", "frames")
MOST = 4
SEEDS = range(1, 21)


@dataclass(frozen=True)
class Campaign:
    """Row of a campaign: exit status, estimates, and how many of them are doubtful or refused, with the codes."""

    sequence: str
    seed: int
    revision: str
    status: int
    estimates: int
    doubtful: int
    refused: int
    codes: str
    wall_s: float


def main(words: Sequence[str]) -> int:
    """Do what is left and print a line for each campaign; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("keep", type=Path, help="folder of the recordings")
    keep = parser.parse_args(words).keep
    revision = revision_of(JUDGED)
    done = {(row.sequence, row.seed) for row in read_rows(Campaign, ROWS) if row.revision == revision}
    tasks = [(name, seed) for seed in SEEDS for name in sequences() if (name, seed) not in done]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for future in as_completed([threads.submit(judged, *task, keep, revision) for task in tasks]):
            row = future.result()
            add_row(row, ROWS)
            print(f"{row.sequence} {row.seed}: {row.estimates} estimates, {row.codes or 'sound'}", flush=True)
    rows = [row for row in read_rows(Campaign, ROWS) if row.revision == revision]
    doubted, lost = [row for row in rows if row.codes], [row for row in rows if row.status not in (0, 1)]
    print(f"{len(rows)} campaigns of {revision}: {len(doubted)} doubted, {len(lost)} without results")
    return int(len(doubted) > MOST or bool(lost))


def sequences() -> list[str]:
    """Return the published sequences that have an analysis."""
    paths = sorted((ROOT / "sequences").glob("*.yaml"))
    return [path.stem for path in paths if "\nanalysis: " in path.read_text(encoding="utf-8")]


def judged(sequence: str, seed: int, keep: Path, revision: str) -> Campaign:
    """Run or fit one campaign."""
    begun_s = time.monotonic()
    folder = keep / sequence / str(seed)
    recorded = [path for path in folder.glob("*") if any(path.glob("*.mcap"))]
    if recorded:
        done = bench("fit", str(recorded[0]), "--fresh", "--json")
        document = json.loads(done.stdout) if done.returncode in (0, 1) else {}
    else:
        done = bench("run", sequence, "--clock", "virtual", "--seed", str(seed), "--out", str(folder), "--json")
        document = results_below(folder)
    entries = estimates_of(document)
    qualities = [entry.quality for entry in entries]
    codes = sorted({reason.code for entry in entries for reason in entry.reasons})
    return Campaign(
        sequence, seed, revision, done.returncode, len(entries), qualities.count("doubtful"),
        qualities.count("refused"), " ".join(codes), round(time.monotonic() - begun_s, 1),
    )  # fmt: skip


def bench(*words: str) -> subprocess.CompletedProcess[str]:
    """Return what the command said."""
    return subprocess.run([sys.executable, "-m", "bench", *words], capture_output=True, text=True, check=False)


def results_below(folder: Path) -> dict[str, Any]:
    """Return the results of the only session below a folder; empty if it has none."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*/results.json")]
    return found[0] if found else {}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
