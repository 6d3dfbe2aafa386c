"""Arguments of the commands for a person at the bench and for a run that is alive there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.requests import AsJson, Language, SessionFolder, SessionsOut, TakeOver
from bench.commands.usage import App

app = App()

Station = Annotated[str, typer.Option(help="a station file or name")]
Why = Annotated[str, typer.Option(metavar="TEXT", help="why; it is shown and recorded")]


@app.command(epilog='Example: bench talk calibrator "OUT?"')
def talk(
    instrument: Annotated[str, typer.Argument(help="role in the station file")],
    command: Annotated[
        str | None, typer.Argument(help="one command; without it: type commands, an empty line ends")
    ] = None,
    station: Station = "af_bench_sim",
    out: SessionsOut = Path("sessions"),
    take_over: TakeOver = False,
) -> int:
    """Reach an instrument by hand; every command and reply goes to a session of its own."""
    from bench.commands.hand import by_hand as work

    return work.talk(instrument, command, station, out, take_over=take_over)


@app.command(epilog="Example: bench commission turntable --station my_bench.yaml --by 'A. Technician'")
def commission(
    instrument: Annotated[str, typer.Argument(metavar="ROLE", help="role of the instrument in the station")],
    station: Annotated[str, typer.Option(help="station file of the bench")],
    by: Annotated[str, typer.Option(metavar="NAME", help="who stands at the bench; it is recorded")],
    yes: Annotated[
        bool, typer.Option("--yes", help="send what energises or moves without asking; for a simulated bench")
    ] = False,
) -> int:
    """Walk through a real instrument for the first time: each command its driver uses, held against its manual."""
    from bench.commands.hand import commission as work

    return work.commission(instrument, station, by, yes=yes)


@app.command(epilog="Example: bench drill --station af_bench_sim")
def drill(
    station: Station = "af_bench_sim",
    out: SessionsOut = Path("sessions"),
    take_over: TakeOver = False,
    json: AsJson = False,
) -> int:
    """Kill a controller that drives a harmless stimulus, and prove that the guard leaves the bench safe within 5 s."""
    from bench.commands.hand import by_hand as work

    return work.drill(station, out, json, take_over=take_over)


@app.command(epilog='Example: bench pause sessions/20260101T180000Z_scale_factor_38h_17 --reason "door opened"')
def pause(session: SessionFolder, reason: Why = "asked from a terminal") -> int:
    """Let a living run stand still and switch its stimulus off; 'bench resume SESSION' lets it go on."""
    from bench.commands import control as work

    return work.pause(session, reason)


@app.command(epilog="Example: bench abort sessions/20260101T180000Z_scale_factor_38h_17")
def abort(
    session: SessionFolder,
    reason: Annotated[str, typer.Option(metavar="TEXT", help="why; it is recorded")] = "",
) -> int:
    """End a living run at its next check; its bench is made safe and its session closed."""
    from bench.commands import control as work

    return work.abort(session, reason)


@app.command(epilog="Example: bench shelve sessions/NAME 2 --for '30 min' --reason 'the door is being mended'")
def shelve(
    session: SessionFolder,
    alarm: Annotated[str, typer.Argument(help="its number, as 'bench top' shows it")],
    duration: Annotated[str, typer.Option("--for", metavar="TIME", help="1 min to 8 h, with its unit")],
    reason: Why,
) -> int:
    """Shelve an alarm of a living run: it is shown as such, and nobody is notified of it for a while."""
    from bench.commands import control as work

    return work.shelve(session, alarm, duration, reason)


@app.command(epilog="Example: bench answer sessions/20260101T180000Z_scale_factor_38h_17 '0.2 ohm'")
def answer(
    session: SessionFolder,
    value: Annotated[str, typer.Argument(help="with its unit; nothing: what is asked is so")] = "",
) -> int:
    """Answer the prompt a living run waits at; without a value it is confirmed."""
    from bench.commands import control as work

    return work.answer(session, value)


@app.command(epilog="Example: bench top")
def top(
    session: Annotated[
        Path | None, typer.Argument(help="the folder of a living run; default: the newest one in --out")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder of the sessions")] = Path("sessions"),
    lang: Language = "en",
) -> int:
    """Watch a living run in the terminal, over ssh too; leaving it changes nothing."""
    from bench.commands import top as work

    return work.top(session, out, lang)
