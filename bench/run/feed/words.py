"""A step in field words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.units import format_quantity
from bench.plan import PlannedSoak, Step


def conditions_in_words(conditions: Mapping[str, Any]) -> str:
    """Return temperature, channel, level and branch of a step or record, such as "50 degC channel 3 -10 mA"."""
    parts = []
    if "temperature_degC" in conditions:
        parts.append(f"{conditions['temperature_degC']:g} degC")
    if "channel" in conditions:
        parts.append(f"channel {conditions['channel']}")
    if conditions.get("route") == "open":
        parts.append("open")
    elif "current_A" in conditions:
        sign = "-" if conditions.get("polarity", 1) < 0 else "+"
        parts.append(sign + format_quantity(float(conditions["current_A"]), "A"))
    if "branch" in conditions:
        parts.append(str(conditions["branch"]))
    return " ".join(parts)


def in_words(step: Step) -> str:
    """Return one line about a step: what is done and under which conditions."""
    conditions = conditions_in_words(step.conditions)
    if isinstance(step, PlannedSoak) and "temperature_degC" not in step.conditions:
        conditions = f"{step.temperature_degC:g} degC {conditions}"
    what = f"{step.role}.{step.name}" if step.on_the_bus else step.kind
    return f"{what} {conditions}".strip()
