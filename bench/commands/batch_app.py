"""``bench batch`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def batch(
    sessions: Annotated[list[Path], typer.Argument(metavar="SESSION...", help="sessions, or folders of sessions")],
    out: Annotated[Path, typer.Option("--out", help="folder for batch.json and batch.html")] = Path(),
    json: Annotated[bool, typer.Option("--json", help="print batch.json on standard output and nothing else")] = False,
) -> None:
    """Fit many sessions and compare their units: yield, distributions, the worst values."""
    from bench.commands import batch as batch_command

    raise typer.Exit(batch_command.batch(sessions, out, json))
