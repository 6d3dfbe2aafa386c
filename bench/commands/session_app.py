"""Arguments of the commands that read a recorded session; what decodes and fits is loaded once there is a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.model.segments import session_segments

SessionFolder = Annotated[Path, typer.Argument(help="the folder of a session")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON document on standard output and nothing else")]
Method = Annotated[str | None, typer.Option("--method", help="a method of the analysis; a wrong one lists them")]


def replay(session: SessionFolder, json: AsJson = False) -> None:
    """Decode the raw bytes again through today's decoder and fits; says whether every number is identical."""
    session_segments(session)  # before what decodes and fits is loaded
    from bench.commands import session as session_command

    raise typer.Exit(session_command.replay(session, json))


def fit(
    session: SessionFolder,
    method: Method = None,
    make_up: Annotated[
        list[Path] | None, typer.Option("--with", metavar="SESSION", help="a make-up session that completes this one")
    ] = None,
    json: AsJson = False,
) -> None:
    """Results of a session by a method of your choice; nothing is written."""
    session_segments(session)
    from bench.commands import session as session_command

    raise typer.Exit(session_command.fit(session, method, json, make_up or []))


def report(
    session: SessionFolder,
    pdf: Annotated[bool, typer.Option("--pdf", help="write report.pdf too (extra 'pdf')")] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="derive everything again from the raw bytes, compare, write nothing")
    ] = False,
    json: AsJson = False,
) -> None:
    """Write report.html again from the session alone; or say whether results and report are what it gives."""
    session_segments(session)
    if verify:
        from bench.commands.verify import verify as verify_command

        raise typer.Exit(verify_command.verify(session, json))
    from bench.commands import session as session_command

    raise typer.Exit(session_command.report(session, pdf))
