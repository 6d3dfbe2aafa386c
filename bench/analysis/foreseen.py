"""Values that a plan will read, as far as it says what they will be: readings in the middle of what is expected.

Readings scatter as their ``scatter`` says, in an even pattern, so that their means have the uncertainties of a run. No
fit through them is foreseen: departures of the points from their polynomial widen it, and only the unit shows them.
Decision: docs/decisions/0046-uncertainty-before-the-first-hour.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np

from bench.analysis.form import Document
from bench.analysis.material import GivenValue, Material, Reading
from bench.analysis.prediction import Planned
from bench.analysis.values import EXPECTED
from bench.analysis.wording import say
from bench.maths.arrays import Floats
from bench.model.quantities import QUANTITY, conditions_of_value, key_of_value


def foreseen_material(planned: Planned) -> tuple[Material, list[str]]:
    """Return readings and given values of a plan as expected, and sentences on those of which too little is declared.

    Several readings of one value need its ``scatter``; a value that is read needs both its limits.
    """
    read: dict[str, list[Reading]] = {}
    for reading in planned.readings:
        if QUANTITY in reading.conditions:
            key = key_of_value(reading.conditions[QUANTITY], conditions_of_value(reading.conditions))
            read.setdefault(key, []).append(reading)
    readings: list[Reading] = []
    given: list[GivenValue] = []
    wanting: dict[str, dict[str, None]] = {}
    for entry in planned.campaign.get(EXPECTED, ()):
        of_entry = read.get(key_of_value(entry["quantity"], entry["conditions"]), [])
        if why := _wanting(entry, of_entry):
            wanting.setdefault(why, {})[entry["quantity"]] = None
        elif of_entry:
            values = _values(entry, len(of_entry))
            readings += [replace(one, step=len(readings) + k, value=value)
                         for k, (one, value) in enumerate(zip(of_entry, values, strict=True))]  # fmt: skip
        else:
            given.append(_given(entry))
    missing = [say(f"foreseen.{why}", names=", ".join(names)) for why, names in wanting.items()]
    material = Material(
        (), planned.campaign, planned.standards, readings=readings, given=given, utc_offset_s=planned.begin_utc_s
    )
    return material, missing


def _wanting(entry: Document, readings: Sequence[Reading]) -> str:
    """Return what the plan does not say of a value, "" if it says enough."""
    if "signal" in entry or entry.get("reply", {}).get("of_unit"):
        return "of_unit"
    if "reply" in entry:
        return "of_reply"
    if readings and not {"low", "high"} <= entry.keys():
        return "no_limits"
    return "no_scatter" if len(readings) > 1 and "scatter" not in entry else ""


def _values(entry: Document, count: int) -> list[float]:
    """Return so many readings about the middle of the limits; their standard deviation is that of the entry."""
    middle = (entry["low"] + entry["high"]) / 2.0
    if count == 1:
        return [middle]
    pattern: Floats = np.array([NormalDist().inv_cdf((number + 0.5) / count) for number in range(count)])
    return list((middle + entry["scatter"] * pattern / pattern.std(ddof=1)).tolist())


def _given(entry: Document) -> GivenValue:
    low, high = entry.get("low"), entry.get("high")
    value = 0.0 if low is None or high is None else (low + high) / 2.0
    return GivenValue(0.0, 0, entry["quantity"], value, entry["unit"], low, high, entry["conditions"])
