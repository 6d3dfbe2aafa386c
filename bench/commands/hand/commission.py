"""``bench commission``: the first contact with a real instrument, walked through with a person at the bench."""

from __future__ import annotations

from collections import Counter

import typer

from bench.commands.console import console, named_file
from bench.model.clock import WallClock, utc_text
from bench.model.drivers import manual_of
from bench.model.errors import ExitStatus, InputError
from bench.plan import load_station
from bench.run.bus.first_contact import AS_DOCUMENTED, NOT_TRIED, Tried, record_of, told_once, walk, write_record
from bench.run.bus.opener import open_bench, unheard
from bench.run.guard.guarding import station_lock


def commission(role: str, station_name: str, by: str, *, yes: bool) -> int:
    """Walk through one instrument and write the record; exit status 1 if a reply is not as documented.

    Raises: InputError B-CLI-003 (no such role), B-COM-001 (a driver without a table), B-COM-002 (the station is
            simulated in this process), and what opening and introducing the instrument raise.
    """
    path = named_file("stations", station_name)
    station = load_station(path)
    entry = station.instruments.get(role)
    if entry is None:
        known = ", ".join(station.instruments)
        raise InputError("B-CLI-003", f"station {station.name!r} has no {role!r}", next_step=f"one of: {known}")
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
