"""What every analysis shares: its material, what it gives back, and the form of results.json."""

from bench.analysis.analysis import Analysis, Documents, check_method, no_result
from bench.analysis.c_header import c_preamble, c_text
from bench.analysis.coefficients import Source, UnitUnderTest, same_unit, source_of, validate_coefficients
from bench.analysis.continued import CONTINUES, joined
from bench.analysis.early import Check, link_checks
from bench.analysis.estimates import UNIT, Estimates, estimate, judged, rule_of
from bench.analysis.figures import Figure, Series, Style, band, curve, picture, series
from bench.analysis.limits import stated_limits
from bench.analysis.material import Exchange, Floats, Material, Reading, Trace
from bench.analysis.numbers import cell, decimals_for, header, number, unit_text, with_uncertainty
from bench.analysis.problems import count_problem, flag_problem
from bench.analysis.registry import analyse, analysis_module, declared_analysis
from bench.analysis.results import (
    INCOMPLETE,
    Closed,
    build_results,
    results_json,
    results_schema,
    schema_of,
    validate_results,
)
from bench.analysis.study import Chapter, Study, Task
from bench.analysis.tables import Table

__all__ = [
    "CONTINUES",
    "INCOMPLETE",
    "UNIT",
    "Analysis",
    "Chapter",
    "Check",
    "Closed",
    "Documents",
    "Estimates",
    "Exchange",
    "Figure",
    "Floats",
    "Material",
    "Reading",
    "Series",
    "Source",
    "Study",
    "Style",
    "Table",
    "Task",
    "Trace",
    "UnitUnderTest",
    "analyse",
    "analysis_module",
    "band",
    "build_results",
    "c_preamble",
    "c_text",
    "cell",
    "check_method",
    "count_problem",
    "curve",
    "decimals_for",
    "declared_analysis",
    "estimate",
    "flag_problem",
    "header",
    "joined",
    "judged",
    "link_checks",
    "no_result",
    "number",
    "picture",
    "results_json",
    "results_schema",
    "rule_of",
    "same_unit",
    "schema_of",
    "series",
    "source_of",
    "stated_limits",
    "unit_text",
    "validate_coefficients",
    "validate_results",
    "with_uncertainty",
]
