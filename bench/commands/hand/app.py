"""Arguments of the commands for a person at the bench: an instrument by hand, its first contact, the drill."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.session_app import AsJson

TakeOver = Annotated[
    bool, typer.Option("--take-over", help="you are at the bench: send home a guard that cannot confirm everything off")
]


def talk(
    instrument: Annotated[str, typer.Argument(help="role in the station file")],
    command: Annotated[
        str | None, typer.Argument(help="one command; without it: type commands, an empty line ends")
    ] = None,
    station: Annotated[str, typer.Option("--station", help="a station file or name")] = "af_bench_sim",
    out: Annotated[Path, typer.Option("--out", help="folder for sessions")] = Path("sessions"),
    take_over: TakeOver = False,
) -> int:
    """Reach an instrument by hand; every command and reply goes to a session of its own."""
    from bench.commands.hand import by_hand

    return by_hand.talk(instrument, command, station, out, take_over=take_over)


def commission(
    instrument: Annotated[str, typer.Argument(metavar="ROLE", help="role of the instrument in the station")],
    station: Annotated[str, typer.Option("--station", help="station file of the bench")],
    by: Annotated[str, typer.Option("--by", metavar="NAME", help="who stands at the bench; it is recorded")],
    yes: Annotated[
        bool, typer.Option("--yes", help="send what energises or moves without asking; for a simulated bench")
    ] = False,
) -> int:
    """Walk through a real instrument for the first time: each command its driver uses, held against its manual."""
    from bench.commands.hand import commission as commission_command

    return commission_command.commission(instrument, station, by, yes=yes)


def drill(
    station: Annotated[str, typer.Option("--station", help="a station file or name")] = "af_bench_sim",
    out: Annotated[Path, typer.Option("--out", help="folder for sessions")] = Path("sessions"),
    take_over: TakeOver = False,
    json: AsJson = False,
) -> int:
    """Kill a controller that drives a harmless stimulus, and prove that the guard leaves the bench safe within 5 s."""
    from bench.commands.hand import by_hand

    return by_hand.drill(station, out, json, take_over=take_over)
