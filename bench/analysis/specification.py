"""What the register of standards says of an instrument: its specification by range and age, and whether it still holds.

Source: docs/decisions/0031-values-without-programming.md, docs/decisions/0036-standards-once.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from bench.analysis.form import Document
from bench.analysis.material import Reading
from bench.analysis.wording import say
from bench.model.units import format_quantity

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
    standards: Mapping[str, Document], reading: Reading, value: float, age_s: float | None
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


def age_s(standards: Mapping[str, Document], role: str, utc_s: float | None) -> float | None:
    """Return how long ago an instrument was calibrated, seconds, at a UTC; None where either is not known."""
    calibrated = standards.get(role, {}).get("calibrated")
    if calibrated is None or utc_s is None:
        return None
    return utc_s - datetime.fromisoformat(str(calibrated)).replace(tzinfo=UTC).timestamp()


def age_text(seconds: float | None) -> str:
    """Return an age in words."""
    if seconds is None or math.isinf(seconds):
        return say("age.unknown")
    return say("age.known", days=seconds / _DAY_S)


@dataclass(frozen=True)
class Outlived:
    """A range of a standard whose specification held for ``age_s`` after its calibration; the age it had, seconds."""

    role: str
    range_A: float
    age_s: float
    had_s: float


def outlived_text(ranges: Sequence[Outlived]) -> str:
    """Return what is wrong with one or more ranges of a standard, for a person."""
    first, more = ranges[0], len(ranges) - 1
    told = {
        "role": first.role,
        "range": format_quantity(first.range_A, "A"),
        "days": first.age_s / _DAY_S,
        "age": age_text(first.had_s),
    }
    if more > 1:
        return say("outlived.more", count=more, **told)
    return say("outlived.one_more" if more else "outlived", **told)


def outlived(standards: Mapping[str, Document], role: str, end_utc_s: float) -> list[Outlived]:
    """Return the ranges of a standard whose specification did not hold at the end of a measurement.

    A register that does not say when the standard was calibrated cannot say that its specification held.
    """
    known_s = age_s(standards, role, end_utc_s)
    had_s = math.inf if known_s is None else known_s
    lines = standards.get(role, {}).get("uncertainty") or ()
    return [
        Outlived(role, float(line["range_A"]), float(line["age_s"]), had_s)
        for line in lines
        if "age_s" in line and had_s > float(line["age_s"])
    ]
