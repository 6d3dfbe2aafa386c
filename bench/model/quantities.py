"""Values that a sequence names: what a reading is called, and what it is told apart by."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

Values = Mapping[str, Any]
"""Conditions, arguments, constants of a campaign or other parts of a plan or a manifest, by name, as JSON has them."""

QUANTITY = "quantity"  # among the conditions of a reading: its name in the results
_OF_THE_RUN = frozenset({QUANTITY, "purpose", "label", "window_index", "settle_band_degC", "settled"})


def key_of_value(quantity: str, conditions: Values) -> str:
    """Return what tells one value of a plan from another, by its name and the conditions that count for values."""
    return json.dumps([quantity, dict(conditions)], sort_keys=True)


def conditions_of_value(conditions: Values) -> dict[str, Any]:
    """Return the conditions by which values of one name are told apart: those of the loops and of the record."""
    return {name: value for name, value in conditions.items() if name not in _OF_THE_RUN}
