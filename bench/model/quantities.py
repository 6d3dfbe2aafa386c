"""Values that a sequence names: what a reading is called, and what it is told apart by; flags of their quality.

A flagged reading stays in the record and is counted in the report. It is left out of fits, with one exception that each
analysis states: a record that lost no more frames than the sequence allows is still a valid mean over those that came.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import IntFlag
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


class Quality(IntFlag):
    """Why a reading is not good; 0 is good."""

    GOOD = 0
    LOST = 1  # frames missing inside the record
    BAD_FRAMES = 2  # frames with a failed check inside the record
    OVER_RANGE = 4  # the unit reported an input over range
    NOT_FINITE = 8  # NaN or infinite
    OVERLOAD = 16  # an instrument's overload sentinel
    STALE = 32  # older than its limit
    DUPLICATE = 64  # same counter twice
    SPLICE = 128  # record repeated after a resume
    TRIPPED = 256  # stimulus left its operating state during the dwell
    RETAKEN = 512  # replaced by a later attempt of the same record
    SUSPECT = 1024  # check passed but counter, fixed bits or counts are implausible
    NOT_SETTLED = 2048  # temperature outside its band
