"""Arguments of ``bench archive``; the work is imported when it is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from bench.commands.requests import AsJson, Dask, Language, Place, RefitRequest, Select
from bench.commands.usage import App

app = App(help="All sessions ever recorded: where they are, whole or not, and what they would give today.")


@app.command(work="archive.computing", epilog="Example: bench archive add sessions s3://calibrations/2026")
def add(
    *,
    folders: Annotated[list[str], Argument(metavar="FOLDER|URL...", help="sessions, or folders of sessions")],
    everything: Annotated[bool, Option("--all", help="read those again that have not changed")] = False,
    dask: Dask = None,
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Enter sessions, every byte of them verified; what is known and has not changed is passed over."""


@app.command(
    "list", work="archive.listing", epilog="Example: bench archive list --select uut=SIM-1 --select since=2026-01-01"
)
def list_all(
    *,
    select: Select = None,
    to: Annotated[Path | None, Option(help="write them to a .csv or .parquet file")] = None,
    place: Place,
    as_json: AsJson = False,
) -> None:
    """One line per session, in order of time."""


@app.command(work="archive.computing", epilog="Example: bench archive verify --dask local:4")
def verify(*, select: Select = None, dask: Dask = None, place: Place, as_json: AsJson = False) -> None:
    """Read sessions again, every byte; exit status 5 if one is damaged, changed or gone."""


@app.command(work="archive.listing", epilog="Example: bench archive where SIM-0001")
def where(
    word: Annotated[
        str, Argument(help="serial number, certificate, software, or the beginning of the hash of a frame")
    ],
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Which sessions and certificates depend on a unit, a standard, a certificate, a frame or a release."""


@app.command(
    work="archive.computing",
    epilog="Example: bench archive refit --with-standards corrected.yaml --to trial --dask local:2",
)
def refit(request: RefitRequest, place: Place) -> None:
    """Compute sessions again from their raw bytes, beside the released values; exit status 1 if one gives none."""


@app.command(work="archive.listing", epilog="Example: bench archive changes trial --html changes.html")
def changes(
    *,
    trial: Annotated[str, Argument(help="the folder of a refit, or the beginning of its name")],
    html: Annotated[Path | None, Option(metavar="FILE", help="write the report as a page")] = None,
    language: Language = "en",
    place: Place,
    as_json: AsJson = False,
) -> None:
    """What a refit would change: quantities, verdicts, certificates, and the last good evidence of each standard."""
