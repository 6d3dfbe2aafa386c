"""``bench archive add``, ``verify`` and ``refit``: what reads or computes whole sessions, here or on a cluster."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial

from bench.archive import index
from bench.archive.places import Finding, Kind
from bench.archive.trial import Asked, refit_sessions
from bench.archive.work import Compute, computed_here
from bench.commands.console import TaskLines, console, print_json
from bench.commands.requests import Place, RefitRequest
from bench.model.errors import ExitStatus
from bench.session.register import load_register
from bench.store import list_sessions, selection_of


def compute_at(dask: str | None) -> Compute:
    """Return what computes tasks, for an option ``--dask``; a cluster is looked for once there is a task."""
    if dask is None:
        return computed_here
    from bench.commands.cluster import completed_on_cluster

    return partial(completed_on_cluster, dask)


def add(folders: Sequence[str], everything: bool, dask: str | None, place: Place, as_json: bool) -> int:
    """Enter sessions; returns 5 if one is damaged, 3 if one cannot be read now, else 0."""
    findings = index.add(place.of(), folders, compute_at(dask), TaskLines().done, again=everything)
    return _tell(findings, "entered", as_json)


def verify(select: Sequence[str] | None, dask: str | None, place: Place, as_json: bool) -> int:
    """Read sessions of the archive again; returns 5 if one is damaged, changed or gone, 3 if one cannot be read now."""
    url = place.of()
    rows = list_sessions(url, selection_of(select or ()))
    return _tell(index.verify(url, rows, compute_at(dask), TaskLines(len(rows)).done), "verified", as_json)


def _tell(findings: Sequence[Finding], done: str, as_json: bool) -> int:
    """Tell how many places there are of each kind, and of each that is not as it should be what to do."""
    counts = Counter(finding.kind for finding in findings)
    names = {kind: done if kind is Kind.ENTERED else str(kind) for kind in Kind}
    rows = [finding for finding in findings if finding.kind not in (Kind.ENTERED, Kind.UNCHANGED)]
    total = sum(finding.session.bytes for finding in findings if finding.session)
    if as_json:
        numbers = {name: counts[kind] for kind, name in names.items()}
        documents = [{name: value for name, value in vars(row).items() if name != "session"} for row in rows]
        print_json({**numbers, "bytes": total, "rows": documents}, ensure_ascii=False)
    else:
        out = console()
        for row in rows:
            out.print(f"{row.code or _words(row.kind):<12} {row.location}: {row.reason}. Next: {row.next_step}")
        said = ", ".join(f"{counts[kind]} {_words(name)}" for kind, name in names.items())
        out.print(f"{total / 1e6:.1f} MB read; {said}")
    if counts[Kind.DAMAGED]:  # is certain, and counts before what can be read another time
        return ExitStatus.SESSION_DAMAGED
    return ExitStatus.SAFE_AFTER_FAULT if counts[Kind.UNREADABLE] else ExitStatus.PASS


def _words(name: str) -> str:
    return name.replace("_", " ")


def refit(request: RefitRequest, place: Place) -> int:
    """Compute sessions again; returns 1 if one gives no results, else 0."""
    register = {} if request.with_standards is None else load_register(request.with_standards)
    url, select = place.of(), request.select or []
    rows = list_sessions(url, selection_of(select))
    asked = Asked(request.method, register, dict(word.split("=", 1) for word in select))
    done = refit_sessions(url, rows, asked, request.to, compute_at(request.dask), TaskLines())
    out = console()
    for code, count in done.failed.items():
        out.print(f"{code:<12} {count} sessions gave no results")
    out.print(f"trial    {done.trial.name}: {done.trial.sessions} sessions, {done.rows} rows")
    out.print(f"wrote    {done.path}")
    out.print(f"'bench archive changes {request.to}' says what would change")
    return ExitStatus.VERDICT_FAIL if done.failed else ExitStatus.PASS
