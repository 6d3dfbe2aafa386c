"""Arguments of ``bench init`` and ``bench list``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.session_app import AsJson


def init(
    folder: Annotated[Path, typer.Argument(help="a new folder")],
    name: Annotated[str | None, typer.Option("--name", help="of the laboratory")] = None,
    model: Annotated[str | None, typer.Option("--model", help="of the unit under test")] = None,
    serial: Annotated[str | None, typer.Option("--serial", help="its serial number")] = None,
    station: Annotated[str | None, typer.Option("--station", help="the simulated bench to begin with")] = None,
) -> int:
    """Make a laboratory's own folder: sequences, stations, frames and code of its own."""
    from bench.commands.lab import init as init_command

    given = {"name": name, "model": model, "serial": serial, "station": station}
    return init_command.init(folder, given)


def list_all(
    kind: Annotated[
        str | None, typer.Argument(help="sequences, stations, frames, instruments or analyses; default: all")
    ] = None,
    json: AsJson = False,
) -> int:
    """List what a sequence or a command can name, and where it comes from: this lab folder or an installation."""
    from bench.commands.lab import listing

    return listing.print_list(kind, json)
