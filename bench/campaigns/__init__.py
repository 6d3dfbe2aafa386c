"""Floor 5: one short file per analysis, and the form of results.json."""

from bench.campaigns.analysis import Analysis
from bench.campaigns.registry import ANALYSES, analyse, analysis_module
from bench.campaigns.results import build_results, results_json, validate_results

__all__ = ["ANALYSES", "Analysis", "analyse", "analysis_module", "build_results", "results_json", "validate_results"]
