"""What the process of a long campaign needs each hour, and whether that grows.

Meant for a process of its own: what went on before in it would hide or feign a growth. Run as a command it soaks one
seed and prints one JSON document; words: sequence, seed, folder and, if what Python and numpy have allocated is to be
traced, held.
"""

from __future__ import annotations

import ctypes
import gc
import json
import resource
import sys
import threading
import tracemalloc
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from soak_campaign import HOUR_S, Campaign, campaign_of

from bench.analysis import analysis_module
from bench.model.clock import NS, VirtualClock
from bench.record.writer import RETIRED_FILES  # finished segments are open until the next sync

MOST_MiB = 1.0  # growth of what is held, after the first hours
MOST_RESIDENT_MiB = 2.5  # of the whole process, with the simulator's large blocks and the gaps they leave
SHARE = 6  # hours at either end
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "65536"}  # what is freed goes back to the system, so that resident means needed


@dataclass(frozen=True)
class Hour:
    """What the process needs at one hour of bench time; ``held``: traced by Python, 0 if it is not."""

    hour: float
    resident_MiB: float
    held_MiB: float
    descriptors: int
    threads: int


class HourlyClock(VirtualClock):
    """A virtual clock on which each hour it is noted what the process needs."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Hour] = []
        self.every(HOUR_S, self.look)

    def look(self) -> None:
        """Note it now."""
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)  # what the C library keeps for the next time is not needed
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.seen.append(
            Hour(
                self.now_ns() / NS / HOUR_S,
                pages * resource.getpagesize() / 2**20,
                tracemalloc.get_traced_memory()[0] / 2**20,
                len(list(Path("/proc/self/fd").iterdir())),
                threading.active_count(),
            )
        )


def hourly_clock(campaign: Campaign) -> HourlyClock:
    """Return a clock that looks each hour; what the analysis imports is no growth and comes before."""
    analysis_module(str(campaign.plan.campaign["analysis"]))
    return HourlyClock()


def growth_MiB(values: Sequence[float]) -> float:
    """From the first hours to the last ones; what waits for the decoder comes and goes within a megabyte."""
    share = min(SHARE, len(values) // 2)
    return median(values[-share:]) - median(values[:share])


def grown(seen: Sequence[Hour], most_resident_MiB: float = MOST_RESIDENT_MiB) -> list[str]:
    """Return what grew that must not; nothing can be said of a campaign that ended within two hours."""
    if len(seen) < 2:
        return []
    found = []
    resident_MiB, held_MiB = growth_MiB([hour.resident_MiB for hour in seen]), growth_MiB([h.held_MiB for h in seen])
    if resident_MiB > most_resident_MiB:
        found.append(f"resident memory grew by {resident_MiB:.2f} MiB")
    if held_MiB > MOST_MiB:
        found.append(f"held memory grew by {held_MiB:.2f} MiB")
    if {hour.threads for hour in seen} != {seen[0].threads}:
        found.append(f"threads: {[hour.threads for hour in seen]}")
    later = {hour.descriptors for hour in seen if hour.hour > RETIRED_FILES + 1}
    if len(later) > 1 or any(hour.descriptors > seen[0].descriptors + RETIRED_FILES for hour in seen):
        found.append(f"descriptors: {[hour.descriptors for hour in seen]}")
    return found


def main(sequence: str, seed: str, folder: str, traced: str = "") -> dict[str, Any]:
    """Soak one seed; tracing itself needs room, so that resident memory is not judged then."""
    if traced:
        tracemalloc.start(1)
    campaign = campaign_of(sequence, Path(folder))
    clock = hourly_clock(campaign)
    soaked = campaign.soaked(int(seed), Path(folder), clock=lambda: clock)
    found = grown(clock.seen, float("inf") if traced else MOST_RESIDENT_MiB)
    return {
        "ended": soaked.ended, "violations": soaked.violations + found, "estimates": soaked.estimates,
        "flagged": soaked.flagged, "faults": len(soaked.faults), "hours": [asdict(hour) for hour in clock.seen],
    }  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(*sys.argv[1:])) + "\n")
