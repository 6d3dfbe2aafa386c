"""Values that a sequence names: readings of one name under one condition, their mean, scatter and uncertainty.

Values that a plan will read, as far as it says what they will be: readings in the middle of what is expected.

Readings scatter as their ``scatter`` says, in an even pattern, so that their means have the uncertainties of a run. No
fit through them is foreseen: departures of the points from their polynomial widen it, and only the unit shows them.
Decision: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from statistics import NormalDist
from typing import Any

import numpy as np

from bench.analysis.estimates import Document
from bench.analysis.material import (
    GivenValue,
    Material,
    Reading,
    Specification,
    age_s,
    age_text,
    flag_problem,
    specification_of,
)
from bench.analysis.prediction import Planned
from bench.analysis.wording import say
from bench.maths.arrays import Floats
from bench.maths.budget import effective_dof, independent_count
from bench.model.clock import NS
from bench.model.quantities import QUANTITY, conditions_of_value, key_of_value
from bench.model.units import read_quantity

EXPECTED = "expected"  # entry of the manifest's section "campaign"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?"  # in a reply
_RECTANGLE = math.sqrt(12.0)  # from the step of a number to the standard uncertainty of what is rounded to it


@dataclass(frozen=True)
class Value:
    """The readings of one name under one condition, in a base unit.

    ``t_s``, ``readings``: (n,), what was read and when; ``dropped`` gave no number or stand in a flagged record.
    ``specification``: of the instrument that read them, None if the register states none; ``unstated`` says so then.
    ``dof_b``: degrees of freedom of the specification.   ``low``, ``high``, ``span``: what is expected, None for none.
    ``resolution``: step of the readings, 0 for none.   ``independent``: how many independent readings they are worth,
    None for all of them; those of a stream of frames follow each other too closely.   ``told``: the last reply that is
    judged as a text.
    """

    quantity: str
    unit: str
    conditions: Document
    t_s: Floats
    readings: Floats
    dropped: int
    specification: Specification | None
    unstated: str
    dof_b: float = math.inf
    low: float | None = None
    high: float | None = None
    span: float | None = None
    resolution: float = 0.0
    independent: float | None = None
    told: str = ""

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
    def dof_a(self) -> float:
        """Degrees of freedom of the scatter."""
        return (self.n if self.independent is None else self.independent) - 1.0

    @property
    def std_a(self) -> float:
        """Standard uncertainty of the mean by the scatter; 0 of a single reading, whose scatter is not known.

        The scatter of correlated readings about their own mean is too small by as much as they are worth less.
        """
        return self.scatter * math.sqrt((self.n - 1.0) / self.n / self.dof_a) if self.n > 1 else 0.0

    @property
    def std_b(self) -> float:
        """Standard uncertainty by specification and resolution: errors of all readings, which a mean keeps."""
        specified = 0.0 if self.specification is None else self.specification.std(self.mean)
        return math.hypot(specified, self.resolution / _RECTANGLE)

    @property
    def blocks(self) -> tuple[Floats, Floats]:
        """Times and means of readings that follow each other, so many together that the means are independent."""
        if self.independent is None:
            return self.t_s, self.readings
        length = math.ceil(2.0 * self.n / self.independent)
        starts = np.arange(0, self.n - length + 1, length)
        ends = starts + length
        t_s, readings = (np.concatenate(([0.0], np.cumsum(column))) for column in (self.t_s, self.readings))
        return (t_s[ends] - t_s[starts]) / length, (readings[ends] - readings[starts]) / length

    @property
    def std(self) -> float:
        """Combined standard uncertainty of the mean."""
        return math.hypot(self.std_a, self.std_b)

    @property
    def dof(self) -> float:
        """Effective degrees of freedom of the combined uncertainty."""
        parts = [(self.std_a**2, self.dof_a)] if self.std_a else []
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
        key = key_of_value(reading.conditions[QUANTITY], conditions_of_value(reading.conditions))
        number = isinstance(reading.value, int | float) and math.isfinite(reading.value)
        if good and (number or isinstance(reading.value, str)):
            read.setdefault(key, []).append(reading)
        else:
            flagged[key] = flagged.get(key, 0) + 1
    given = {key_of_value(value.quantity, conditions_of_value(value.conditions)): value for value in material.given}
    values: list[Value] = []
    for entry in material.campaign.get(EXPECTED, ()):
        key = key_of_value(entry["quantity"], entry["conditions"])
        if "signal" in entry:
            values += _signal_value(entry, material)
        elif "reply" in entry:
            values += _reply_value(entry, read.get(key, ()))
        elif key in read:
            values.append(_read_value(entry, read[key], flagged.get(key, 0), material))
        elif key in given and given[key].value is not None:
            values.append(_given_value(entry, given[key]))
    return values


def absent(material: Material, values: Iterable[Value]) -> list[str]:
    """Return what should have been read or given and was not, one sentence each."""
    found = {key_of_value(value.quantity, value.conditions) for value in values} | material.not_due
    entries = material.campaign.get(EXPECTED, ())
    return [
        say("value.absent", where=placed(entry["quantity"], entry["conditions"]))
        for entry in entries
        if key_of_value(entry["quantity"], entry["conditions"]) not in found
    ]


def conditions_text(conditions: Document) -> str:
    """Return conditions as words, "" for none."""
    return ", ".join(_condition(name, value) for name, value in conditions.items())


def _condition(name: str, value: Any) -> str:
    """Return a condition with its unit, which its name ends in, behind the number: ``temperature 20 degC``."""
    what, _, unit = name.rpartition("_")
    if not what or not isinstance(value, int | float) or read_quantity(f"1 {unit}") is None:
        what, unit = name, ""
    shown = f"{value:g}" if isinstance(value, float) else str(value)
    return f"{what.replace('_', ' ')} {shown} {unit}".rstrip()


def place_of(conditions: Document) -> str:
    """Return conditions as words behind a quantity, "" for none."""
    return f" at {conditions_text(conditions)}" if conditions else ""


def placed(name: str, conditions: Document) -> str:
    """Return a name with the conditions it holds under, in words."""
    return say("place", name=name, conditions=conditions_text(conditions)) if conditions else name


def _readings(material: Material) -> list[tuple[Reading, bool]]:
    """Return the readings with a name, and whether each counts: those of a flagged record do not.

    Of a record that was taken again, and of a step that was done again, the last one counts.
    """
    of_records = {row.window.step for row in material.rows}
    named = [(reading, not row.quality) for row in material.rows for reading in material.readings_of(row)]
    last = {reading.step: reading for reading in material.readings if reading.step not in of_records}
    named += [(reading, True) for reading in last.values()]
    return [(reading, good) for reading, good in named if QUANTITY in reading.conditions]


def _stated(entry: Document) -> dict[str, Any]:
    """Return what a sequence says of a value: its name, unit and conditions, and what is expected of it."""
    of_value = {name: entry[name] for name in ("quantity", "unit", "conditions")}
    return of_value | {name: entry.get(name) for name in ("low", "high", "span")}


def _read_value(entry: Document, readings: Sequence[Reading], dropped: int, material: Material) -> Value:
    numbers = np.array([float(reading.value) for reading in readings])
    first, mean = readings[0], float(numbers.mean())
    utc_s = None if material.utc_offset_s is None else material.utc_offset_s + first.t_s
    age = age_s(material.standards, first.role, utc_s)
    specification = specification_of(material.standards, first, mean, age)
    unstated = say(
        "value.unstated.register",
        reading=f"{first.role}.{first.name}",
        mean=mean,
        unit=entry["unit"],
        age=age_text(age),
    )
    return Value(
        **_stated(entry),
        t_s=np.array([reading.t_s for reading in readings]),
        readings=numbers,
        dropped=dropped,
        specification=specification,
        unstated="" if specification is not None else unstated,
        dof_b=float(material.standards.get(first.role, {}).get("dof", math.inf)),
    )


def _signal_value(entry: Document, material: Material) -> Iterator[Value]:
    """Yield the value of a number that the unit streams, over all good records under its conditions; or nothing.

    It is what the unit says, so no instrument has a part in its uncertainty.
    """
    rows = [row for row in material.rows if conditions_of_value(row.window.conditions) == entry["conditions"]]
    kept = [(row, row.signals[entry["signal"]]) for row in rows if entry["signal"] in row.signals]
    good = [signal for row, signal in kept if not flag_problem(row)]
    parts = [entry.get("factor", 1.0) * signal.values for signal in good]
    readings = np.concatenate(parts) if parts else np.empty(0)
    finite = np.isfinite(readings)
    if finite.any():
        yield Value(
            **_stated(entry),
            t_s=np.concatenate([signal.t_ns for signal in good])[finite] / NS,
            readings=readings[finite],
            dropped=sum(signal.values.size for _, signal in kept) - int(finite.sum()),
            specification=None,
            unstated="",
            resolution=entry.get("resolution", 0.0),
            independent=sum(independent_count(part[np.isfinite(part)]) for part in parts),
        )


def _reply_value(entry: Document, replies: Sequence[Reading]) -> Iterator[Value]:
    """Yield the value of replies that are text, or nothing if none has the number that is due."""
    read, uncertainty = entry["reply"], entry.get("uncertainty")
    found = [(reply.t_s, number_of(str(reply.value), read)) for reply in replies]
    numbers = [(t_s, *number) for t_s, number in found if number is not None]
    if not numbers:
        return
    t_s, readings, steps = (np.array(column) for column in zip(*numbers, strict=True))
    stated = uncertainty is not None or read.get("of_unit") or read.get("unit") is None
    unstated = say("value.unstated.reply", role=replies[0].role)
    yield Value(
        **_stated(entry),
        t_s=t_s,
        readings=readings,
        dropped=len(replies) - len(numbers),
        specification=None if uncertainty is None else Specification(0.0, float(uncertainty)),
        unstated="" if stated else unstated,
        resolution=float(steps.max()),
        told=str(replies[-1].value).strip() if read.get("unit") is None else "",
    )


def number_of(reply: str, read: Document) -> tuple[float, float] | None:
    """Return the number in a reply and the value of its last digit, both in the base unit; None if there is none.

    Without ``unit`` the number is 1 if the reply is the text that is due, else 0. ``read`` is the entry "reply" of a
    value in the manifest: "pattern", "unit", "equals"; a pattern that cannot be used finds nothing.
    """
    unit, pattern = read.get("unit"), read.get("pattern")
    try:
        match = re.search(pattern or (_NUMBER if unit else r"(?s)\s*(.*?)\s*\Z"), reply)
    except re.error:
        return None
    text = "" if match is None else match[1 if match.re.groups else 0] or ""
    if unit is None:
        return float(match is not None and text == read.get("equals")), 0.0
    if not re.fullmatch(_NUMBER, text.strip()):
        return None
    number = Decimal(text.strip())
    exponent = number.as_tuple().exponent
    value, _ = read_quantity(f"{number} {unit}") or (math.nan, "")
    step, _ = read_quantity(f"1 {unit}") or (math.nan, "")
    last = step * 10.0**exponent if isinstance(exponent, int) else 0.0
    return (value, last) if math.isfinite(value) else None


def _given_value(entry: Document, given: GivenValue) -> Value:
    uncertainty = entry.get("uncertainty")
    unstated = say("value.unstated.gauge")
    return Value(
        **_stated(entry),
        t_s=np.array([given.t_s]),
        readings=np.array([float(given.value or 0.0)]),
        dropped=0,
        specification=None if uncertainty is None else Specification(0.0, float(uncertainty)),
        unstated="" if uncertainty is not None else unstated,
    )


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
