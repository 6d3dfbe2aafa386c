"""Arguments of the commands that read recorded sessions.

What decodes, fits and computes is loaded once there is a session.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from bench.commands.requests import (
    Acceptance,
    AcceptanceOfUnit,
    AsJson,
    CertificateRequest,
    Language,
    RecordedSession,
    SessionFolder,
)
from bench.commands.usage import App

app = App()

Fresh = Annotated[bool, Option("--fresh", help="compute everything again, though it is kept from before")]


@app.command(work="session", epilog="Example: bench replay sessions/20000101T000000Z_scale_factor_38h_SIM-1")
def replay(folder: RecordedSession, as_json: AsJson = False) -> None:
    """Decode the raw bytes again through today's decoder and fits; says whether every number is identical."""


@app.command(epilog="Example: bench fit sessions/20000101T000000Z_scale_factor_38h_SIM-1 --method paper")
def fit(
    *,
    session: RecordedSession,
    method: Annotated[str | None, Option(help="a method of the analysis; a wrong one lists them")] = None,
    make_up: Annotated[
        list[Path] | None, Option("--with", metavar="SESSION", help="a make-up session that completes this one")
    ] = None,
    as_json: AsJson = False,
    fresh: Fresh = False,
    acceptance: Acceptance,
) -> int:
    """Results of a session by a method of your choice; nothing is written into the session unless you accept."""
    from bench.commands import accept
    from bench.commands import fit as work

    if acceptance.asked():
        accept.accept(session, acceptance, method, make_up or [])
    return work.fit(session, method, as_json, make_up or [], fresh)


@app.command(epilog="Example: bench report sessions/20000101T000000Z_scale_factor_38h_SIM-1 --pdf")
def report(
    *,
    session: RecordedSession,
    pdf: Annotated[bool, Option("--pdf", help="write report.pdf too (extra 'pdf')")] = False,
    verify: Annotated[
        bool, Option("--verify", help="derive everything again from the raw bytes, compare, write nothing")
    ] = False,
    laboratory: Annotated[
        Path | None, Option(help="a laboratory file for the first page; the session keeps a copy of it")
    ] = None,
    lang: Language = "en",
    as_json: AsJson = False,
    fresh: Fresh = False,
    acceptance: Acceptance,
) -> int:
    """Write report.html again from the session alone; or say whether results and report are what it gives."""
    if verify:
        from bench.commands import verify as verification

        return verification.verify(session, as_json)
    from bench.commands import accept
    from bench.commands import fit as work

    if acceptance.asked():
        accept.accept(session, acceptance)
    return work.report(session, pdf, fresh, laboratory, lang)


@app.command(
    work="certificate",
    epilog="Example: bench certificate sessions/20260101T180000Z_scale_factor_38h_17 --schema dcc.xsd",
)
def certificate(request: CertificateRequest) -> None:
    """Write a Digital Calibration Certificate (PTB DCC 3.2.1, D-SI units) of a session."""


@app.command(epilog="Example: bench coefficients sessions/SCALE_FACTOR sessions/BIAS --out compensation")
def coefficients(
    *,
    sessions: Annotated[list[Path], Argument(metavar="SESSION...", help="sessions of one unit")],
    out: Annotated[Path, Option(help="folder for coefficients.json and coefficients.h")] = Path(),
    acceptance: AcceptanceOfUnit,
) -> None:
    """Merge the compensation of a scale-factor and a bias session of one unit; a bias only from the bias campaign."""
    from bench.commands import accept
    from bench.commands import session as work

    accept.accept_in(sessions, acceptance)
    work.coefficients(sessions, out)


@app.command(
    work="export", epilog="Example: bench export sessions/20000101T000000Z_scale_factor_38h_SIM-1 --to parquet"
)
def export(
    folder: RecordedSession,
    form: Annotated[str, Option("--to", metavar="FORMAT", help="csv, parquet, hdf5, mat, mcap; session")],
    out: Annotated[Path | None, Option(help="a new folder; default: SESSION-FORMAT here")] = None,
    unit: Annotated[str | None, Option(metavar="SERIAL", help="with '--to session': which of several units")] = None,
) -> None:
    """Write events, readings, records, estimates and decoded frames as tables for other tools (extra 'python').

    With '--unit SERIAL --to session': the session of one unit out of one that several share, for its customer.
    """


@app.command(work="batch", epilog="Example: bench batch sessions --out batch")
def batch(
    named: Annotated[list[Path], Argument(metavar="SESSION...", help="sessions, or folders of sessions")],
    out: Annotated[Path, Option(help="folder for batch.json and batch.html")] = Path(),
    as_json: Annotated[bool, Option("--json", help="print batch.json on standard output and nothing else")] = False,
) -> None:
    """Fit many sessions and compare their units: yield, distributions, the worst values."""


@app.command(
    work="recover", epilog="Example: bench recover sessions/20000101T000000Z_scale_factor_38h_SIM-1 --make-up rest.yaml"
)
def recover(
    session: SessionFolder,
    make_up: Annotated[
        Path | None, Option(help="write the shortest sequence that makes up for what is missing")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List what a session holds: damage, and which records are valid, missing or invalid."""
