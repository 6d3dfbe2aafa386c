"""Trials: what archived sessions would give today. They stand beside the released values and change none of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, delete, select

from bench.model.clock import Clock, WallClock, utc_text
from bench.store.archive.certificates import certificates_of
from bench.store.contents import canonical, parameter_row
from bench.store.database import reading, rows_of, writing
from bench.store.recording import parameter_keys
from bench.store.selection import unknown
from bench.store.tables import certificates, parameters, trial_rows, trials

Row = dict[str, Any]
RUNNING, DONE = "running", "done"
_LEAST_NAME = 4
_STORED = tuple(
    column.name
    for column in trial_rows.c
    if column.name not in ("trial_id", "session_sha256", "position", "parameter_id")
)


@dataclass(frozen=True)
class Trial:
    """A refit as it was asked for; ``name``: digest of everything that its numbers depend on.

    ``method``: "" for the one of each campaign.   ``register``: by certificate as recorded, the entry in its place.
    """

    name: str
    software: str
    method: str
    register: Mapping[str, Any]
    selection: Mapping[str, str]
    sessions: int


def begin_trial(url: str, trial: Trial, clock: Clock | None = None) -> None:
    """Note that a trial has begun; one that is known changes nothing. Raises: StoreError B-STORE-001 to -006."""
    with writing(url, trial.software) as connection:
        if connection.execute(select(trials.c.id).where(trials.c.name == trial.name)).first() is None:
            row = {
                **vars(trial),
                "register": canonical(trial.register),
                "selection": canonical(trial.selection),
                "started_utc_ns": (clock or WallClock()).utc_ns(),
                "state": RUNNING,
            }
            connection.execute(trials.insert(), row)


def enter_trial_rows(url: str, trial: Trial, sessions: Iterable[list[Row]], *, last: bool) -> None:
    """Write the rows of some sessions; those of a session replace what stands there of it.

    Args:   sessions: the rows of each.   last: with these the trial is done.
    Raises: StoreError B-STORE-001 to B-STORE-006; nothing of these sessions is written then.
    """
    with writing(url, trial.software) as connection:
        number = connection.execute(select(trials.c.id).where(trials.c.name == trial.name)).scalar_one()
        for rows in sessions:
            _enter(connection, number, rows)
        if last:
            connection.execute(trials.update().where(trials.c.id == number), {"state": DONE})


def _enter(connection: Connection, trial: int, rows: list[Row]) -> None:
    sha256 = rows[0]["session_sha256"]
    these = (trial_rows.c.trial_id == trial, trial_rows.c.session_sha256 == sha256)
    connection.execute(delete(trial_rows).where(*these))
    wanted = [
        parameter_row(row["quantity"], row["unit"], json.loads(row["conditions"])) if row["quantity"] else None
        for row in rows
    ]
    known = parameter_keys(connection, [row for row in wanted if row is not None])
    entries = [
        {
            "trial_id": trial,
            "session_sha256": sha256,
            "position": position,
            "parameter_id": None if parameter is None else known[parameter["sha256"]],
            **{name: row[name] for name in _STORED},
        }
        for position, (row, parameter) in enumerate(zip(rows, wanted, strict=True))
    ]
    connection.execute(trial_rows.insert(), entries)


@dataclass(frozen=True)
class StoredTrial:
    """A trial as it stands in the database: its rows in order, with quantity, unit and conditions of each."""

    trial: Trial
    state: str
    started_utc: str
    rows: list[Row]
    certificates: list[Row]  # of its sessions


def read_trial(url: str, name: str) -> StoredTrial:
    """Return a trial named by the beginning of its name.

    Raises: StoreError B-STORE-009 if there is none, or more than one; B-STORE-001 to B-STORE-005, B-STORE-007.
    """
    with reading(url) as connection:
        head = _find(connection, name)
        rows = list(_rows(connection, head["id"]))
        these = select(trial_rows.c.session_sha256).where(trial_rows.c.trial_id == head["id"])
        issued = certificates_of(connection, certificates.c.session_sha256.in_(these))
    texts = {part: json.loads(head[part]) for part in ("register", "selection")}
    fields = {field: head[field] for field in ("name", "software", "method", "sessions")}
    return StoredTrial(Trial(**fields, **texts), head["state"], utc_text(head["started_utc_ns"]), rows, issued)


def _find(connection: Connection, name: str) -> Row:
    query = select(trials).where(trials.c.name.startswith(name, autoescape=True))
    found = rows_of(connection, query) if len(name) >= _LEAST_NAME else []
    if len(found) != 1:
        known = connection.execute(select(trials.c.name).order_by(trials.c.id)).scalars().all()
        raise unknown("trial", name, known, several=len(found) > 1)
    return found[0]


def _rows(connection: Connection, trial: int) -> Iterator[Row]:
    query = (
        select(trial_rows, parameters.c.quantity, parameters.c.unit, parameters.c.conditions)
        .join(parameters, parameters.c.id == trial_rows.c.parameter_id, isouter=True)
        .where(trial_rows.c.trial_id == trial)
        .order_by(trial_rows.c.session_sha256, trial_rows.c.position)
    )
    for row in connection.execute(query).mappings():
        yield {**row, "conditions": json.loads(row["conditions"] or "{}")}
