"""Values that a sequence names: what a reading is called, and what it is told apart by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

QUANTITY = "quantity"  # among the conditions of a reading: its name in the results
_OF_THE_RUN = frozenset({QUANTITY, "purpose", "label", "window_index", "settle_band_degC", "settled"})


def conditions_of_value(conditions: Mapping[str, Any]) -> dict[str, Any]:
    """Return the conditions by which values of one name are told apart: those of the loops and of the record."""
    return {name: value for name, value in conditions.items() if name not in _OF_THE_RUN}
