"""Analyses by name: a campaign names its analysis, a declaration names the module that does it; that one is loaded."""

from __future__ import annotations

import difflib
from typing import Protocol

from bench.analysis.analysis import Analysis
from bench.analysis.material import Material
from bench.model.declaration import AnalysisDeclaration
from bench.model.errors import FitError
from bench.model.systems import analyses, named


class AnalysisModule(Protocol):
    """What a module of a system offers to be an analysis."""

    METHODS: tuple[str, ...]

    def analyse(self, material: Material, method: str = ...) -> Analysis:
        """From records and the manifest's constants to estimates."""


def declared_analysis(name: str) -> AnalysisDeclaration:
    """Return the declaration of an analysis. Raises: FitError B-FIT-011 for an unknown name."""
    known = analyses()
    if name in known:
        return known[name][0]
    close = difflib.get_close_matches(name, known, n=1)
    raise FitError(
        "B-FIT-011",
        f"unknown analysis {name!r}",
        next_step=f"did you mean {close[0]!r}?" if close else f"use one of: {', '.join(known)}",
    )


def analysis_module(name: str) -> AnalysisModule:
    """Load the module of an analysis. Raises: FitError B-FIT-011 for an unknown name."""
    module: AnalysisModule = named(declared_analysis(name).module)
    return module


def analyse(material: Material, method: str | None = None) -> Analysis:
    """Run the analysis the campaign names, with its default method (the first it declares) unless told otherwise."""
    declared = declared_analysis(str(material.campaign.get("analysis", "")))
    return analysis_module(declared.name).analyse(material, method or declared.methods[0])
