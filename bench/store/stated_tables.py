"""Tables of what people state beside the results: a unit as found or as left, and the first phase of control charts.

Rows are only ever added; the newest of a calibration, of a unit or of a station counts.
"""

from __future__ import annotations

from sqlalchemy import BigInteger, Column, Connection, Double, ForeignKey, Integer, Table, Text

from bench.store.tables import METADATA

# A calibration before an adjustment or repair of its unit (as_found), or after one (as_left).
states = Table(
    "states",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("calibration_id", Integer, ForeignKey("calibrations.id"), nullable=False),
    Column("state", Text, nullable=False),
    Column("what", Text, nullable=False),  # what was adjusted or repaired
    Column("stated_by", Text, nullable=False),
    Column("stated_utc_ns", BigInteger, nullable=False),
)

# Between these times a unit, or all units on a station, were in control: limits of charts rest on that.
phases = Table(
    "phases",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("subject", Text, nullable=False),  # "unit" or "station"
    Column("name", Text, nullable=False),  # model and serial number, or the name of the station
    Column("from_utc_ns", BigInteger, nullable=False),
    Column("until_utc_ns", BigInteger, nullable=False),
    Column("run_length", Double, nullable=False),
    Column("stated_by", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("stated_utc_ns", BigInteger, nullable=False),
)


def add_stated_tables(connection: Connection) -> None:
    """Bring tables without these up to date."""
    for table in (states, phases):
        table.create(connection)
