"""Arguments of ``bench archive``; the work is imported when it is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.history.app import AsJson, History, Out, history_url
from bench.commands.session_app import Language
from bench.commands.usage import App

app = App(help="All sessions ever recorded: where they are, whole or not, and what they would give today.")

Select = Annotated[
    list[str] | None,
    typer.Option(
        "--select",
        metavar="NAME=VALUE",
        help="uut, campaign, station, verdict, standard, certificate (of a standard), since, until (days)",
    ),
]
Dask = Annotated[
    str | None,
    typer.Option("--dask", metavar="tcp://HOST:PORT|local:N", help="on a Dask cluster, or in N processes"),
]


@app.command(epilog="Example: bench archive add sessions s3://calibrations/2026")
def add(
    folders: Annotated[list[str], typer.Argument(metavar="FOLDER|URL...", help="sessions, or folders of sessions")],
    everything: Annotated[bool, typer.Option("--all", help="read those again that have not changed")] = False,
    dask: Dask = None,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Enter sessions, every byte of them verified; what is known and has not changed is passed over."""
    from bench.commands.archive import adding as work

    return work.add(history_url(history, out), folders, everything, dask, json)


@app.command("list", epilog="Example: bench archive list --select uut=SIM-1 --select since=2026-01-01")
def list_all(
    select: Select = None,
    to: Annotated[Path | None, typer.Option("--to", help="write them to a .csv or .parquet file")] = None,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """One line per session, in order of time."""
    from bench.commands.archive import listing as work

    return work.list_all(history_url(history, out), select or [], to, json)


@app.command(epilog="Example: bench archive verify --dask local:4")
def verify(
    select: Select = None, dask: Dask = None, history: History = None, out: Out = None, json: AsJson = False
) -> int:
    """Read sessions again, every byte; exit status 5 if one is damaged, changed or gone."""
    from bench.commands.archive import adding as work

    return work.verify(history_url(history, out), select or [], dask, json)


@app.command(epilog="Example: bench archive where SIM-0001")
def where(
    word: Annotated[
        str, typer.Argument(help="serial number, certificate, software, or the beginning of the hash of a frame")
    ],
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Which sessions and certificates depend on a unit, a standard, a certificate, a frame or a release."""
    from bench.commands.archive import listing as work

    return work.where(history_url(history, out), word, json)


@app.command(epilog="Example: bench archive refit --with-standards corrected.yaml --to trial --dask local:2")
def refit(
    to: Annotated[Path, typer.Option("--to", metavar="FOLDER", help="for the outcome; the same one goes on")],
    method: Annotated[str | None, typer.Option("--method", help="a method of the analyses; default: their own")] = None,
    with_standards: Annotated[
        Path | None,
        typer.Option("--with-standards", metavar="FILE", help="standards in place of recorded certificates"),
    ] = None,
    select: Select = None,
    dask: Dask = None,
    history: History = None,
    out: Out = None,
) -> int:
    """Compute sessions again from their raw bytes, beside the released values; exit status 1 if one gives none."""
    from bench.commands.archive import refitting as work

    request = work.Request(to, method, with_standards, select or [], dask)
    return work.refit(history_url(history, out), request)


@app.command(epilog="Example: bench archive changes trial --html changes.html")
def changes(
    trial: Annotated[str, typer.Argument(help="the folder of a refit, or the beginning of its name")],
    html: Annotated[Path | None, typer.Option("--html", metavar="FILE", help="write the report as a page")] = None,
    lang: Language = "en",
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """What a refit would change: quantities, verdicts, certificates, and the last good evidence of each standard."""
    from bench.commands.archive import changing as work

    return work.changes(history_url(history, out), trial, html, lang, json)
