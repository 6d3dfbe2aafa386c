"""Arguments of the commands that read recorded sessions.

What decodes, fits and computes is loaded once there is a session.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.commands.requests import (
    Acceptance,
    AcceptanceOfUnit,
    AsJson,
    CertificateRequest,
    Language,
    SessionFolder,
)
from bench.commands.usage import App
from bench.model.segments import session_segments

app = App()

Fresh = Annotated[bool, typer.Option("--fresh", help="compute everything again, though it is kept from before")]


@app.command(epilog="Example: bench replay sessions/20000101T000000Z_scale_factor_38h_SIM-1")
def replay(session: SessionFolder, json: AsJson = False) -> int:
    """Decode the raw bytes again through today's decoder and fits; says whether every number is identical."""
    session_segments(session)  # before what decodes and fits is loaded
    from bench.commands import session as work

    return work.replay(session, json)


@app.command(epilog="Example: bench fit sessions/20000101T000000Z_scale_factor_38h_SIM-1 --method paper")
def fit(
    *,
    session: SessionFolder,
    method: Annotated[str | None, typer.Option(help="a method of the analysis; a wrong one lists them")] = None,
    make_up: Annotated[
        list[Path] | None, typer.Option("--with", metavar="SESSION", help="a make-up session that completes this one")
    ] = None,
    json: AsJson = False,
    fresh: Fresh = False,
    acceptance: Acceptance,
) -> int:
    """Results of a session by a method of your choice; nothing is written into the session unless you accept."""
    session_segments(session)
    from bench.commands import accept
    from bench.commands import fit as work

    if acceptance.asked():
        accept.accept(session, acceptance, method, make_up or [])
    return work.fit(session, method, json, make_up or [], fresh)


@app.command(epilog="Example: bench report sessions/20000101T000000Z_scale_factor_38h_SIM-1 --pdf")
def report(
    *,
    session: SessionFolder,
    pdf: Annotated[bool, typer.Option("--pdf", help="write report.pdf too (extra 'pdf')")] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="derive everything again from the raw bytes, compare, write nothing")
    ] = False,
    laboratory: Annotated[
        Path | None, typer.Option(help="a laboratory file for the first page; the session keeps a copy of it")
    ] = None,
    lang: Language = "en",
    json: AsJson = False,
    fresh: Fresh = False,
    acceptance: Acceptance,
) -> int:
    """Write report.html again from the session alone; or say whether results and report are what it gives."""
    session_segments(session)
    if verify:
        from bench.commands import verify as verification

        return verification.verify(session, json)
    from bench.commands import accept
    from bench.commands import fit as work

    if acceptance.asked():
        accept.accept(session, acceptance)
    return work.report(session, pdf, fresh, laboratory, lang)


@app.command(epilog="Example: bench certificate sessions/20260101T180000Z_scale_factor_38h_17 --schema dcc.xsd")
def certificate(request: CertificateRequest) -> int:
    """Write a Digital Calibration Certificate (PTB DCC 3.2.1, D-SI units) of a session."""
    session_segments(request.session)
    from bench.commands import certificate as work

    return work.certificate(request)


@app.command(epilog="Example: bench coefficients sessions/SCALE_FACTOR sessions/BIAS --out compensation")
def coefficients(
    *,
    sessions: Annotated[list[Path], typer.Argument(metavar="SESSION...", help="sessions of one unit")],
    out: Annotated[Path, typer.Option(help="folder for coefficients.json and coefficients.h")] = Path(),
    acceptance: AcceptanceOfUnit,
) -> int:
    """Merge the compensation of a scale-factor and a bias session of one unit; a bias only from the bias campaign."""
    from bench.commands import accept
    from bench.commands import session as work

    if acceptance.asked():
        accept.accept_in(sessions, acceptance)
    return work.coefficients(sessions, out)


@app.command(epilog="Example: bench export sessions/20000101T000000Z_scale_factor_38h_SIM-1 --to parquet")
def export(
    session: SessionFolder,
    form: Annotated[str, typer.Option("--to", metavar="FORMAT", help="csv, parquet, hdf5, mat, mcap; session")],
    out: Annotated[Path | None, typer.Option(help="a new folder; default: SESSION-FORMAT here")] = None,
    unit: Annotated[
        str | None, typer.Option(metavar="SERIAL", help="with '--to session': which of several units")
    ] = None,
) -> int:
    """Write events, readings, records, estimates and decoded frames as tables for other tools (extra 'python').

    With '--unit SERIAL --to session': the session of one unit out of one that several share, for its customer.
    """
    session_segments(session)
    from bench.commands import export as work

    return work.export(session, form, out, unit)


@app.command(epilog="Example: bench batch sessions --out batch")
def batch(
    sessions: Annotated[list[Path], typer.Argument(metavar="SESSION...", help="sessions, or folders of sessions")],
    out: Annotated[Path, typer.Option(help="folder for batch.json and batch.html")] = Path(),
    json: Annotated[bool, typer.Option("--json", help="print batch.json on standard output and nothing else")] = False,
) -> int:
    """Fit many sessions and compare their units: yield, distributions, the worst values."""
    from bench.commands import batch as work

    return work.batch(sessions, out, json)


@app.command(epilog="Example: bench recover sessions/20000101T000000Z_scale_factor_38h_SIM-1 --make-up rest.yaml")
def recover(
    session: SessionFolder,
    make_up: Annotated[
        Path | None, typer.Option(help="write the shortest sequence that makes up for what is missing")
    ] = None,
    json: AsJson = False,
) -> int:
    """List what a session holds: damage, and which records are valid, missing or invalid."""
    from bench.commands import recover as work

    return work.recover(session, make_up, json)
