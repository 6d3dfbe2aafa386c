"""Whether a long campaign needs more memory the longer it lasts: what is held after the first hour and at the end.

The 25-hour bias campaign with its simulated bench, in this process, up to its last step: what results and report need
afterwards is not part of it. It is run twice: "resident" is what the operating system sees (Linux only), code pages
that are used for the first time included, and comes and goes with the free places between; "held" is what Python and
numpy have allocated (tracemalloc). Bytes that wait for the decoder (1 MB at most) and the index of the hour's chunks
(0.5 MB when the hour ends) are part of both, so neighbouring hours differ by up to that. The first soak, the first
record and the first reading use code and buffers that the first hour did not: growth is told from the fourth hour on
too. What is left is the records themselves, 0.4 KiB each.

Run: python -m benchmarks.memory [SEQUENCE].
"""

from __future__ import annotations

import gc
import math
import resource
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.model.clock import NS, VirtualClock
from bench.plan import Plan, Step, compile_sequence
from bench.record import RecordRow
from bench.run.operator import SimulatedOperator
from bench.run.session import conduct

HOUR_s = 3600.0
EACH_h = 4
WARM_h = 4  # by then every kind of step was carried out


def held_MiB() -> float:
    """Memory that is allocated now."""
    return tracemalloc.get_traced_memory()[0] / 2**20


def resident_MiB() -> float:
    """Memory of this process that is in RAM now; NaN where the system does not say."""
    status = Path("/proc/self/statm")
    return int(status.read_text().split()[1]) * resource.getpagesize() / 2**20 if status.exists() else math.nan


@dataclass
class Watch:
    """Takes a value each virtual hour and when the last step of ``plan`` begins; ``seen`` holds (hour, MiB)."""

    clock: VirtualClock
    plan: Plan
    measure_MiB: Callable[[], float]
    seen: list[tuple[float, float]] = field(default_factory=list)

    def look(self) -> None:
        """Take a value now, garbage collected."""
        gc.collect()
        self.seen.append((self.clock.now_ns() / NS / HOUR_s, self.measure_MiB()))

    def step(self, step: Step, at_s: float) -> None:
        """A step begins."""
        if step.number == len(self.plan.steps) - 1:
            self.look()

    def record(self, row: RecordRow) -> None:
        """A record is complete."""

    def message(self, text: str) -> None:
        """Something a person should read."""


def watched(sequence: str, measure_MiB: Callable[[], float]) -> list[tuple[float, float]]:
    """Run a sequence: (virtual hour, MiB), each hour and at the end."""
    clock, plan = VirtualClock(), compile_sequence(sequence)
    watch = Watch(clock, plan, measure_MiB)
    clock.every(HOUR_s, watch.look)
    with TemporaryDirectory() as folder:
        conduct(
            plan, clock=clock, seed=1, out=Path(folder), operator=SimulatedOperator(), listener=watch,
            keep_events=("environment", "phase", "slip", "late", "reading", "end"),
        )  # fmt: skip
    return watch.seen


def main() -> None:
    """Print one table."""
    sequence = sys.argv[1] if len(sys.argv) > 1 else "bias_ramp_25h"
    resident = watched(sequence, resident_MiB)
    tracemalloc.start(1)
    held = watched(sequence, held_MiB)
    tracemalloc.stop()
    rows = [f"{'virtual hour':>12}{'held MiB':>14}{'growth MiB':>12}{'resident MiB':>14}{'growth MiB':>12}"]
    pairs = list(zip(held, resident, strict=True))
    rows += [
        f"{hour:>12.2f}{now:>14.2f}{now - held[0][1]:>12.2f}{seen:>14.2f}{seen - resident[0][1]:>12.2f}"
        for (hour, now), (_, seen) in [*pairs[::EACH_h], pairs[-1]]
    ]
    for name, seen in (("held", held), ("resident", resident)):
        most_MiB = max(now for _, now in seen)
        rows.append(f"most {name} after the first hour: {most_MiB - seen[0][1]:+.2f} MiB")
        if len(seen) > WARM_h:
            rows.append(f"most {name} after hour {WARM_h}: {most_MiB - seen[WARM_h - 1][1]:+.2f} MiB")
    sys.stdout.write("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
