"""The end of a session that has an analysis: results, report, coefficients, and a line in the calibration history.

Everything is written before anything is told: a terminal that is gone must not cost the results. The history comes
last and costs nothing: a session that could not be entered is entered later from its folder. Nor does a report that
cannot be drawn because its extra is not installed.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from bench.analysis import Analysis, Document, results_json
from bench.model.extras import missing_extra
from bench.report import Report, laboratory_of
from bench.session.coefficients import write_coefficients
from bench.session.fitted import keep, shown_of
from bench.session.history import enter_history
from bench.session.output import write_attachments, write_file
from bench.session.view import SessionView, analyse_view, model_of


@dataclass
class Finished:
    """The written files; ``trouble`` are sentences about those that could not be, none of which cost a number."""

    results: Document
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

    Raises: BenchError of the analysis or of the disk; a missing extra and trouble with the history are only told.
    """
    files: list[tuple[str, str, str]] = []
    trouble: list[str] = []
    with _kept_alive():
        results, analysis = analyse_view(view)
        files.append(("results", "results.json", results_json(results)))
        try:
            model = model_of(view, results, analysis)
            report = Report(model, laboratory=laboratory_of(folder))
            files.append(("report", "report.html", report.html()))
            keep(folder, shown_of(view, results, analysis), model, report)
        except ModuleNotFoundError as error:
            trouble.append(f"{missing_extra(error)}; 'bench report {folder}' writes it later")
    done = Finished(results, analysis, [("session", str(folder))], trouble)
    for kind, name, text in files:
        write_file(folder / name, text)
        done.written.append((kind, str(folder / name)))
    if view.incomplete:  # a unit that was left out: nothing of it is released
        return done
    for path in write_coefficients(folder, analysis, results, view.manifest["campaign"]):
        done.written.append(("coeffs", str(path)))
    if analysis.attachments:
        done.written.append(("units", str(write_attachments(folder, analysis.attachments))))
    digests = {kind: hashlib.sha256(text.encode()).hexdigest() for kind, _, text in files}
    unentered = enter_history(history, folder, results, view.manifest, digests.get("report"))
    if unentered is not None:
        done.trouble.append(unentered)
    return done
