"""Reports of a campaign: a self-contained HTML page, the same as PDF, and the picture of the timetable."""

from bench.report.assemble import report_model
from bench.report.batch.document import batch_html, batch_json
from bench.report.batch.model import Batch, LeftOut, Outcome
from bench.report.batch.tables import unit_name
from bench.report.dcc import (
    CERTIFICATE_FILE,
    DCC,
    SPECIMEN_FILE,
    Calibration,
    CertificateSchema,
    Span,
    certificate_text,
    nobody,
    not_valid,
    overdue,
    session_of,
)
from bench.report.document import Report, page, study_html
from bench.report.first import days_of
from bench.report.laboratory import LABORATORY_FILE, Laboratory, below_capability, laboratory_of, load_laboratory
from bench.report.model import ReportModel, RunStory, Surrounding, TemperatureTrace
from bench.report.sections import Section
from bench.report.tables import FOLDER, Table, analysis_tables, grouped, words_of

__all__ = [
    "CERTIFICATE_FILE",
    "DCC",
    "FOLDER",
    "LABORATORY_FILE",
    "SPECIMEN_FILE",
    "Batch",
    "Calibration",
    "CertificateSchema",
    "Laboratory",
    "LeftOut",
    "Outcome",
    "Report",
    "ReportModel",
    "RunStory",
    "Section",
    "Span",
    "Surrounding",
    "Table",
    "TemperatureTrace",
    "analysis_tables",
    "batch_html",
    "batch_json",
    "below_capability",
    "certificate_text",
    "days_of",
    "grouped",
    "laboratory_of",
    "load_laboratory",
    "nobody",
    "not_valid",
    "overdue",
    "page",
    "report_model",
    "session_of",
    "study_html",
    "unit_name",
    "words_of",
]
