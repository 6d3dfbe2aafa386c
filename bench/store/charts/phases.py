"""The first phase of the charts of a unit or a station, as a person states it; a later statement begins a new one."""

from __future__ import annotations

from datetime import UTC, date, datetime
from typing import Any

from sqlalchemy import Connection, func, select

from bench.model.clock import NS, WallClock, utc_text
from bench.store.database import reading, writing
from bench.store.errors import StoreError
from bench.store.selection import find_unit, require
from bench.store.tables import calibrations, phases

LEAST = 8  # calibrations of a first phase; fewer say too little about the scatter
BY_DEFAULT = 12  # calibrations, where nobody has stated a first phase
_DAY_NS = 86_400 * NS
_LAST_NS = 2**63 - 1  # that a database holds


def freeze(
    url: str,
    subject: tuple[str, str | None],
    days: tuple[date | None, date],
    run_length: float,
    by: str,
    reason: str,
) -> dict[str, Any]:
    """State the first phase of a unit or a station: between which days it was in control.

    Args:    url: of the history.
             subject: "unit" with its serial number (None: the only one), or "station" with its name.
             days: first one (None: from the beginning) and last one, both counted in.
             run_length: points until the first false signal of any chart of the subject.
             by, reason: who says so, and why.
    Returns: the row that was added.
    Raises:  StoreError B-STORE-041 if the days are in no order or not over, hold fewer than eight calibrations, or the
             run length, a name or a reason is missing; B-STORE-001 to B-STORE-007, B-STORE-009.
    """
    now_ns = WallClock().utc_ns()
    from_ns = 0 if days[0] is None else _midnight_ns(days[0])
    until_ns = min(_midnight_ns(days[1]) + _DAY_NS - 1, _LAST_NS)
    with reading(url) as connection:
        kind, name = subject[0], _name(connection, *subject)
        count = _count(connection, kind, name, from_ns, until_ns)
    wrong = [
        text
        for text, is_so in (
            ("nobody states it, or no reason is given", not by.strip() or not reason.strip()),
            (f"the run length is {run_length:g}, and at least 2", run_length < 2.0),
            ("it ends before it begins", until_ns < from_ns),
            ("its last day is not over", until_ns > now_ns),
            (f"it holds {count} calibrations of at least {LEAST}", count < LEAST),
        )
        if is_so
    ]
    if wrong:
        raise StoreError(
            "B-STORE-041",
            f"this is no first phase: {'; '.join(wrong)}",
            where=name,
            next_step="'bench history list' shows the calibrations; give --until DAY --by NAME --reason TEXT",
        )
    row = {
        "subject": kind, "name": name, "from_utc_ns": from_ns, "until_utc_ns": until_ns, "run_length": run_length,
        "stated_by": by.strip(), "reason": reason.strip(), "stated_utc_ns": now_ns,
    }  # fmt: skip
    with writing(url, "") as connection:
        connection.execute(phases.insert(), row)
    return phase_document(row) | {"calibrations": count}


def phase_of(connection: Connection, subject: str, name: str) -> dict[str, Any] | None:
    """Return the newest first phase that was stated of a unit or a station; None if there is none."""
    query = select(phases).where(phases.c.subject == subject, phases.c.name == name).order_by(phases.c.id.desc())
    row = connection.execute(query.limit(1)).mappings().first()
    return None if row is None else dict(row)


def phase_document(row: dict[str, Any]) -> dict[str, Any]:
    """Return a first phase with its times as text."""
    times = {f"{name}_utc": utc_text(row[f"{name}_utc_ns"]) for name in ("from", "until", "stated")}
    return {**{name: row[name] for name in ("subject", "name", "run_length", "stated_by", "reason")}, **times}


def _midnight_ns(day: date) -> int:
    return int(datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()) * NS


def _name(connection: Connection, kind: str, name: str | None) -> str:
    if kind == "unit":
        return " ".join(find_unit(connection, name))
    require(connection, "station", name or "", calibrations.c.station)
    return name or ""


def _count(connection: Connection, kind: str, name: str, from_ns: int, until_ns: int) -> int:
    """Return how many calibrations a phase holds of its fullest campaign."""
    of_it = (
        calibrations.c.uut_model + " " + calibrations.c.uut_serial == name
        if kind == "unit"
        else calibrations.c.station == name
    )
    query = select(calibrations.c.simulated, calibrations.c.campaign, func.count()).where(of_it)
    query = query.where(calibrations.c.started_utc_ns.between(from_ns, until_ns))
    rows = connection.execute(query.group_by(calibrations.c.simulated, calibrations.c.campaign)).all()
    return max((row[2] for row in rows), default=0)
