"""``bench check``: everything that can be known without touching an instrument."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from bench.commands.console import console, hours
from bench.commands.loading import checked_plan
from bench.commands.output import writing
from bench.model.clock import NS, VIRTUAL_START_UTC_NS, WallClock
from bench.model.errors import ExitStatus
from bench.plan.summary import summarise


def check(sequence: str, station: str | None, settings: list[str], plot: Path | None, as_json: bool) -> int:
    """Check a sequence; print steps, duration, finish time, disk use and hazards; draw the timetable if asked."""
    plan = checked_plan(sequence, station, settings)
    start_ns = VIRTUAL_START_UTC_NS if plan.station.simulated else WallClock().utc_ns()
    summary = summarise(plan, start_ns)
    if plot is not None:
        from bench.report import plot_timetable  # matplotlib takes longer to load than a sequence to check

        with writing(plot):
            plot_timetable(plan, plot)
    if as_json:
        document = {"sequence": plan.name, "station": plan.station_name, "plan_sha256": plan.sha256, **asdict(summary)}
        sys.stdout.write(json.dumps(document, indent=1) + "\n")
        return ExitStatus.PASS
    out = console()
    finish = datetime.fromtimestamp(summary.finish_utc_ns / NS, UTC).strftime("%Y-%m-%d %H:%M:%SZ")
    out.print(f"{plan.name}: {plan.title}")
    out.print(f"  station      {plan.station_name}{' (simulated)' if plan.station.simulated else ''}")
    out.print(f"  steps        {summary.steps}, {summary.records} records")
    out.print(f"  preparation  {hours(summary.prepare_s)}")
    out.print(f"  campaign     {hours(summary.duration_s)} = {summary.duration_s:.0f} s")
    out.print(f"  afterwards   {hours(summary.finally_s)}")
    out.print(f"  finish       {finish} if started {'at the virtual start' if plan.station.simulated else 'now'}")
    out.print(f"  disk         at most {summary.disk_bytes / 1e6:.0f} MB")
    for hazard in summary.hazards:
        out.print(f"  hazard       {hazard}")
    if plot is not None:
        out.print(f"  timetable    {plot}")
    out.print("no mistake found")
    return ExitStatus.PASS
