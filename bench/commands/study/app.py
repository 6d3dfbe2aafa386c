"""``bench study`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def study(
    name: Annotated[str, typer.Argument(help="which study; a wrong one lists those that are installed")],
    runs: Annotated[
        int | None, typer.Option("--runs", help="Monte Carlo runs of each case; default 50, with --quick 6")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="of all errors that are drawn", min=0)] = 1,
    offsets: Annotated[
        str, typer.Option("--offsets", metavar="MS,MS,...", help="time offsets, milliseconds; 0 among them")
    ] = "0,10,20,30",
    quick: Annotated[
        bool, typer.Option("--quick", help="few runs, a shorter flight; what needs 50 runs is not judged")
    ] = False,
    dask: Annotated[
        str | None,
        typer.Option("--dask", metavar="tcp://HOST:PORT|local:N", help="compute on a Dask cluster, or in N processes"),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="folder for study.json and report.html")] = Path("study"),
    json: Annotated[bool, typer.Option("--json", help="print study.json on standard output and nothing else")] = False,
) -> None:
    """Repeat a published simulation study, many runs of each case, and hold it against the published numbers."""
    from bench.commands.study import study as study_command

    request = study_command.Request(name, runs, seed, offsets, quick, dask, out, json)
    raise typer.Exit(study_command.study(request))
