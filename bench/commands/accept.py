"""``--accept QUANTITY --by NAME --reason TEXT``: somebody releases the value of a doubtful estimate.

The recording is not touched. The files computed from it are written again, so that they say who accepted what.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.analysis import results_json
from bench.commands.console import console
from bench.commands.requests import Acceptance
from bench.model.clock import WallClock
from bench.model.errors import InputError
from bench.report import laboratory_of
from bench.session.acceptances import new_acceptances, write_acceptances
from bench.session.coefficients import write_coefficients
from bench.session.output import write_file
from bench.session.service import analysed
from bench.session.view import SessionView, analyse_view, report_of


def accept(folder: Path, acceptance: Acceptance, method: str | None = None, make_up: Sequence[Path] = ()) -> None:
    """Write acceptances.json, and again what the session gives by its own method.

    Raises: InputError B-ACC-001 to -004, B-CLI-007, B-CLI-008; SessionDamaged for a session that is not whole.
    """
    results, _, view = analysed(folder, method, strict=True, make_up=make_up)
    fresh = new_acceptances(results, acceptance.asked(), acceptance.by, acceptance.reason, WallClock().utc_ns())
    known = [*view.acceptances, *fresh]
    out = console(stderr=True)
    out.print(
        f"accepted {len(fresh)} estimates, the values alone: {write_acceptances(folder, view.session_sha256, known)}"
    )
    if method is None and not make_up:
        _write_again(folder, replace(view, acceptances=tuple(known)))
        out.print(f"what the session gives is written again; 'bench history import {folder}' enters it")


def accept_in(folders: Sequence[Path], acceptance: Acceptance) -> None:
    """Accept in those of some sessions that have the doubtful estimates. Raises: those of ``accept``."""
    for quantity in acceptance.asked():
        missed: list[InputError] = []
        for folder in folders:
            try:
                accept(folder, replace(acceptance, accept=[quantity]))
            except InputError as error:
                if error.code != "B-ACC-001":
                    raise
                missed.append(error)
        if len(missed) == len(folders):
            raise missed[0]


def _write_again(folder: Path, view: SessionView) -> None:
    results, analysis = analyse_view(view)
    write_file(folder / "results.json", results_json(results))
    write_file(folder / "report.html", report_of(view, results, analysis, laboratory_of(folder)).html())
    write_coefficients(folder, analysis, results, view.manifest["campaign"])
