"""``bench export``: a session as tables for other tools."""

from __future__ import annotations

from pathlib import Path

from bench.commands.console import say, warn
from bench.model.errors import ExitStatus, InputError
from bench.model.lab import folder_name
from bench.session.one_unit import extract
from bench.tables import Session, export_session

SESSION = "session"  # the format that is a session


def export(folder: Path, form: str, out: Path | None, unit: str | None = None) -> int:
    """Write the tables of a session into a new folder and say how many rows each has; status 5 if it is damaged.

    ``out``: default ``<session>-<form>`` in the folder one is in.   ``unit``: of a session that several units share;
    the form "session" writes the session of that unit alone. Raises: those of ``export_session`` and ``extract``.
    """
    if (form == SESSION) != (unit is not None):
        message = "'--to session' writes the session of one unit, and --unit names it"
        raise InputError("B-CLI-014", message, where="--to", next_step="give both, or neither")
    if unit is not None:
        target = out or Path(f"{folder.resolve().name}-{folder_name(unit)}")
        sha256 = extract(folder, unit, target)
        say(f"wrote    {target}")
        say(f"session  {sha256}: nothing of another unit is in it")
        return ExitStatus.PASS
    session = Session(folder)
    target = out or Path(f"{folder.resolve().name}-{form}")
    for name, rows in export_session(session, form, target).items():
        say(f"  {name:<28} {rows:>10} rows")
    say(f"wrote    {target}")
    for remark in session.remarks:
        warn(remark)
    return ExitStatus.SESSION_DAMAGED if session.damaged else ExitStatus.PASS
