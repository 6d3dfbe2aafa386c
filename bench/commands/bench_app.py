"""Arguments of the commands for a person at the bench and for a run that is alive there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from bench.commands.requests import AsJson, Language, SessionFolder, SessionsOut, TakeOver
from bench.commands.usage import App

app = App()

Station = Annotated[str, Option("--station", help="a station file or name")]
Why = Annotated[str, Option(metavar="TEXT", help="why; it is shown and recorded")]


@app.command(work="hand", epilog='Example: bench talk calibrator "OUT?"')
def talk(
    role: Annotated[str, Argument(metavar="INSTRUMENT", help="role in the station file")],
    command: Annotated[str | None, Argument(help="one command; without it: type commands, an empty line ends")] = None,
    station_name: Station = "af_bench_sim",
    out: SessionsOut = Path("sessions"),
    take_over: TakeOver = False,
) -> None:
    """Reach an instrument by hand; every command and reply goes to a session of its own."""


@app.command(work="hand", epilog="Example: bench commission turntable --station my_bench.yaml --by 'A. Technician'")
def commission(
    role: Annotated[str, Argument(metavar="ROLE", help="role of the instrument in the station")],
    station_name: Annotated[str, Option("--station", help="station file of the bench")],
    by: Annotated[str, Option(metavar="NAME", help="who stands at the bench; it is recorded")],
    yes: Annotated[
        bool, Option("--yes", help="send what energises or moves without asking; for a simulated bench")
    ] = False,
) -> None:
    """Walk through a real instrument for the first time: each command its driver uses, held against its manual."""


@app.command(work="hand", epilog="Example: bench drill --station af_bench_sim")
def drill(
    station_name: Station = "af_bench_sim",
    out: SessionsOut = Path("sessions"),
    take_over: TakeOver = False,
    as_json: AsJson = False,
) -> None:
    """Kill a controller that drives a harmless stimulus, and prove that the guard leaves the bench safe within 5 s."""


@app.command(
    work="control", epilog='Example: bench pause sessions/20260101T180000Z_scale_factor_38h_17 --reason "door opened"'
)
def pause(folder: SessionFolder, reason: Why = "asked from a terminal") -> None:
    """Let a living run stand still and switch its stimulus off; 'bench resume SESSION' lets it go on."""


@app.command(work="control", epilog="Example: bench abort sessions/20260101T180000Z_scale_factor_38h_17")
def abort(
    folder: SessionFolder,
    reason: Annotated[str, Option(metavar="TEXT", help="why; it is recorded")] = "",
) -> None:
    """End a living run at its next check; its bench is made safe and its session closed."""


@app.command(
    work="control", epilog="Example: bench shelve sessions/NAME 2 --for '30 min' --reason 'the door is being mended'"
)
def shelve(
    folder: SessionFolder,
    alarm: Annotated[str, Argument(help="its number, as 'bench top' shows it")],
    duration: Annotated[str, Option("--for", metavar="TIME", help="1 min to 8 h, with its unit")],
    reason: Why,
) -> None:
    """Shelve an alarm of a living run: it is shown as such, and nobody is notified of it for a while."""


@app.command(work="control", epilog="Example: bench answer sessions/20260101T180000Z_scale_factor_38h_17 '0.2 ohm'")
def answer(
    folder: SessionFolder,
    value: Annotated[str, Argument(help="with its unit; nothing: what is asked is so")] = "",
) -> None:
    """Answer the prompt a living run waits at; without a value it is confirmed."""


@app.command(work="top", epilog="Example: bench top")
def top(
    session: Annotated[
        Path | None, Argument(help="the folder of a living run; default: the newest one in --out")
    ] = None,
    out: Annotated[Path, Option(help="folder of the sessions")] = Path("sessions"),
    language: Language = "en",
) -> None:
    """Watch a living run in the terminal, over ssh too; leaving it changes nothing."""
