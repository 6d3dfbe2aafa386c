"""The calibration history, an SQL database of results, reports and approvals."""

from bench.store.adjustments import state_calibration
from bench.store.archive.certificates import Issued, UsedStandard, certificate_document, enter_certificate
from bench.store.archive.dependents import dependents
from bench.store.archive.sessions import (
    ArchivedSession,
    Selection,
    Unit,
    enter_sessions,
    list_sessions,
    places_known,
    selection_of,
    session_document,
)
from bench.store.archive.trials import StoredTrial, Trial, begin_trial, enter_trial_rows, read_trial
from bench.store.comparison import LEAST_FOR_CONTROL, Comparison, ParameterHistory, compare_pair, compare_unit
from bench.store.contents import MEASURED, digest_of_file, documents_of_units, started_utc_ns
from bench.store.database import history_address
from bench.store.due import Due, dues_of
from bench.store.errors import StoreError
from bench.store.export import export_history
from bench.store.reading import Shown, list_calibrations, show_calibration, units_of
from bench.store.recording import Recorded, approve, record_calibration
from bench.store.rows import check_form, columns_of, write_rows
from bench.store.selection import Filters
from bench.store.series import YEAR_S, conditions_text

__all__ = [
    "LEAST_FOR_CONTROL",
    "MEASURED",
    "YEAR_S",
    "ArchivedSession",
    "Comparison",
    "Due",
    "Filters",
    "Issued",
    "ParameterHistory",
    "Recorded",
    "Selection",
    "Shown",
    "StoreError",
    "StoredTrial",
    "Trial",
    "Unit",
    "UsedStandard",
    "approve",
    "begin_trial",
    "certificate_document",
    "check_form",
    "columns_of",
    "compare_pair",
    "compare_unit",
    "conditions_text",
    "dependents",
    "digest_of_file",
    "documents_of_units",
    "dues_of",
    "enter_certificate",
    "enter_sessions",
    "enter_trial_rows",
    "export_history",
    "history_address",
    "list_calibrations",
    "list_sessions",
    "places_known",
    "read_trial",
    "record_calibration",
    "selection_of",
    "session_document",
    "show_calibration",
    "started_utc_ns",
    "state_calibration",
    "units_of",
    "write_rows",
]
