"""Pictures of a report; importing this loads matplotlib, which takes longer than most commands take to run."""

from bench.report.plots.currents import current_picture, residual_picture
from bench.report.plots.figures import plot_timetable, plot_trade, timetable_picture
from bench.report.plots.graphs import analysis_pictures
from bench.report.plots.history import FORMATS, MOST_PANELS, ControlPanel, Panel, line_years, plot_control, plot_history
from bench.report.plots.strips import strip_pictures
from bench.report.plots.temperatures import asymmetry_picture, bias_picture, dsf_picture, surroundings_picture

__all__ = [
    "FORMATS",
    "MOST_PANELS",
    "ControlPanel",
    "Panel",
    "analysis_pictures",
    "asymmetry_picture",
    "bias_picture",
    "current_picture",
    "dsf_picture",
    "line_years",
    "plot_control",
    "plot_history",
    "plot_timetable",
    "plot_trade",
    "residual_picture",
    "strip_pictures",
    "surroundings_picture",
    "timetable_picture",
]
