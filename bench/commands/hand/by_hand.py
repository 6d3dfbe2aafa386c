"""``bench talk`` and ``bench drill``: an instrument by hand, recorded, and the proof that the guard works."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bench.commands.console import console, named_file, print_json, warn
from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import BenchError, ExitStatus, InputError
from bench.plan import load_station
from bench.run.bus.talk import TalkSession
from bench.run.guard.drill import drill as run_drill
from bench.run.guard.guarding import station_lock
from bench.session.output import make_folder


def talk(role: str, command: str | None, station_name: str, out: Path, *, take_over: bool = False) -> int:
    """Send one command, or what is typed until an empty line; replies are printed, everything is recorded."""
    station = load_station(named_file("stations", station_name))
    if role not in station.instruments:
        known = ", ".join(sorted(station.instruments))
        raise InputError(
            "B-CLI-003",
            f"station {station.name} has no instrument {role!r}",
            where=role,
            next_step=f"use one of: {known}",
        )
    clock = VirtualClock() if station.in_process else WallClock()
    printer = console()
    lock = station_lock(station, "talk", clock, [role], take_over=take_over)
    with lock, TalkSession(station, role, clock, out) as session:
        for line in [command] if command is not None else _typed(role):
            try:
                reply = session.send(line)
            except BenchError as error:
                warn(error)
                if command is not None:
                    return error.exit_status
            else:
                printer.print(reply if reply is not None else "ok")
        printer.print(f"recorded in {session.folder}; the instrument is left as it is, nothing was made safe")
    return ExitStatus.PASS


def _typed(role: str) -> Iterator[str]:
    while True:
        if sys.stdin.isatty():
            print(f"{role}> ", end="", flush=True)  # noqa: T201
        line = sys.stdin.readline().strip()
        if not line:
            return
        yield line


def drill(station_name: str, out: Path, as_json: bool, *, take_over: bool = False) -> int:
    """Run the drill of a station, print what was found; returns 0 if every trial passed, else 3."""
    path = named_file("stations", station_name)
    station = load_station(path)
    make_folder(out)
    document = run_drill(station, path, out, WallClock(), take_over=take_over)
    if as_json:
        print_json(document)
    else:
        _tell(document)
    return ExitStatus.PASS if document["passed"] else ExitStatus.SAFE_AFTER_FAULT


def _tell(document: Mapping[str, Any]) -> None:
    out = console()
    for trial in document["trials"]:
        guard = "never" if trial["guard_s"] is None else f"after {trial['guard_s']:.2f} s"
        on = ", ".join(f"{role} {state}" for role, state in trial["still_on"].items()) or "everything off"
        verdict = "pass" if trial["passed"] else "FAIL"
        out.print(f"{trial['kill']:<8} guard done {guard}; read back at {trial['confirmed_s']:.2f} s: {on}: {verdict}")
    out.print(f"limit {document['limit_s']:g} s; recorded in {document['folder']}")
