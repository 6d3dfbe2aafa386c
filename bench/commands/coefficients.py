"""``bench coefficients``: compensation of a unit as JSON and as a C header."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.commands.console import console
from bench.model.errors import ExitStatus, InputError
from bench.session.coefficients import Coefficients, coefficients_of_session, merged_coefficients
from bench.session.service import read_view
from bench.session.view import analyse_view


def coefficients(folders: Sequence[Path], out: Path) -> int:
    """Fit the sessions again, merge their coefficients and write both files.

    Raises: InputError B-COEF-001 to -007; SessionDamaged for a session that is not whole.
    """
    merged = merged_coefficients([_of_folder(folder) for folder in folders])
    for path in merged.write(out):
        console().print(f"wrote    {path}")
    for source in merged.document["sources"]:
        for result in source["missing"]:
            console().print(f"MISSING  {result}")
    return ExitStatus.PASS


def _of_folder(folder: Path) -> Coefficients:
    view = read_view(folder, strict=True)
    if view.has_analysis:
        results, analysis = analyse_view(view)
        found = coefficients_of_session(analysis, results, view.manifest["campaign"])
        if found is not None:
            return found
    raise InputError(
        "B-COEF-005",
        "the session gives no coefficients",
        where=str(folder),
        next_step="name a session of a scale-factor or bias campaign with more than one temperature",
    )
