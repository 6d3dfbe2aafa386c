"""How often intervals hold the truth: what the campaigns of some seeds show, a row for each quantity of a block.

One estimate of a quantity in each campaign, so that all are independent and their number inside is binomial.
"""

import importlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from block_rows import ROOT

from bench.maths.verdict import clopper_pearson

ROWS = ROOT / "tests" / "coverage" / "rows.csv"
STATED, SURE = 0.95, 0.999


class Campaigns(Protocol):
    """A module of generated campaigns, in the folder of a system."""

    SYSTEM: str

    def inside(self, seed: int) -> Mapping[str, bool | None]:
        """Return of each quantity whether the interval of one estimate holds the truth; None if it is not sound."""


@dataclass(frozen=True)
class Covered:
    """Row of a quantity and a block of seeds: sound estimates, those inside their U, and those that are not sound."""

    system: str
    quantity: str
    first: int
    last: int
    revision: str
    sound: int
    inside: int
    unsound: int
    cpu_s: float

    @property
    def seeds(self) -> range:
        """The seeds of the block."""
        return range(self.first, self.last + 1)

    @property
    def interval(self) -> tuple[float, float]:
        """The exact 99.9 % interval of the share inside."""
        return clopper_pearson(self.inside, self.sound, SURE)

    @property
    def as_stated(self) -> bool:
        """Whether 95 % is within that interval."""
        low, high = self.interval
        return low <= STATED <= high


def in_right_world(entries: Sequence[Any], truths: Sequence[float]) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth; None if it is not sound."""
    found: dict[str, bool | None] = {}
    for entry, truth in zip(entries, truths, strict=True):
        name = f"{entry.quantity} {entry.conditions.get('method') or entry.conditions.get('link') or ''}".strip()
        sound = entry.quality == "sound"
        found[name] = abs(entry.value - truth) <= entry.expanded_uncertainty if sound else None
    return found


def all_campaigns() -> Iterator[str]:
    """Yield the names of the modules of generated campaigns; of two modules of wrong worlds the right ones are some."""
    yield from ("doubt_lock_in", "doubt_time_sync")
    for path in sorted((ROOT / "tests" / "support").glob("*/coverage_*.py")):
        if path.stem != "coverage_blocks":
            yield path.stem


def loaded(module: str) -> Campaigns:
    """Return a module of generated campaigns."""
    return importlib.import_module(module)


def done_block(module: str, seeds: range, revision: str) -> list[Covered]:
    """Count the intervals of the campaigns of some seeds."""
    begun_s = time.process_time()
    campaigns = loaded(module)
    seen = [campaigns.inside(seed) for seed in seeds]
    cpu_s = round(time.process_time() - begun_s, 1)
    rows = []
    for quantity in seen[0]:
        column = [one[quantity] for one in seen]
        unsound = column.count(None)
        rows.append(
            Covered(
                campaigns.SYSTEM, quantity, seeds.start, seeds.stop - 1, revision, len(column) - unsound,
                column.count(True), unsound, cpu_s,
            )
        )  # fmt: skip
    return rows


def summed(rows: Sequence[Covered]) -> list[Covered]:
    """Return one row for each quantity of each system."""
    groups: dict[tuple[str, str], list[Covered]] = {}
    for row in rows:
        groups.setdefault((row.system, row.quantity), []).append(row)
    sums = []
    for (system, quantity), group in groups.items():
        counts = [sum(getattr(row, name) for row in group) for name in ("sound", "inside", "unsound")]
        first, last = min(row.first for row in group), max(row.last for row in group)
        cpu_s = sum(row.cpu_s for row in group)
        sums.append(Covered(system, quantity, first, last, group[0].revision, *counts, cpu_s))
    return sums


def told(row: Covered) -> str:
    """Return one line of a quantity."""
    low, high = (100 * end for end in row.interval)
    verdict = "" if row.as_stated else ", NOT as stated"
    return (
        f"{row.system}, {row.quantity}: {row.inside} of {row.sound} inside ({100 * row.inside / max(row.sound, 1):.1f} "
        f"%, {low:.1f} to {high:.1f} % at 99.9 %){verdict}; {row.unsound} not sound"
    )
