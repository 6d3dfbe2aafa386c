"""The calibration history, an SQL database of results, reports and approvals."""

from bench.store.adjustments import state_calibration
from bench.store.comparison import LEAST_FOR_CONTROL, Comparison, ParameterHistory, compare_pair, compare_unit
from bench.store.contents import digest_of_file, started_utc_ns
from bench.store.database import history_address
from bench.store.due import Due, dues_of
from bench.store.errors import StoreError
from bench.store.export import export_history
from bench.store.reading import Shown, list_calibrations, show_calibration, units_of, utc_text
from bench.store.recording import Recorded, approve, record_calibration
from bench.store.selection import Filters
from bench.store.series import YEAR_S, conditions_text

__all__ = [
    "LEAST_FOR_CONTROL",
    "YEAR_S",
    "Comparison",
    "Due",
    "Filters",
    "ParameterHistory",
    "Recorded",
    "Shown",
    "StoreError",
    "approve",
    "compare_pair",
    "compare_unit",
    "conditions_text",
    "digest_of_file",
    "dues_of",
    "export_history",
    "history_address",
    "list_calibrations",
    "record_calibration",
    "show_calibration",
    "started_utc_ns",
    "state_calibration",
    "units_of",
    "utc_text",
]
