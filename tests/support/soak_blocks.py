"""Blocks of soaked seeds: one process soaks one, one row in a file that is committed says what came out."""

import os
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fault_schedule import TimedFault
from soak_campaign import (
    ROOT,
    SHORT,
    Campaign,
    HourlyClock,
    Soaked,
    campaign_of,
    grown,
    hourly_clock,
    shortest,
)

ROWS = ROOT / "tests" / "soak" / "blocks.csv"
RAM = Path("/dev/shm")
ROOM_BYTES = 4 << 30  # of the RAM folder: two sessions of 38 hours, and much more


@dataclass(frozen=True)
class Block:
    """Row of a block. ``revision``: ``+`` behind it if files differ from it; ``ended``: how many ended how."""

    campaign: str
    first: int
    last: int
    revision: str
    ended: str
    faults: int
    estimates: int
    flagged: int
    violations: int
    hours: float
    cpu_s: float

    @property
    def seeds(self) -> range:
        """The seeds of the block."""
        return range(self.first, self.last + 1)


@dataclass(frozen=True)
class Failure:
    """A seed that violates an invariant, and the faults that are needed: none if it did not fail again."""

    seed: int
    violations: tuple[str, ...]
    faults: tuple[TimedFault, ...]


def soaked_block(name: str, seeds: range, revision: str) -> tuple[Block, list[Failure]]:
    """Soak the seeds of a block, and cut down the faults of those that violate an invariant; for a fresh process."""
    ended, soaks = Counter[str](), []
    with tempfile.TemporaryDirectory(prefix="soak_", dir=_roomy()) as folder:
        campaign = campaign_of(name, Path(folder))
        for seed in seeds:
            soaked = _soaked(campaign, seed, Path(folder))
            ended[soaked.ended] += 1
            soaks.append(soaked)
        cpu_s = time.process_time()  # with the start of the process
        violated = [soaked for soaked in soaks if soaked.violations]
        failures = [_failure(campaign, soaked, Path(folder)) for soaked in violated]
    block = Block(
        name, seeds.start, seeds.stop - 1, revision,
        "; ".join(f"{count} {how}" for how, count in ended.most_common()),
        sum(len(soaked.faults) for soaked in soaks), sum(soaked.estimates for soaked in soaks),
        sum(soaked.flagged for soaked in soaks), len(failures),
        round(sum(soaked.hours for soaked in soaks), 3), round(cpu_s, 1),
    )  # fmt: skip
    return block, failures


def _roomy() -> Path | None:
    """Return the folder in RAM if there is one with room: what is soaked is the bench, not a disk."""
    if not os.access(RAM, os.W_OK):
        return None
    room = os.statvfs(RAM)
    return RAM if room.f_bavail * room.f_frsize > ROOM_BYTES else None


def _soaked(campaign: Campaign, seed: int, folder: Path, faults: Sequence[TimedFault] | None = None) -> Soaked:
    """Soak one seed; nothing of it is left in the folder. A long campaign is looked at each hour."""
    with tempfile.TemporaryDirectory(dir=folder) as out:
        if campaign.name == SHORT or faults is not None:
            return campaign.soaked(seed, Path(out), faults)
        clock: HourlyClock = hourly_clock(campaign)
        soaked = campaign.soaked(seed, Path(out), clock=lambda: clock)
        soaked.violations += grown(clock.seen)
        return soaked


def _failure(campaign: Campaign, soaked: Soaked, folder: Path) -> Failure:
    def fails(faults: Sequence[TimedFault]) -> bool:
        return bool(_soaked(campaign, soaked.seed, folder, faults).violations)

    if not fails(soaked.faults):  # a process that has grown does not fail again
        return Failure(soaked.seed, tuple(soaked.violations), ())
    needed = shortest(soaked.faults, fails)
    return Failure(soaked.seed, tuple(_soaked(campaign, soaked.seed, folder, needed).violations), tuple(needed))
