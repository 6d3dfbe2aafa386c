"""Reports of a campaign: a self-contained HTML page and the picture of the timetable."""

from bench.report.assemble import record_counts, report_model
from bench.report.figures import plot_timetable
from bench.report.html import build_report
from bench.report.model import Record, ReportModel, TemperatureTrace

__all__ = [
    "Record",
    "ReportModel",
    "TemperatureTrace",
    "build_report",
    "plot_timetable",
    "record_counts",
    "report_model",
]
