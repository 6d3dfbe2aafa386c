"""A refit of many sessions: every one that is selected is computed again, once, and nothing released is changed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bench.archive.journal import TrialJournal
from bench.archive.refit import COLUMNS, RefitTask, Row, refit
from bench.archive.work import Compute, in_parts
from bench.model.errors import InputError, RunError
from bench.session.output import writing
from bench.session.register import Register
from bench.session.shelf import key_of
from bench.session.view import SOFTWARE
from bench.store import Trial, begin_trial, check_form, enter_trial_rows, session_document, write_rows

OUTCOME = "refit.parquet"
_NAME_DIGITS = 16
_AT_ONCE = 20  # sessions of one transaction: a run that ends meanwhile must not wait for the history


@dataclass(frozen=True)
class Asked:
    """What a person asked for; ``method``: None for the one of each campaign; ``selection``: words of ``--select``."""

    method: str | None
    register: Register
    selection: Mapping[str, str]


@dataclass(frozen=True)
class Refitted:
    """A trial that is done; ``failed``: codes with the number of sessions that gave no results because of them."""

    trial: Trial
    path: Path
    rows: int
    failed: Mapping[str, int]


class Progress(Protocol):
    """A listener that is told how many sessions there are, of them how many are done, then of each that is."""

    def begin(self, total: int, done: int) -> None: ...
    def done(self, name: str) -> None: ...


def refit_sessions(
    url: str, rows: Sequence[Row], asked: Asked, folder: Path, compute: Compute, progress: Progress
) -> Refitted:
    """Compute sessions of the archive again; a trial that was stopped goes on in its folder.

    Args:   url: of the history, in which the trial is entered.   rows: of the sessions.   folder: for the outcome.
            compute: gives the outcomes of the tasks, in any order.
    Raises: InputError B-ARC-001 (no session), B-ARC-005 (a certificate that none of them has), B-ARC-006 (a folder of
            another trial), B-CLI-007; RunError B-ARC-007 if some could not be computed now; StoreError B-STORE-001
            to -006, -012 without Parquet.
    """
    path = folder / OUTCOME
    check_form(path)
    _check_register(asked.register, rows)
    tasks = tasks_of(rows, asked)
    trial = _trial(tasks, asked)
    begin_trial(url, trial)
    journal = TrialJournal(folder, vars(trial))
    progress.begin(len(tasks), len(journal.done))
    left = [task for task in tasks if task.key not in journal.done]
    unread: list[tuple[str, str]] = []
    for task, computed, wrong in compute(left, refit):
        if computed is None:
            unread.append((task.location, wrong))
        else:
            journal.add(task.key, computed)
            progress.done(task.name)
    if unread:
        raise _not_all(unread, len(tasks))
    with writing(path):
        count = write_rows(path, COLUMNS, (row for session in journal.sessions() for row in session))
    return Refitted(trial, path, count, _entered(url, trial, journal))


def tasks_of(rows: Sequence[Row], asked: Asked) -> list[RefitTask]:
    """Return a task for each recording, by its hash; of copies the first whole one is read."""
    tasks: dict[str, RefitTask] = {}
    for row in sorted(rows, key=lambda row: (row["code"] != "", row["location"])):
        sha256 = row["session_sha256"]
        told = session_document(row)
        head = {name: told[name] for name in ("session", "started_utc", "campaign", "simulated")}
        head["session_sha256"] = key = sha256 or row["location"]
        size = row["bytes"] if sha256 else 0
        tasks.setdefault(key, RefitTask(row["location"], head, asked.method, asked.register, size))
    return [tasks[key] for key in sorted(tasks)]


def _trial(tasks: Sequence[RefitTask], asked: Asked) -> Trial:
    """Return the trial; its name depends on the sessions, how they are computed, and all of the software."""
    if not tasks:
        raise InputError("B-ARC-001", "no session is selected", where="--select", next_step="'bench archive list'")
    options = {"method": asked.method, "register": _text(asked.register), "sessions": _text([t.key for t in tasks])}
    name = key_of([], options)
    assert name is not None
    method = asked.method or ""
    return Trial(name[:_NAME_DIGITS], SOFTWARE, method, asked.register, asked.selection, len(tasks))


def _text(value: object) -> str:
    return json.dumps(value, sort_keys=True)


def _check_register(register: Register, rows: Sequence[Row]) -> None:
    """Refuse a certificate that stands in place of none: nothing would change, and nobody would know why."""
    known = {(used["certificate"], used["model"], used["serial"]) for row in rows for used in row["standards"]}
    for number, entry in register.items():
        if (number, entry["model"], entry["serial"]) not in known:
            same = sorted({f"{model} {serial}" for certificate, model, serial in known if certificate == number})
            raise InputError(
                "B-ARC-005",
                f"no selected session used {entry['model']} {entry['serial']} with the certificate {number!r}",
                where="--with-standards",
                next_step=f"that certificate is of {', '.join(same)}"
                if same
                else "'bench archive where' finds who did",
            )


def _not_all(unread: Sequence[tuple[str, str]], total: int) -> RunError:
    location, wrong = unread[0]
    return RunError(
        "B-ARC-007",
        f"{len(unread)} of {total} sessions could not be computed now, the first: {wrong}",
        where=location,
        next_step="look after storage and workers, then give the same command again: what is done is kept",
    )


def _entered(url: str, trial: Trial, journal: TrialJournal) -> dict[str, int]:
    """Enter all rows into the history; returns the codes of sessions that gave no results, with their number."""
    failed: dict[str, int] = {}
    written = 0
    for part in in_parts(journal.sessions(), _AT_ONCE):
        written += len(part)
        enter_trial_rows(url, trial, part, last=written == len(journal.done))
        for rows in part:
            if code := str(rows[0]["code"]):
                failed[code] = failed.get(code, 0) + 1
    return dict(sorted(failed.items()))
