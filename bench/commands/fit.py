"""``bench fit`` and ``report``: what a recorded session gives, computed or kept from before."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bench.analysis import results_json
from bench.commands.console import console, say, warn
from bench.commands.tables import print_results, verdict_status
from bench.model.errors import ExitStatus
from bench.model.texts import ENGLISH, check_language
from bench.record import SessionReader
from bench.report import FOLDER
from bench.session.fitted import FROM_CACHE, Fitted, Shown
from bench.session.one_unit import serials_of
from bench.session.output import write_file
from bench.session.units import in_each_unit


def fit(folder: Path, method: str | None, as_json: bool, make_up: Sequence[Path] = (), fresh: bool = False) -> int:
    """Print the results of a session by a method, together with sessions that make up for it.

    ``fresh``: compute them though they are kept. Nothing is written into the session. The exit status is that of the
    run: 1 if a verdict fails or is indeterminate, or a result is missing.
    """
    if not as_json and serials_of(SessionReader(folder).manifest):
        return in_each_unit(folder, lambda home: fit(home, method, False, make_up, fresh))
    fitted = Fitted(folder, method, make_up, fresh=fresh)
    shown = fitted.shown
    if as_json:
        sys.stdout.write(results_json(shown.results))
    else:
        print_results(console(), shown.results, shown.analysis)
        for remark in shown.remarks:
            say(remark)
    if fitted.from_cache:
        console(stderr=as_json).print(FROM_CACHE)
    return _status(shown) or _judged(shown)


def report(
    folder: Path,
    pdf: bool = False,
    fresh: bool = False,
    laboratory: Path | None = None,
    language: str = ENGLISH,
) -> int:
    """Write report.html again, and report.pdf if asked for; ``fresh``: compute what it shows though that is kept.

    ``laboratory``: a file that the session keeps from now on; what keeps the page from standing under the accreditation
    that it states is told. In another language than English they are report.<language>.html and .pdf, beside those
    that are verified.
    Raises: InputError B-TXT-001 for a language that the report does not have, B-REP-001 and B-TXT-002 for paper.
    """
    check_language(language, FOLDER)
    if serials_of(SessionReader(folder).manifest):
        return in_each_unit(folder, lambda home: report(home, pdf, fresh, laboratory, language))
    fitted = Fitted(folder, fresh=fresh, language=language)
    if laboratory is not None:
        fitted.keep_laboratory(laboratory)
    name = "report" if language == ENGLISH else f"report.{language}"
    path = folder / f"{name}.html"
    write_file(path, fitted.report.html())
    say(f"report   {path}")
    if pdf:
        paper = folder / f"{name}.pdf"
        write_file(paper, fitted.paper())
        say(f"report   {paper}")
    for reason in fitted.report.not_accredited:
        warn(f"not stated under the accreditation (B-DCC-017): {reason}")
    if fitted.from_cache:
        say(FROM_CACHE)
    return _status(fitted.shown)


def _status(shown: Shown) -> int:
    return ExitStatus.SESSION_DAMAGED if shown.damaged else ExitStatus.PASS


def _judged(shown: Shown) -> int:
    """Nothing is judged, and nothing missing yet, while the run has not ended."""
    done = not shown.results.get("incomplete")
    return verdict_status(shown.results, shown.analysis.missing) if done else ExitStatus.PASS
