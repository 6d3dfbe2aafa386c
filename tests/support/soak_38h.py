"""One long virtual campaign under faults of a seed, with what its process needs each hour; a process of its own.

Words: sequence, seed, folder and, if what Python and numpy have allocated is to be traced, held. Prints one JSON
document. Only faults a run lives through: what ends a run is the
business of the 10,000 short campaigns, here the run must last.
"""

from __future__ import annotations

import ctypes
import gc
import json
import resource
import sys
import threading
import tracemalloc
from pathlib import Path
from typing import Any

import fault_schedule
import soak_campaign
from soak_campaign import ROOT, soak_one, watchers

from bench.analysis import Table, analysis_module
from bench.model.clock import NS, VirtualClock
from bench.plan import check_plan, compile_sequence
from bench.systems.af_converter.scale_factor import budgets

HOUR_S = 3600.0
MEAN_INTERVAL_S = 1800.0
LIVED_THROUGH = (
    "bit_errors", "drop", "duplicate", "late", "garbled", "nan", "overload", "reference_lost", "stuck", "unplug",
)  # fmt: skip


class Hourly(VirtualClock):
    """A virtual clock on which each hour it is noted what the process needs."""

    seen: list[dict[str, float]]

    def __init__(self) -> None:
        super().__init__()
        Hourly.seen = []
        self.every(HOUR_S, self.look)

    def look(self) -> None:
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)  # what the C library keeps for the next time is not needed
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        Hourly.seen.append(
            {
                "hour": self.now_ns() / NS / HOUR_S,
                "resident_MiB": pages * resource.getpagesize() / 2**20,
                "held_MiB": tracemalloc.get_traced_memory()[0] / 2**20,
                "descriptors": len(list(Path("/proc/self/fd").iterdir())),
                "threads": threading.active_count(),
            }
        )


def main(sequence: str, seed: str, folder: str, traced: str = "") -> dict[str, Any]:
    if traced:
        tracemalloc.start(1)
    plan = compile_sequence(ROOT / "sequences" / f"{sequence}.yaml", None, {})
    assert check_plan(plan, plan.station) == []
    soak_campaign.DURATION_S = plan.prepare_s + plan.duration_s
    soak_campaign.VirtualClock = Hourly  # type: ignore[misc]
    draws = {name: fault_schedule.DRAWS[name] for name in LIVED_THROUGH}
    fault_schedule.DRAWS = draws  # type: ignore[misc]
    empty = Table("Monte Carlo check", "", [], [])
    analysis_module(str(plan.campaign["analysis"]))  # here: what an import takes is no growth
    budgets.check_table = lambda *_: empty  # type: ignore[assignment]
    soaked = soak_one(plan, int(seed), Path(folder), watchers(plan), MEAN_INTERVAL_S)
    return {
        "ended": soaked.ended, "violations": soaked.violations, "estimates": soaked.estimates,
        "flagged": soaked.flagged, "faults": len(soaked.faults), "hours": Hourly.seen,
    }  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(*sys.argv[1:])) + "\n")
