"""``acceptances.json`` of a session: beside its recording, which stays as it is, and bound to that by its hash."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from bench.analysis import Acceptances, Accepted, Document, acceptable, check_form, estimates_of, results_json
from bench.model.clock import utc_text
from bench.model.errors import NEXT_FORM, InputError, unknown_form
from bench.session.output import write_file
from bench.session.shelf import ACCEPTANCES

_NEXT = "remove the file, then accept again with 'bench fit SESSION --accept QUANTITY --by NAME --reason TEXT'"


def known_acceptances(folder: Path, session_sha256: str) -> tuple[tuple[Accepted, ...], list[str]]:
    """Return the acceptances of a session, and sentences about what is not of this recording.

    Raises: InputError B-ACC-004 if the file is not in its form.
    """
    path = folder / ACCEPTANCES
    try:
        document = json.loads(path.read_bytes())
    except FileNotFoundError:
        return (), []
    except (OSError, ValueError) as error:
        raise InputError("B-ACC-004", f"cannot be read: {error}", where=str(path), next_step=_NEXT) from error
    if isinstance(document, dict) and (why := unknown_form(document, "schema")):
        raise InputError("B-ACC-004", f"is {why}", where=str(path), next_step=NEXT_FORM)
    check_form(Acceptances, document, "B-ACC-004", str(path), _NEXT)
    if document["session_sha256"] != session_sha256:
        return (), [f"{ACCEPTANCES} is of another recording: nothing in it counts."]
    return tuple(Acceptances.model_validate(document).acceptances), []


def new_acceptances(results: Document, named: Sequence[str], by: str, reason: str, utc_ns: int) -> list[Accepted]:
    """Return an acceptance of every doubtful estimate that a person names.

    Raises: InputError B-ACC-001 (nothing doubtful), B-ACC-002 (refused), B-ACC-003 (nobody, no reason, or the run has
            not ended).
    """
    where = str(results["session"])
    if not by.strip() or not reason.strip():
        next_step = "give both: --by NAME --reason TEXT"
        raise InputError("B-ACC-003", "an acceptance needs a name and a reason", where=where, next_step=next_step)
    if results.get("incomplete"):
        next_step = "'bench resume' goes on with it"
        raise InputError(
            "B-ACC-003", "the run has not ended, nothing can be accepted", where=where, next_step=next_step
        )
    utc = utc_text(utc_ns)
    return [
        Accepted(
            quantity=entry.quantity,
            conditions=entry.conditions,
            method=results["method"],
            value=entry.value,
            reasons=sorted({told.code for told in entry.reasons}),
            by=by,
            reason=reason,
            utc=utc,
        )
        for text in named
        for entry in acceptable(estimates_of(results), text)
    ]


def write_acceptances(folder: Path, session_sha256: str, accepted: Sequence[Accepted]) -> Path:
    """Write the file; of one estimate the last acceptance stands. Raises: InputError B-CLI-007."""
    last = {results_json({"of": [part.quantity, part.method, part.conditions]}): part for part in accepted}
    document = Acceptances(schema=1, session_sha256=session_sha256, acceptances=list(last.values()))
    write_file(folder / ACCEPTANCES, results_json(document.model_dump(by_alias=True)))
    return folder / ACCEPTANCES
