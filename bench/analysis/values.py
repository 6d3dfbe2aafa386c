"""Values that a sequence names: readings of one name under one condition, their mean, scatter and uncertainty."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis.material import Floats, GivenValue, Material, Reading
from bench.analysis.specification import Specification, age_s, age_text, specification_of
from bench.maths.budget import effective_dof
from bench.model.quantities import QUANTITY, conditions_of_value

EXPECTED = "expected"  # entry of the manifest's section "campaign"


@dataclass(frozen=True)
class Value:
    """The readings of one name under one condition, in a base unit.

    ``t_s``, ``readings``: (n,), what was read and when; ``dropped`` gave no number or stand in a flagged record.
    ``specification``: of the instrument that read them, None if the register states none; ``unstated`` says so then.
    ``dof_b``: degrees of freedom of the specification.   ``low``, ``high``, ``span``: what is expected, None for none.
    """

    quantity: str
    unit: str
    conditions: Mapping[str, Any]
    t_s: Floats
    readings: Floats
    dropped: int
    specification: Specification | None
    unstated: str
    dof_b: float = math.inf
    low: float | None = None
    high: float | None = None
    span: float | None = None

    @property
    def n(self) -> int:
        """Number of readings."""
        return self.readings.size

    @property
    def mean(self) -> float:
        """Mean of the readings."""
        return float(self.readings.mean())

    @property
    def scatter(self) -> float:
        """Standard deviation of one reading; NaN of a single one, which shows none."""
        if self.n < 2:
            return math.nan
        return float(self.readings.std(ddof=1)) if np.ptp(self.readings) else 0.0

    @property
    def std_a(self) -> float:
        """Standard uncertainty of the mean by the scatter; 0 of a single reading, whose scatter is not known."""
        return self.scatter / math.sqrt(self.n) if self.n > 1 else 0.0

    @property
    def std_b(self) -> float:
        """Standard uncertainty by the specification: one error of all readings, which a mean does not make smaller."""
        return 0.0 if self.specification is None else self.specification.std(self.mean)

    @property
    def std(self) -> float:
        """Combined standard uncertainty of the mean."""
        return math.hypot(self.std_a, self.std_b)

    @property
    def dof(self) -> float:
        """Effective degrees of freedom of the combined uncertainty."""
        parts = [(self.std_a**2, self.n - 1.0)] if self.std_a else []
        parts += [(self.std_b**2, self.dof_b)] if self.std_b and math.isfinite(self.dof_b) else []
        return effective_dof(self.std**2, parts)

    @property
    def limits(self) -> tuple[float, float] | None:
        """Lowest and highest value that is expected, infinite on an open side; None if nothing is expected."""
        if self.low is None and self.high is None:
            return None
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high


def values_of(material: Material) -> list[Value]:
    """Return all values that were read or given, in the order of the plan; one without any number is left out."""
    read: dict[str, list[Reading]] = {}
    flagged: dict[str, int] = {}
    for reading, good in _readings(material):
        key = _key(reading.conditions[QUANTITY], conditions_of_value(reading.conditions))
        if good and isinstance(reading.value, int | float) and math.isfinite(reading.value):
            read.setdefault(key, []).append(reading)
        else:
            flagged[key] = flagged.get(key, 0) + 1
    given = {_key(value.quantity, conditions_of_value(value.conditions)): value for value in material.given}
    values = []
    for entry in material.campaign.get(EXPECTED, ()):
        key = _key(entry["quantity"], entry["conditions"])
        if key in read:
            values.append(_read_value(entry, read[key], flagged.get(key, 0), material))
        elif key in given and given[key].value is not None:
            values.append(_given_value(entry, given[key]))
    return values


def absent(material: Material, values: Iterable[Value]) -> list[str]:
    """Return what should have been read or given and was not, one sentence each."""
    found = {_key(value.quantity, value.conditions) for value in values}
    entries = material.campaign.get(EXPECTED, ())
    return [
        f"{entry['quantity']}{place_of(entry['conditions'])} was not read"
        for entry in entries
        if _key(entry["quantity"], entry["conditions"]) not in found
    ]


def conditions_text(conditions: Mapping[str, Any]) -> str:
    """Return conditions as words, "" for none."""
    told = (
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in conditions.items()
    )
    return ", ".join(told)


def place_of(conditions: Mapping[str, Any]) -> str:
    """Return conditions as words behind a quantity, "" for none."""
    return f" at {conditions_text(conditions)}" if conditions else ""


def _key(quantity: str, conditions: Mapping[str, Any]) -> str:
    return json.dumps([quantity, dict(conditions)], sort_keys=True)


def _readings(material: Material) -> list[tuple[Reading, bool]]:
    """Return the readings with a name, and whether each counts: those of a flagged record do not.

    Of a record that was taken again, and of a step that was done again, the last one counts.
    """
    of_records = {row.window.step for row in material.rows}
    named = [(reading, not row.quality) for row in material.rows for reading in material.readings_of(row)]
    last = {reading.step: reading for reading in material.readings if reading.step not in of_records}
    named += [(reading, True) for reading in last.values()]
    return [(reading, good) for reading, good in named if QUANTITY in reading.conditions]


def _read_value(entry: Mapping[str, Any], readings: Sequence[Reading], dropped: int, material: Material) -> Value:
    numbers = np.array([float(reading.value) for reading in readings])
    first, mean = readings[0], float(numbers.mean())
    utc_s = None if material.utc_offset_s is None else material.utc_offset_s + first.t_s
    age = age_s(material.standards, first.role, utc_s)
    specification = specification_of(material.standards, first, mean, age)
    unstated = (
        f"the register of standards states no specification of {first.role}.{first.name} for {mean:.6g} "
        f"{entry['unit']} {age_text(age)}, so the interval would lack the error of the instrument"
    )
    return Value(
        quantity=entry["quantity"],
        unit=entry["unit"],
        conditions=entry["conditions"],
        t_s=np.array([reading.t_s for reading in readings]),
        readings=numbers,
        dropped=dropped,
        specification=specification,
        unstated="" if specification is not None else unstated,
        dof_b=float(material.standards.get(first.role, {}).get("dof", math.inf)),
        low=entry.get("low"),
        high=entry.get("high"),
        span=entry.get("span"),
    )


def _given_value(entry: Mapping[str, Any], given: GivenValue) -> Value:
    uncertainty = entry.get("uncertainty")
    unstated = "the prompt states no 'uncertainty' of the gauge, so the interval would lack its error"
    return Value(
        quantity=entry["quantity"],
        unit=entry["unit"],
        conditions=entry["conditions"],
        t_s=np.array([given.t_s]),
        readings=np.array([float(given.value or 0.0)]),
        dropped=0,
        specification=None if uncertainty is None else Specification(0.0, float(uncertainty)),
        unstated="" if uncertainty is not None else unstated,
        low=entry.get("low"),
        high=entry.get("high"),
        span=entry.get("span"),
    )
