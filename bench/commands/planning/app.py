"""Arguments of ``bench plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.session_app import AsJson
from bench.commands.usage import completing


def plan(
    sequence: Annotated[
        str,
        typer.Argument(help="a sequence file, or the name of a shipped one", autocompletion=completing("sequences")),
    ],
    station: Annotated[
        str | None,
        typer.Option("--station", help="a station file or name", autocompletion=completing("stations")),
    ] = None,
    targets: Annotated[
        list[str] | None,
        typer.Option("--target", metavar="QUANTITY=U", help="95 %; default: random parts and coefficients as today"),
    ] = None,
    within: Annotated[str | None, typer.Option("--within", metavar="TIME", help="the best plan in this time")] = None,
    lag: Annotated[
        str | None, typer.Option("--lag", metavar="TIME", help="of the unit behind the chamber's set-point")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="write the sequence")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="draw hours against uncertainty as SVG")] = None,
    json: AsJson = False,
) -> int:
    """Find the shortest sequence that reaches an uncertainty, and say what each change buys and what is still seen."""
    from bench.commands.planning import plan as plan_command

    request = plan_command.Request(sequence, station, targets or [], within, lag, out, plot, json)
    return plan_command.plan(request)
