"""Blocks of seeds as rows of a committed file: a row stays once it is written, and what has one is not done again."""

import csv
import os
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).resolve().parents[2]
Row = TypeVar("Row")


def read_rows(form: type[Row], path: Path) -> list[Row]:
    """Return all rows there are; ``form``: a dataclass of numbers and words."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as stream:
        return [form(**{name: kind(row[name]) for name, kind in _columns(form)}) for row in csv.DictReader(stream)]


def add_row(row: Any, path: Path) -> None:
    """Write one more row, which stays there whatever happens next."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, [name for name, _ in _columns(type(row))], lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(asdict(row))
        stream.flush()
        os.fsync(stream.fileno())


def seeds_left(done: Iterable[range], count: int) -> list[int]:
    """Return which of the first ``count`` seeds stand in no row."""
    stand = {seed for seeds in done for seed in seeds}
    return [seed for seed in range(count) if seed not in stand]


def in_blocks(seeds: Sequence[int], most: int) -> list[range]:
    """Return seeds as ranges of ``most`` at the most, without the gaps between them."""
    found: list[range] = []
    for seed in seeds:
        if found and found[-1].stop == seed and len(found[-1]) < most:
            found[-1] = range(found[-1].start, seed + 1)
        else:
            found.append(range(seed, seed + 1))
    return found


def revision_of(judged: Sequence[str]) -> str:
    """Return the last revision that changed what is judged, with ``+`` if files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    changed = git("log", "-1", "--abbrev=9", "--format=%h", "--", *judged)
    return changed + ("+" if git("status", "--porcelain", "--", *judged) else "")


def _columns(form: type[Any]) -> list[tuple[str, Any]]:
    return [(field.name, field.type) for field in fields(form)]
