"""``bench sim``: the simulated bench as a process in real time, and its fault switches."""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import typer

from bench.commands.check import settings_of
from bench.commands.console import named_file
from bench.model.clock import NS, WallClock
from bench.model.errors import InputError, InputErrors
from bench.model.posix import require
from bench.plan import Findings, Station, check_station, load_station, served_station
from bench.run.bus.served_world import told
from bench.session.output import write_file

PROCESS = "sim_instruments.served.process"  # by name: the bench never imports its simulators
FAULT = "fault"
MOST_RATE = 1000.0


def sim(
    words: Sequence[str], folder: Path, rate: float, seed: int, settings: Sequence[str] | None, *, clean: bool = False
) -> None:
    """Serve the station named by the only word, or switch faults: ``fault [NAME [TARGET] [VALUE]...]``."""
    for word in words:
        if word.startswith("-") and not _is_number(word):
            message = f"{word!r} is no option"
            raise InputError("B-SIM-017", message, next_step="bench sim --help shows how it is used")
    if words[0] == FAULT:
        fault(words[1:], folder)
        return
    if len(words) > 1:
        message = f"{words[1]!r} is one word too many"
        raise InputError("B-SIM-017", message, next_step="bench sim STATION, or bench sim fault")
    serve(words[0], folder, rate, seed, settings or (), clean=clean)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def serve(name: str, folder: Path, rate: float, seed: int, settings: Sequence[str], *, clean: bool = False) -> None:
    """Serve a simulated station until SIGINT or SIGTERM; its instruments are as their last user left them, or clean.

    Raises: InputError B-SIM-016 (the station has no world), B-SIM-017 (bad rate), B-SIM-013, B-SIM-014.
    """
    if not 0.0 < rate <= MOST_RATE or math.isnan(rate):
        message = f"a rate of {rate:g} is not possible"
        raise InputError("B-SIM-017", message, where="--rate", next_step=f"more than 0, at most {MOST_RATE:g}")
    require("a simulated bench in real time")
    station = _station(name, settings)
    world = station.file.world
    assert world is not None
    process = importlib.import_module(PROCESS)
    folder = folder.absolute()
    bench = process.ServedBench(
        world.name, station.wiring(), station.world_options, seed=seed, rate=rate, folder=folder, clean=clean
    )
    try:
        today = datetime.fromtimestamp(WallClock().utc_ns() / NS, UTC).date()
        path = folder / process.STATION
        control = folder / process.CONTROL
        write_file(path, served_station(station, bench.servers.resources(), bench.urls, control, today))
        _announce(station, bench, path)
        bench.wait()
    finally:
        bench.close()


def _station(name: str, settings: Sequence[str]) -> Station:
    station = load_station(named_file("stations", name))
    if not station.in_process:
        message = f"station {station.name!r} has no simulated world"
        raise InputError("B-SIM-016", message, where=name, next_step="serve a simulated station, such as af_rack_sim")
    options = {}
    for key, value in settings_of(settings).items():
        if not key.startswith("world."):
            message = f"{key!r} is no option of the simulated world"
            raise InputError("B-SIM-017", message, where="--set", next_step="for example --set world.noise=off")
        options[key.removeprefix("world.")] = value
    station = station.with_options(options)
    findings = Findings()
    check_station(station, findings)
    if findings:
        raise InputErrors(findings.sorted())
    return station


def _announce(station: Station, bench: Any, path: Path) -> None:
    for name, port in bench.moved.items():
        text = f"{name}: port {port} is taken, another one is used; a session begun on it cannot be resumed here"
        typer.echo(text, err=True)
    resources, sockets = bench.servers.resources(), bench.servers.sockets()
    for number, (role, entry) in enumerate(station.instruments.items(), start=1):
        typer.echo(f"{role}: {entry.driver} at {resources[role]}, raw socket {sockets[role]}, GPIB0::{number}::INSTR")
    typer.echo(f"GPIB0: adapter {bench.servers.adapter}")
    for name, link in station.links.items():
        port = f"{link.baud} baud, at {bench.urls[name]}" if link.instrument is None else f"read from {link.instrument}"
        typer.echo(f"{name}: {link.frame}, {port}")
    typer.echo(f"station: {path}")
    typer.echo("ready")


def fault(words: Sequence[str], folder: Path) -> None:
    """List the faults, or hand the words to the bench that lives in ``folder`` and print its reply.

    Raises: InputError B-SIM-015 (no bench lives there), or the bench's own.
    """
    process = importlib.import_module(PROCESS)
    if not words:
        typer.echo("\n".join([*process.fault_listing(), "clear", "state"]))
        return
    reply = told(folder / process.CONTROL, words)
    if "state" in reply:
        typer.echo(json.dumps(reply["state"], indent=1))
    else:
        typer.echo("\n".join(f"on: {line}" for line in reply["lines"]) or "no fault is on")
