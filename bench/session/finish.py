"""The end of a session that has an analysis: results, report, coefficients, and a line in the calibration history.

Everything is written before anything is told: a terminal that is gone must not cost the results. The history comes
last and costs nothing: a session that could not be entered is entered later from its folder.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.analysis import Analysis, results_json
from bench.session.coefficients import write_coefficients
from bench.session.output import write_attachments, write_file
from bench.session.view import SessionView, analyse_view, report_html
from bench.store import StoreError, record_calibration


@dataclass
class Finished:
    """The written files; ``trouble`` are sentences about those that could not be, none of which cost a number."""

    results: Mapping[str, Any]
    analysis: Analysis
    written: list[tuple[str, str]] = field(default_factory=list)
    trouble: list[str] = field(default_factory=list)


@contextmanager
def _kept_alive() -> Iterator[None]:
    """No search for garbage passes the steps and records of a run in here: they are in use to the end."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def finish(folder: Path, view: SessionView, history: str) -> Finished:
    """Write results.json, report.html and the coefficients into the session's folder, and enter the history.

    Raises: BenchError of the analysis or of the disk; trouble with the history is only told.
    """
    with _kept_alive():
        results, analysis = analyse_view(view)
        page = report_html(view, results, analysis)
    done = Finished(results, analysis, [("session", str(folder))])
    for kind, name, text in (("results", "results.json", results_json(results)), ("report", "report.html", page)):
        write_file(folder / name, text)
        done.written.append((kind, str(folder / name)))
    for path in write_coefficients(folder, analysis, results, view.manifest["campaign"]):
        done.written.append(("coeffs", str(path)))
    if analysis.attachments:
        done.written.append(("units", str(write_attachments(folder, analysis.attachments))))
    try:
        record_calibration(history, results, view.manifest, hashlib.sha256(page.encode()).hexdigest())
    except StoreError as error:
        done.trouble.append(f"{error}; nothing is lost: 'bench history import {folder}' enters it later")
    return done
