"""``bench archive add``, ``verify`` and ``refit``: what reads or computes whole sessions, here or on a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from bench.archive import index
from bench.archive.census import Finding, Kind, counts_of, status_of
from bench.archive.selecting import selection_of
from bench.archive.trial import Asked, refit_sessions
from bench.archive.work import Compute, computed_here
from bench.commands.console import console, print_json
from bench.commands.requests import RefitRequest
from bench.model.clock import NS, Clock, WallClock
from bench.model.errors import ExitStatus
from bench.model.units import hours
from bench.session.register import load_register
from bench.store import list_sessions


def compute_at(dask: str | None) -> Compute:
    """Return what computes tasks, for an option ``--dask``; a cluster is looked for once there is a task."""
    if dask is None:
        return computed_here
    from bench.commands.cluster import completed_on_cluster

    return partial(completed_on_cluster, dask)


class Lines:
    """Counts the sessions that are done; the time left is that of those done since it began."""

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or WallClock()
        self._out = console(stderr=True)
        self._total = self._done = self._before = 0
        self._began_ns = self._clock.now_ns()

    def begin(self, total: int, done: int) -> None:
        """Tell how many of how many sessions are done already."""
        self._total, self._done, self._before, self._began_ns = total, done, done, self._clock.now_ns()
        if done:
            self._out.print(f"{done}/{total}  done before")

    def session(self, name: str) -> None:
        """Tell of one more session."""
        self._done += 1
        spent_s = (self._clock.now_ns() - self._began_ns) / NS
        left = self._total - self._done
        eta = f"  {hours(spent_s * left / (self._done - self._before))} left" if left > 0 else ""
        of = f"/{self._total}" if self._total else ""
        self._out.print(f"{self._done}{of}  {name}{eta}")


def add(url: str, folders: Sequence[str], everything: bool, dask: str | None, as_json: bool) -> int:
    """Enter sessions; returns 5 if one is damaged, 3 if one cannot be read now, else 0."""
    return _tell(index.add(url, folders, compute_at(dask), Lines().session, again=everything), "entered", as_json)


def verify(url: str, select: Sequence[str], dask: str | None, as_json: bool) -> int:
    """Read sessions of the archive again; returns 5 if one is damaged, changed or gone, 3 if one cannot be read now."""
    rows = list_sessions(url, selection_of(select))
    lines = Lines()
    lines.begin(len(rows), 0)
    return _tell(index.verify(url, rows, compute_at(dask), lines.session), "verified", as_json)


def _tell(findings: Sequence[Finding], done: str, as_json: bool) -> int:
    """Tell how many places there are of each kind, and of each that is not as it should be what to do."""
    counts = counts_of(findings)
    names = {kind: done if kind is Kind.ENTERED else kind.words for kind in Kind}
    rows = [finding for finding in findings if finding.kind not in (Kind.ENTERED, Kind.UNCHANGED)]
    total = sum(finding.session.bytes for finding in findings if finding.session)
    if as_json:
        numbers = {name.replace(" ", "_"): counts[kind] for kind, name in names.items()}
        print_json({**numbers, "bytes": total, "rows": [row.row for row in rows]}, ensure_ascii=False)
    else:
        out = console()
        for row in rows:
            out.print(f"{row.code or names[row.kind]:<12} {row.location}: {row.reason}. Next: {row.next_step}")
        out.print(f"{total / 1e6:.1f} MB read; {', '.join(f'{counts[kind]} {name}' for kind, name in names.items())}")
    return status_of(counts)


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
