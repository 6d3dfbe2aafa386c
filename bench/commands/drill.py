"""``bench drill``: proves on the bench itself that the guard works."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.commands.console import console
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus
from bench.model.shipped import find_shipped
from bench.plan import load_station
from bench.run.bench.drill import drill as run_drill
from bench.session.output import make_folder


def drill(station_name: str, out: Path, as_json: bool) -> int:
    """Run the drill of a station, print what was found; returns 0 if every trial passed, else 3."""
    path = find_shipped("stations", station_name)
    station = load_station(path)
    make_folder(out)
    found = run_drill(station, path, out, WallClock())
    if as_json:
        print(json.dumps(found, indent=1))  # noqa: T201
    else:
        _tell(found)
    return ExitStatus.PASS if found["passed"] else ExitStatus.SAFE_AFTER_FAULT


def _tell(found: Mapping[str, Any]) -> None:
    out = console()
    for trial in found["trials"]:
        guard = "never" if trial["guard_s"] is None else f"after {trial['guard_s']:.2f} s"
        on = ", ".join(f"{role} {state}" for role, state in trial["still_on"].items()) or "everything off"
        verdict = "pass" if trial["passed"] else "FAIL"
        out.print(f"{trial['kill']:<8} guard done {guard}; read back at {trial['confirmed_s']:.2f} s: {on}: {verdict}")
    out.print(f"limit {found['limit_s']:g} s; recorded in {found['folder']}")
