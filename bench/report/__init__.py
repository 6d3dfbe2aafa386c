"""Reports of a campaign: a self-contained HTML page, the same as PDF, and the picture of the timetable."""

from bench.report.assemble import record_counts, report_model
from bench.report.document import Report, build_report
from bench.report.figures import plot_timetable
from bench.report.model import Record, ReportModel, RunStory, Surrounding, TemperatureTrace

__all__ = [
    "Record",
    "Report",
    "ReportModel",
    "RunStory",
    "Surrounding",
    "TemperatureTrace",
    "build_report",
    "plot_timetable",
    "record_counts",
    "report_model",
]
