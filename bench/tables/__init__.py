"""A session for people who compute: recorded as tables of pandas and files for other tools, living as a figure."""

from bench.tables.columns import table_of_estimates
from bench.tables.dataset import to_xarray
from bench.tables.export import FORMATS, export_session
from bench.tables.foreign import LOG_TIME, OtherLog, kind_of, open_table, topics_of
from bench.tables.live import watch
from bench.tables.session import Session

__all__ = [
    "FORMATS",
    "LOG_TIME",
    "OtherLog",
    "Session",
    "export_session",
    "kind_of",
    "open_table",
    "table_of_estimates",
    "to_xarray",
    "topics_of",
    "watch",
]
