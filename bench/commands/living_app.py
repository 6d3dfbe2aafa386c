"""Arguments of the commands for a run that is alive: a word with it, and a look at it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.session_app import Language, SessionFolder


def pause(
    session: SessionFolder,
    reason: Annotated[
        str, typer.Option("--reason", metavar="TEXT", help="why; it is shown and recorded")
    ] = "asked from a terminal",
) -> int:
    """Let a living run stand still and switch its stimulus off; 'bench resume SESSION' lets it go on."""
    from bench.commands import control as control_command

    return control_command.pause(session, reason)


def abort(
    session: SessionFolder,
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="why; it is recorded")] = "",
) -> int:
    """End a living run at its next check; its bench is made safe and its session closed."""
    from bench.commands import control as control_command

    return control_command.abort(session, reason)


def shelve(
    session: SessionFolder,
    alarm: Annotated[str, typer.Argument(help="its number, as 'bench top' shows it")],
    duration: Annotated[str, typer.Option("--for", metavar="TIME", help="1 min to 8 h, with its unit")],
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="why; it is shown and recorded")],
) -> int:
    """Shelve an alarm of a living run: it is shown as such, and nobody is notified of it for a while."""
    from bench.commands import control as control_command

    return control_command.shelve(session, alarm, duration, reason)


def answer(
    session: SessionFolder,
    value: Annotated[str, typer.Argument(help="with its unit; nothing: what is asked is so")] = "",
) -> int:
    """Answer the prompt a living run waits at; without a value it is confirmed."""
    from bench.commands import control as control_command

    return control_command.answer(session, value)


def top(
    session: Annotated[
        Path | None, typer.Argument(help="the folder of a living run; default: the newest one in --out")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="folder of the sessions")] = Path("sessions"),
    lang: Language = "en",
) -> int:
    """Watch a living run in the terminal, over ssh too; leaving it changes nothing."""
    from bench.commands import top as top_command

    return top_command.top(session, out, lang)
