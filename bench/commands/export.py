"""``bench export``: a session as tables for other tools."""

from __future__ import annotations

from pathlib import Path

from bench.commands.console import console
from bench.model.errors import ExitStatus
from bench.tables import Session, export_session


def export(folder: Path, form: str, out: Path | None) -> int:
    """Write the tables of a session into a new folder and say how many rows each has; status 5 if it is damaged.

    ``out``: default ``<session>-<form>`` in the folder one is in. Raises: those of ``export_session``.
    """
    session = Session(folder)
    target = out or Path(f"{folder.resolve().name}-{form}")
    for name, rows in export_session(session, form, target).items():
        console().print(f"  {name:<28} {rows:>10} rows")
    console().print(f"wrote    {target}")
    for remark in session.remarks:
        console(stderr=True).print(remark)
    return ExitStatus.SESSION_DAMAGED if session.damaged else ExitStatus.PASS
