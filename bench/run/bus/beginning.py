"""Conditions before a session exists: known instruments, a bench in its safe state, room on the disk."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from bench.model.clock import Clock
from bench.model.errors import BenchError, InputError, InstallationError, InstrumentError
from bench.model.installed import unforeseen
from bench.model.ports import Identity
from bench.plan import Plan, Station, summarise
from bench.run.bus.opener import OpenBench
from bench.run.bus.safety import make_safe
from bench.run.bus.side_by_side import asked

SPACE_FACTOR = 2
SILENT = "B-INST-001"


def begin_safely(bench: OpenBench, clock: Clock, look: Callable[[], object] = lambda: None) -> dict[str, Identity]:
    """Bring the whole bench to its safe state, then prepare every instrument: a run starts from a known one.

    Nothing is set at an instrument that is on: who is there is asked first, then what is on goes off. ``look`` is
    called when that is done and nothing is prepared yet.

    Whatever goes wrong, everything that can be made safe is made safe first; the error carries a note (PEP 678) for
    each instrument that is not confirmed safe.
    Raises: InstrumentError of the first instrument that does not answer, is of another model (B-INST-002) or of another
            serial number than the register's (B-RUN-006); RunError B-RUN-060 if one cannot be made safe.
    """
    resources = {role: bench.station.instruments[role].resource for role in bench.instruments}
    answers = asked(resources, lambda role: _tried(lambda: _introduced(bench, role)), clock)
    identities = {role: answer for role, answer in answers.items() if isinstance(answer, Identity)}
    problems = {role: answer for role, answer in answers.items() if isinstance(answer, BenchError)}
    mute = {role for role, error in problems.items() if error.code == SILENT}
    unsafe = make_safe(bench.instruments, bench.station.safe_order, clock, mute)
    problem = next(iter(problems.values()), None) or next(iter(unsafe), None)
    if problem is None:
        look()
        prepared = asked(resources, lambda role: _tried(bench.instruments[role].identify), clock)
        problem = next((answer for answer in prepared.values() if isinstance(answer, BenchError)), None)
    if problem is not None:
        for failure in unsafe:
            if failure is not problem:
                problem.add_note(str(failure))
        if isinstance(problem, InstallationError) and not unsafe:
            problem.add_note("The bench is safe, and no session was begun.")
        raise problem
    return identities


def _introduced(bench: OpenBench, role: str) -> Identity:
    identity = bench.instruments[role].introduce()
    _check_serial(bench.station, role, identity)
    return identity


def _tried(ask: Callable[[], Identity]) -> Identity | BenchError:
    try:
        return ask()
    except Exception as error:
        return unforeseen(error)


def _check_serial(station: Station, role: str, identity: Identity) -> None:
    standard = station.instruments[role].standard
    if standard is None or identity.serial in ("", "0") or identity.serial == standard.serial:
        return
    raise InstrumentError(
        "B-RUN-006",
        f"serial number {identity.serial!r} answers, the register holds the certificate of {standard.serial!r}",
        where=role,
        next_step="correct the register in the station file, or connect the instrument it names",
    )


def folder_above(folder: Path) -> Path:
    """Return a folder, or the nearest above it that exists, which is on the same disk."""
    return next(place for place in (folder.absolute(), *folder.absolute().parents) if place.is_dir())


def check_space(plan: Plan, out: Path) -> None:
    """Raise InputError B-RUN-005 unless the disk has twice the room the plan needs."""
    needed = SPACE_FACTOR * summarise(plan).disk_bytes
    free = shutil.disk_usage(folder_above(out)).free
    if free < needed:
        raise InputError(
            "B-RUN-005",
            f"{free / 1e6:.0f} MB are free, {needed / 1e6:.0f} MB are due ({SPACE_FACTOR} times the plan's need)",
            where=str(out),
            next_step="free space, or choose another folder with --out",
        )


def identities_of(identities: Mapping[str, Identity]) -> dict[str, dict[str, str]]:
    """Return identities as the manifest holds them."""
    return {role: dict(vars(identity)) for role, identity in identities.items()}
