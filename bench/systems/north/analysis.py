"""North by a turning fibre-optic gyroscope: azimuths by every method, their errors at known azimuths, the verdict.

Source: FOG paper (digital north finding), equations (13) to (21), corrected as said in ``estimators``; the
convention from index to north is in ``estimators.phasors``. What is not a sample, a flag, or stated in the
sequence is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import Analysis, Material, check_method, stated_limits
from bench.model.errors import FitError
from bench.systems.north.accuracy import accuracies
from bench.systems.north.declaration import DECLARATION
from bench.systems.north.estimates import north_estimates
from bench.systems.north.evidence import evidence
from bench.systems.north.figures import error_figures, signal_figures
from bench.systems.north.notes import north_notes
from bench.systems.north.sets import north_sets
from bench.systems.north.solution import METHODS
from bench.systems.north.solve import site_of, solve
from bench.systems.north.tables import tables

AZIMUTH_ERROR, SPECIFIED_deg = "azimuth_error", 0.5


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Azimuths by all methods; ``method`` says which one is judged against the limit ``azimuth_error``.

    Raises: FitError B-FIT-004 (unknown method), B-FOG-001 (limit), -002 (no readings), -003 (site), -004 (no set can be
            used), -005 (the method has nothing to work on).
    """
    check_method(method, METHODS)
    limit_deg = azimuth_error_limit_deg(material.campaign)
    solution = solve(north_sets(material), site_of(material.campaign))
    if not np.isfinite(solution.by_method[method].azimuth_deg).any():
        raise FitError(
            "B-FOG-005",
            f"no set has what the method {method!r} needs: {'; '.join(solution.missing[:3])}",
            next_step="give the records 'samples: true' for likelihood, read both lock-ins for the other methods",
        )
    accuracy = accuracies(solution, limit_deg)
    estimates = north_estimates(solution, method, accuracy, limit_deg)
    return Analysis(
        campaign="fog_north",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=estimates,
        evidence=evidence(solution, estimates),
        notes=north_notes(solution, method, accuracy),
        missing=solution.missing,
        figures=[*signal_figures(solution), *error_figures(solution, method, limit_deg)],
        tables=tables(solution, method, accuracy, limit_deg),
    )


def azimuth_error_limit_deg(campaign: Mapping[str, Any]) -> float:
    """Return the largest azimuth error allowed, degrees.

    Raises: FitError B-FOG-001 for a limit of the sequence that is not one of a north finder, in a wrong unit or not
            above zero.
    """
    declared = DECLARATION.analysis("fog_north")
    stated = stated_limits(campaign, declared.limits, "B-FOG-001", "a north finder has no such limit")
    return stated.get(AZIMUTH_ERROR, SPECIFIED_deg)
