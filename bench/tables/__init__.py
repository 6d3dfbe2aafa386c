"""A recorded session as tables: pandas for people who compute, files for other tools."""

from bench.tables.columns import table_of_estimates
from bench.tables.export import FORMATS, export_session
from bench.tables.foreign import kind_of, log_lines, open_table, origin_of
from bench.tables.session import Session

__all__ = [
    "FORMATS",
    "Session",
    "export_session",
    "kind_of",
    "log_lines",
    "open_table",
    "origin_of",
    "table_of_estimates",
]
