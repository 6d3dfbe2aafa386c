"""``bench talk``, ``commission`` and ``drill``: an instrument by hand, its first contact, the guard's proof."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from bench.commands.console import console, named_file, print_json, warn
from bench.model.clock import VirtualClock, WallClock, utc_text
from bench.model.drivers import manual_of
from bench.model.errors import BenchError, ExitStatus, InputError
from bench.plan import Station, load_station
from bench.run.bus.first_contact import AS_DOCUMENTED, NOT_TRIED, Tried, record_of, told_once, walk, write_record
from bench.run.bus.opener import open_bench, unheard
from bench.run.bus.talk import TalkSession
from bench.run.guard.drill import drill as run_drill
from bench.run.guard.guarding import station_lock
from bench.session.output import make_folder


def talk(role: str, command: str | None, station_name: str, out: Path, *, take_over: bool = False) -> int:
    """Send one command, or what is typed until an empty line; replies are printed, everything is recorded."""
    station = load_station(named_file("stations", station_name))
    _require(station, role)
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


def _require(station: Station, role: str) -> None:
    if role not in station.instruments:
        known = ", ".join(sorted(station.instruments))
        message = f"station {station.name} has no instrument {role!r}"
        raise InputError("B-CLI-003", message, where=role, next_step=f"use one of: {known}")


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


def commission(role: str, station_name: str, by: str, *, yes: bool) -> int:
    """Walk through one instrument and write the record; exit status 1 if a reply is not as documented.

    Raises: InputError B-CLI-003 (no such role), B-COM-001 (a driver without a table), B-COM-002 (the station is
            simulated in this process), and what opening and introducing the instrument raise.
    """
    path = named_file("stations", station_name)
    station = load_station(path)
    _require(station, role)
    entry = station.instruments[role]
    if station.in_process:
        text = f"station {station.name!r} is simulated in this process: there is nothing to get to know"
        raise InputError("B-COM-002", text, next_step="serve it with 'bench sim', or name the station of a real bench")
    manual = manual_of(entry.driver)
    if manual is None:
        text = f"the driver {entry.driver!r} has no table of its commands"
        raise InputError("B-COM-001", text, next_step=f"write {entry.driver}.yaml beside it: docs/instruments.md")
    out, clock = console(), WallClock()
    out.print(f"{manual.instrument} at {entry.resource}: {len(manual.commands)} commands, harmless ones first")

    def tell(one: Tried) -> None:
        said = f" -> {one.said}" if one.said else ""
        out.print(f"{one.outcome:14} {one.sent or one.form}{said}")
        if one.outcome not in (AS_DOCUMENTED, NOT_TRIED):
            out.print(f"{'':14} documented: {one.documented or 'no reply, no error'}")

    with station_lock(station, "commission", clock, [role]):
        bench = open_bench(station, clock, unheard, seed=0, links=False, roles=[role])
        try:
            instrument = bench.instruments[role]
            identity = instrument.introduce()
            out.print(f"{identity.manufacturer} {identity.model}, firmware {identity.firmware or 'not told'}")
            if left := instrument.drain_errors():
                out.print(f"errors that the last user left: {told_once(left)}")
            tried = walk(instrument, manual, (lambda text: True) if yes else typer.confirm, tell)
        finally:
            bench.close()
    at = utc_text(clock.utc_ns())
    written = write_record(path, record_of(role, entry.driver, identity, by, at, tried))
    counts = Counter(one.outcome for one in tried)
    out.print(", ".join(f"{count} {outcome}" for outcome, count in counts.items()))
    out.print(f"record   {written}")
    return ExitStatus.PASS if set(counts) <= {AS_DOCUMENTED, NOT_TRIED} else ExitStatus.VERDICT_FAIL
