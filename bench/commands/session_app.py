"""Arguments of the commands that read recorded sessions, and of the study of simulated ones.

What decodes, fits and computes is loaded once there is a session.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.model.segments import session_segments

SessionFolder = Annotated[Path, typer.Argument(help="the folder of a session")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON document on standard output and nothing else")]
Fresh = Annotated[bool, typer.Option("--fresh", help="compute everything again, though it is kept from before")]
Accept = Annotated[
    list[str] | None,
    typer.Option("--accept", metavar="QUANTITY", help="release doubtful values: dsf_n, or 'dsf_n channel=2'"),
]
By = Annotated[str, typer.Option("--by", metavar="NAME", help="who accepts")]
Reason = Annotated[str, typer.Option("--reason", metavar="TEXT", help="why it is accepted")]
Language = Annotated[str, typer.Option("--lang", metavar="LANGUAGE", help="en or ko")]
Method = Annotated[str | None, typer.Option("--method", help="a method of the analysis; a wrong one lists them")]


def replay(session: SessionFolder, json: AsJson = False) -> int:
    """Decode the raw bytes again through today's decoder and fits; says whether every number is identical."""
    session_segments(session)  # before what decodes and fits is loaded
    from bench.commands import session as session_command

    return session_command.replay(session, json)


def fit(
    session: SessionFolder,
    method: Method = None,
    make_up: Annotated[
        list[Path] | None, typer.Option("--with", metavar="SESSION", help="a make-up session that completes this one")
    ] = None,
    json: AsJson = False,
    fresh: Fresh = False,
    accept: Accept = None,
    by: By = "",
    reason: Reason = "",
) -> int:
    """Results of a session by a method of your choice; nothing is written into the session unless you accept."""
    session_segments(session)
    from bench.commands import accept as accept_command
    from bench.commands import fit as fit_command

    accepted = accept_command.Acceptance.asked(accept, by, reason)
    if accepted is not None:
        accept_command.accept(session, accepted, method, make_up or [])
    return fit_command.fit(session, method, json, make_up or [], fresh)


def report(
    session: SessionFolder,
    pdf: Annotated[bool, typer.Option("--pdf", help="write report.pdf too (extra 'pdf')")] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="derive everything again from the raw bytes, compare, write nothing")
    ] = False,
    laboratory: Annotated[
        Path | None,
        typer.Option("--laboratory", help="a laboratory file for the first page; the session keeps a copy of it"),
    ] = None,
    lang: Language = "en",
    json: AsJson = False,
    fresh: Fresh = False,
    accept: Accept = None,
    by: By = "",
    reason: Reason = "",
) -> int:
    """Write report.html again from the session alone; or say whether results and report are what it gives."""
    session_segments(session)
    if verify:
        from bench.commands import verify as verify_command

        return verify_command.verify(session, json)
    from bench.commands import accept as accept_command
    from bench.commands import fit as fit_command

    accepted = accept_command.Acceptance.asked(accept, by, reason)
    if accepted is not None:
        accept_command.accept(session, accepted)
    return fit_command.report(session, pdf, fresh, laboratory, lang)


def certificate(
    session: SessionFolder,
    laboratory: Annotated[
        Path | None, typer.Option("--laboratory", metavar="FILE", help="YAML: laboratory, customer, who signs")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="default: certificate.xml in the session's folder")] = None,
    schema: Annotated[
        Path | None, typer.Option("--schema", metavar="XSD", help="validate against this dcc.xsd (extra 'certificate')")
    ] = None,
    specimen: Annotated[
        bool, typer.Option("--specimen", help="a marked specimen; the only one a simulated session gets")
    ] = False,
    history: Annotated[
        str | None,
        typer.Option("--history", metavar="URL", help="where it is entered; default: beside the session"),
    ] = None,
) -> int:
    """Write a Digital Calibration Certificate (PTB DCC 3.2.1, D-SI units) of a session."""
    session_segments(session)
    from bench.commands import certificate as certificate_command

    request = certificate_command.Request(session, laboratory, out, schema, specimen, history)
    return certificate_command.certificate(request)


def export(
    session: SessionFolder,
    form: Annotated[str, typer.Option("--to", metavar="FORMAT", help="csv, parquet, hdf5, mat, mcap; session")],
    out: Annotated[Path | None, typer.Option("--out", help="a new folder; default: SESSION-FORMAT here")] = None,
    unit: Annotated[
        str | None, typer.Option("--unit", metavar="SERIAL", help="with '--to session': which of several units")
    ] = None,
) -> int:
    """Write events, readings, records, estimates and decoded frames as tables for other tools (extra 'python').

    With '--unit SERIAL --to session': the session of one unit out of one that several share, for its customer.
    """
    session_segments(session)
    from bench.commands import export as export_command

    return export_command.export(session, form, out, unit)


def batch(
    sessions: Annotated[list[Path], typer.Argument(metavar="SESSION...", help="sessions, or folders of sessions")],
    out: Annotated[Path, typer.Option("--out", help="folder for batch.json and batch.html")] = Path(),
    json: Annotated[bool, typer.Option("--json", help="print batch.json on standard output and nothing else")] = False,
) -> int:
    """Fit many sessions and compare their units: yield, distributions, the worst values."""
    from bench.commands import batch as batch_command

    return batch_command.batch(sessions, out, json)


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
) -> int:
    """Repeat a published simulation study, many runs of each case, and hold it against the published numbers."""
    from bench.commands import study as study_command

    request = study_command.Request(name, runs, seed, offsets, quick, dask, out, json)
    return study_command.study(request)
