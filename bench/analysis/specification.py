"""What the register of standards says of the readings of an instrument: its specification by range and age.

Source: docs/decisions/0031-values-without-programming.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from bench.analysis.material import Reading

_EXPANDED = 2.0  # the register states 95 %
_DAY_S = 86_400.0
_ALIKE = 1e-9  # of two ranges that went through different roundings


@dataclass(frozen=True)
class Specification:
    """One line of the register, 95 %: ``relative`` of the reading plus ``floor``, in the unit of the reading."""

    relative: float
    floor: float

    def std(self, value: float) -> float:
        """Return the standard uncertainty of a reading of this value."""
        return (self.relative * abs(value) + self.floor) / _EXPANDED


def specification_of(
    standards: Mapping[str, Mapping[str, Any]], reading: Reading, value: float, age_s: float | None
) -> Specification | None:
    """Return the line of the register that holds for a reading; None if none does.

    It names the action, holds for an instrument of this age (seconds since its calibration; None is unknown), and is of
    the range that was set, else of the lowest range that holds the value.
    """
    lines = [
        line for line in standards.get(reading.role, {}).get("specifications", ()) if line["reads"] == reading.name
    ]
    lines = [line for line in lines if "age_s" not in line or (age_s is not None and age_s <= line["age_s"])]
    set_to = reading.arguments.get("range")
    if isinstance(set_to, int | float):
        lines = [line for line in lines if "range" not in line or abs(line["range"] - set_to) <= _ALIKE * abs(set_to)]
    else:
        lines = [line for line in lines if "range" not in line or abs(value) <= line["range"]]
    if not lines:
        return None
    line = min(lines, key=lambda line: (line.get("range", 0.0), line.get("age_s", float("inf"))))
    return Specification(float(line["relative"]), float(line["floor"]))


def age_s(standards: Mapping[str, Mapping[str, Any]], role: str, utc_s: float | None) -> float | None:
    """Return how long ago an instrument was calibrated, seconds, at a UTC; None where either is not known."""
    calibrated = standards.get(role, {}).get("calibrated")
    if calibrated is None or utc_s is None:
        return None
    return utc_s - datetime.fromisoformat(str(calibrated)).replace(tzinfo=UTC).timestamp()


def age_text(seconds: float | None) -> str:
    """Return an age in words."""
    return "of unknown age" if seconds is None else f"{seconds / _DAY_S:.0f} days after its calibration"
