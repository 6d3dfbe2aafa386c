"""Calibrations around an adjustment: as found before it, as left after it. No drift is ever computed across one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, select

from bench.model.clock import WallClock
from bench.store.database import reading, writing
from bench.store.errors import StoreError
from bench.store.selection import find_calibration
from bench.store.tables import calibrations, states

STATES = ("as_found", "as_left")
_FOUND, _LEFT = STATES


def state_calibration(url: str, name: str, state: str, what: str, by: str) -> dict[str, Any]:
    """State that a calibration shows its unit as found before an adjustment, or as left after one.

    Args:    url: of the history.   name: session or the beginning of its SHA-256.   state: of the unit.
             what: was adjusted.   by: who says so.
    Returns: the calibration; nothing is added where the newest statement says the same.
    Raises:  StoreError B-STORE-040 without a name or what was adjusted; B-STORE-001 to B-STORE-007, B-STORE-009.
    """
    what, by = what.strip(), by.strip()
    if not what or not by or state not in STATES:
        raise StoreError(
            "B-STORE-040",
            "says neither as_found nor as_left, or not what was adjusted and who says so",
            where=name,
            next_step='for example: bench history adjusted SESSION as_left --what "gain of channel 3" --by NAME',
        )
    with reading(url):  # a statement begins no history
        pass
    with writing(url, "") as connection:
        calibration = find_calibration(connection, name)
        add_state(connection, calibration["id"], state, what, by, WallClock().utc_ns())
    return calibration


def add_state(connection: Connection, calibration: int, state: str, what: str, by: str, now_ns: int) -> None:
    """Add a statement about a calibration, unless the newest one says the same."""
    known = states_of(connection).get(calibration)
    if known is None or (known["state"], known["what"]) != (state, what):
        row = {"calibration_id": calibration, "state": state, "what": what, "stated_by": by}
        connection.execute(states.insert(), {**row, "stated_utc_ns": now_ns})


def states_of(connection: Connection) -> dict[int, dict[str, Any]]:
    """Return the newest statement about each calibration that has one, by its key."""
    rows = connection.execute(select(states).order_by(states.c.id)).mappings()
    return {row["calibration_id"]: dict(row) for row in rows}


def levels_of(connection: Connection, uut: tuple[str, str], rows: Sequence[Mapping[str, Any]]) -> NDArray[np.int64]:
    """Return a label of each calibration of a unit that changes with every adjustment, also between its campaigns."""
    stated = states_of(connection)
    query = select(calibrations.c.id, calibrations.c.campaign)
    query = query.where(calibrations.c.uut_model == uut[0], calibrations.c.uut_serial == uut[1])
    ordered = connection.execute(query.order_by(calibrations.c.started_utc_ns, calibrations.c.id)).all()
    level, before, left = 0, "", set[str]()  # campaigns that have seen the unit as it was left
    level_of = {}
    for row in ordered:
        state = stated.get(row.id, {}).get("state", "")
        if state == _LEFT:
            begins = before != _LEFT or row.campaign in left
            left = {row.campaign} if begins else left | {row.campaign}
        else:
            begins = before == _FOUND and state != _FOUND
        level += begins
        level_of[row.id], before = level, state
    return np.array([level_of[row["id"]] for row in rows], dtype=np.int64)
