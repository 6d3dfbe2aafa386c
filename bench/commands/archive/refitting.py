"""``bench archive refit``: what selected sessions would give today."""

from __future__ import annotations

from bench.archive.selecting import selection_of
from bench.archive.trial import Asked, refit_sessions
from bench.commands.archive.computing import compute_at
from bench.commands.archive.progress import Lines
from bench.commands.console import console
from bench.commands.requests import RefitRequest
from bench.model.errors import ExitStatus
from bench.session.register import load_register
from bench.store import list_sessions


def refit(url: str, request: RefitRequest) -> int:
    """Compute sessions again; returns 1 if one gives no results, else 0."""
    register = {} if request.with_standards is None else load_register(request.with_standards)
    select = request.select or []
    rows = list_sessions(url, selection_of(select))
    asked = Asked(request.method, register, dict(word.split("=", 1) for word in select))
    done = refit_sessions(url, rows, asked, request.to, compute_at(request.dask), Lines())
    out = console()
    for code, count in done.failed.items():
        out.print(f"{code:<12} {count} sessions gave no results")
    out.print(f"trial    {done.trial.name}: {done.trial.sessions} sessions, {done.rows} rows")
    out.print(f"wrote    {done.path}")
    out.print(f"'bench archive changes {request.to}' says what would change")
    return ExitStatus.VERDICT_FAIL if done.failed else ExitStatus.PASS
