"""Reports of a campaign: a self-contained HTML page, the same as PDF, and the picture of the timetable."""

from bench.report.assemble import report_model
from bench.report.document import Report
from bench.report.figures import plot_timetable
from bench.report.model import RunStory, Surrounding, TemperatureTrace

__all__ = ["Report", "RunStory", "Surrounding", "TemperatureTrace", "plot_timetable", "report_model"]
