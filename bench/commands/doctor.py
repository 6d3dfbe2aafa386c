"""``bench doctor``: is this machine fit for a run; and what somebody who is to help needs to know."""

from __future__ import annotations

import json
import platform
import zipfile
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path

from rich.console import Console

from bench.commands.console import console, headed_table, named_file, print_json, say
from bench.model.clock import WallClock
from bench.model.errors import InstallationError
from bench.model.installed import (
    KINDS,
    Kind,
    Refusal,
    driver_packages,
    driver_refusals,
    offer_of,
    offers,
    try_foreign,
    world_parts,
)
from bench.model.systems import analyses, system_refusals, try_analysis
from bench.plan import Findings, Station, check_station, load_station
from bench.run.bus.opener import missing_buses
from bench.run.preflight import Finding, Report, Status, Surroundings, examine_machine
from bench.run.provenance import software
from bench.session.output import writing

_COLUMNS = ("", "looked at", "found", "due")
_MARKS = {Status.OK: "ok", Status.WARN: "WARN", Status.FAIL: "FAIL", Status.SKIPPED: "-"}


def doctor(station: str | None, out: Path, bundle: Path | None, as_json: bool) -> None:
    """Look at what is installed, at the machine and at a station file; write a bundle for whoever is to help, if asked.

    The bundle holds what was found, versions and the station file; no session, no environment, no name of a user.
    Raises: InstallationError B-PKG-002 to -004 for the bench itself, first of all; InputError B-RUN-080 if something
            keeps every run from starting.
    """
    path = None if station is None else named_file("stations", station)
    installed = _installed()
    report = examine_machine(Surroundings(clock=WallClock(), out=out))
    report = Report((*installed, *([] if path is None else _of_station(path)), *report.findings))
    system = {"system": platform.system(), "release": platform.release(), "machine": platform.machine()}
    document = {
        "machine": system,
        "software": software(),
        "installed": [asdict(offer) for kind in KINDS for offer in offers(kind)],
        "findings": report.event().document(),
    }
    if bundle is not None:
        with writing(bundle), zipfile.ZipFile(bundle, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("doctor.json", json.dumps(document, indent=1) + "\n")
            if path is not None:
                archive.writestr(path.name, path.read_text(encoding="utf-8"))
    if as_json:
        print_json(document)
    else:
        print_preflight(console(), report, "Doctor")
        if bundle is not None:
            say(f"bundle: {bundle}")
    if (refusal := report.refusal()) is not None:
        raise refusal


def _installed() -> list[Finding]:
    """Return a line for each distribution that brought systems, worlds or drivers; every foreign part is loaded.

    A foreign one that cannot be used is a warning: it stops who names it, and no other run.
    """
    refusals = {offer: error for kind in KINDS for offer, error in _refusals(kind)}
    lines: dict[str, list[str]] = {}
    for offer in [offer for kind in KINDS for offer in offers(kind) if offer not in refusals]:
        lines.setdefault(f"{offer.kind} of {offer.release}", []).append(offer.name)
    refused = [
        Finding(f"{offer.kind} of {offer.release}", Status.WARN, f"{offer.name}: {error.code}", "read", str(error))
        for offer, error in refusals.items()
    ]
    return [*(Finding(kind, Status.OK, ", ".join(names), "read") for kind, names in lines.items()), *refused]


def _refusals(kind: Kind) -> Iterator[Refusal]:
    """Yield the foreign offers of a kind that cannot be used."""
    if kind == "systems":
        yield from system_refusals()
        tries = [(entry.offer, partial(try_analysis, name)) for name, entry in analyses().items()]
    elif kind == "worlds":
        tries = [(offer, partial(try_foreign, offer.package, world_parts(offer))) for offer in offers(kind)]
    else:
        yield from driver_refusals()
        tries = [(one.offer, partial(try_foreign, one.offer.package, one.parts())) for one in driver_packages()]
    for offer, attempt in tries:
        try:
            offer_of(kind, offer.name)
            attempt()
        except InstallationError as error:
            yield Refusal(offer, error)


def _of_station(path: Path) -> list[Finding]:
    """Return the static check of a station by itself."""
    mistakes = Findings()
    loaded = load_station(path)
    check_station(loaded, mistakes)
    if not mistakes:
        text = f"{len(loaded.instruments)} instruments, {len(loaded.links)} links"
        return [Finding("station file", Status.OK, text, "no mistake"), *_buses(loaded)]
    return [
        Finding("station file", Status.FAIL, mistake.code, "no mistake", str(mistake)) for mistake in mistakes.sorted()
    ]


def _buses(station: Station) -> list[Finding]:
    """Return whether the VISA library is there, and what it needs for the interfaces of a real station."""
    if station.file.world is not None:
        return []
    missing = {id(error): error for error in missing_buses(station).values()}
    found = [
        Finding("VISA library", Status.FAIL, error.code, "is there", f"{error.message}; {error.next_step}")
        for error in missing.values()
    ]
    return found or [Finding("VISA library", Status.OK, station.file.visa, "is there")]


def print_preflight(out: Console, report: Report, title: str = "Pre-flight") -> None:
    """Print one line for each finding, and under the table a sentence for each that is not simply in order."""
    rows = [(_MARKS[finding.status], finding.name, finding.value, finding.limit) for finding in report.findings]
    out.print(headed_table(title, _COLUMNS, rows, whole=_COLUMNS[:2]))
    for status in (Status.FAIL, Status.WARN, Status.SKIPPED):
        for finding in report.of(status):
            out.print(f"{_MARKS[finding.status]:4} {finding.name}: {finding.text or 'no judgement'}")
    counts = [f"{len(report.of(status))} {status}" for status in Status]
    out.print(", ".join(counts))
