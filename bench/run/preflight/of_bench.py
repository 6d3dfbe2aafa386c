"""Whatever watches over the bench: the guard process, and the drill that proved it."""

from __future__ import annotations

import sys

from bench.run.bench.drill import drill_age, latest_drill
from bench.run.bench.drill_controller import has_source
from bench.run.preflight.context import PreflightContext
from bench.run.preflight.finding import Finding, Status

GUARD_LIMIT_S = 15.0
DRILL_DAYS = 30
_START = (
    "import sys; import bench.run.guard.process; from bench.run.bench.opener import open_visa; "
    "open_visa(sys.argv[1]); print('ready')"
)


def guard(context: PreflightContext) -> Finding:
    """A process of its own can load what the guard needs: its program and the station's VISA library."""
    if context.in_process:
        return Finding("guard", Status.SKIPPED, "", "", "a bench inside this process ends with it")
    words = (sys.executable, "-P", "-c", _START, context.station.file.visa)
    if context.host.output(words, GUARD_LIMIT_S) != "ready":
        text = "a new process cannot load the guard or the VISA library; reinstall the software"
        return Finding("guard", Status.FAIL, "does not start", f"in {GUARD_LIMIT_S:g} s", text)
    return Finding("guard", Status.OK, "starts", f"in {GUARD_LIMIT_S:g} s")


def drill(context: PreflightContext) -> Finding:
    """A kill drill has shown, not long ago, that the guard brings this bench to its safe state."""
    name, limit, again = "kill drill", f"passed in the last {DRILL_DAYS} days", "run 'bench drill' on this station"
    if context.in_process:
        return Finding(name, Status.SKIPPED, "", limit, "a bench inside this process ends with it")
    found = latest_drill(context.out, context.station)
    if found is None and not has_source(context.station):
        return Finding(name, Status.SKIPPED, "", limit, "the station has no instrument a drill could switch on")
    if found is None:
        unproved = "" if context.station.simulated else "nothing proves that this bench becomes safe by itself; "
        return Finding(name, Status.WARN, "none", limit, f"{unproved}{again}")
    days = drill_age(found, context.clock).total_seconds() / 86_400
    value = f"{days:.1f} days ago"
    if not found["passed"]:
        text = "the last drill failed: the guard does not make this bench safe in time"
        return Finding(name, Status.FAIL, value, limit, text, of_bench=True)
    return Finding(
        name, Status.OK if days <= DRILL_DAYS else Status.WARN, value, limit, "" if days <= DRILL_DAYS else again
    )
