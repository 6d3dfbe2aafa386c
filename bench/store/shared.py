"""What a standard adds to every calibration made with the same certificate of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.systems import analysis_declaration

_PPM = 1e6
_GENERATOR_LIMIT = 3e-6  # rectangular; where the register states nothing (AF-converter paper, section 4.1)

# Quantity -> role of the standard whose relative error enters it one to one, whatever the campaign is.
_ROLES = {"master_clock_error": "function_generator"}


def shared_components(standards: Mapping[str, Mapping[str, Any]], campaign: str) -> list[dict[str, Any]]:
    """One row per quantity that takes over the relative error of a standard.

    Of the ranges of a standard the smallest relative uncertainty is taken: no range shares less than that, and what
    is not known to be shared stays an uncertainty of the single calibration. A standard without serial number or
    certificate is shared with nobody.
    """
    found = []
    declared = analysis_declaration(campaign)
    for quantity, role in {**({} if declared is None else declared.standards), **_ROLES}.items():
        entry = standards.get(role)
        if entry is None or not (entry.get("serial") and entry.get("certificate")):
            continue
        relative = _relative_std(entry, role)
        if relative:
            found.append(
                {
                    "quantity": quantity,
                    "unit": "ppm",
                    "role": role,
                    "standard": f"{entry.get('model', '')} {entry['serial']} {entry['certificate']}",
                    "std_uncertainty": relative * _PPM,
                }
            )
    return found


def _relative_std(entry: Mapping[str, Any], role: str) -> float:
    """Relative standard uncertainty of the standard with that of its own certificate; the register states 95 %."""
    stated = [float(one["relative"]) / 2.0 for one in entry.get("uncertainty") or () if one.get("relative") is not None]
    if not stated and role == "function_generator":
        stated = [_GENERATOR_LIMIT / math.sqrt(3.0)]
    traceability = float(entry.get("traceability_relative") or 0.0) / 2.0
    return math.hypot(min(stated), traceability) if stated else 0.0
