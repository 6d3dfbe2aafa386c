"""Pictures of a report; importing this loads matplotlib, which takes longer than most commands take to run."""

from bench.report.plots.currents import current_picture, residual_picture
from bench.report.plots.figures import plot_timetable, plot_trade, timetable_picture
from bench.report.plots.graphs import analysis_pictures
from bench.report.plots.strips import strip_pictures
from bench.report.plots.style import BLUE, GREY, INK, VERMILION, drawing, svg_text
from bench.report.plots.temperatures import asymmetry_picture, bias_picture, dsf_picture, surroundings_picture

__all__ = [
    "BLUE",
    "GREY",
    "INK",
    "VERMILION",
    "analysis_pictures",
    "asymmetry_picture",
    "bias_picture",
    "current_picture",
    "drawing",
    "dsf_picture",
    "plot_timetable",
    "plot_trade",
    "residual_picture",
    "strip_pictures",
    "surroundings_picture",
    "svg_text",
    "timetable_picture",
]
