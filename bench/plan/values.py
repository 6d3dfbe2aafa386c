"""Values of a sequence: written out (``"10 mA"``) or a variable (``"{level}"``), and what they are in the expansion."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any

from pydantic import BeforeValidator, StringConstraints, WithJsonSchema

from bench.model.quantities import Values
from bench.model.units import parse_quantity, read_quantity
from bench.model.yamlio import NAME_PATTERN
from bench.plan.findings import suggestion

ACTION_PATTERN = NAME_PATTERN + r"\." + NAME_PATTERN
ActionName = Annotated[str, StringConstraints(pattern=f"^{ACTION_PATTERN}$")]
Scalar = bool | int | float | str
REFERENCE = re.compile(r"\{(" + NAME_PATTERN + r")(?:\.(" + NAME_PATTERN + r"))?\}")
_UNITS = (
    "A", "V", "Hz", "s", "C", "ohm", "W", "F", "degC", "degC/min", "deg", "deg/s", "deg/s2", "g", "gauss", "m", "m/s",
    "m/s2",
)  # fmt: skip
SUFFIX = {unit: unit.replace("/", "_") for unit in _UNITS} | {"1": "", "1/degC": "per_degC"}
UNIT = "unit"  # condition of what is done for one of several units: its serial number
_SIGNS = {"+": 1, "-": -1}


@dataclass(frozen=True)
class Reference:
    """A variable, or one of its attributes, by name: ``{channel}``, ``{channel.kind}``."""

    name: str
    attribute: str = ""

    def __str__(self) -> str:
        return "{" + self.name + (f".{self.attribute}" if self.attribute else "") + "}"


def as_reference(value: object) -> Reference | None:
    """Return the reference a value is, or None if it is written out."""
    match = REFERENCE.fullmatch(value) if isinstance(value, str) else None
    return None if match is None else Reference(match[1], match[2] or "")


def templated(dimension: str, low: float | None = None, high: float | None = None) -> Any:
    """Pydantic annotation: a quantity of ``dimension`` inside [low, high] in base units, or a Reference.

    Use as ``Annotated[Any, *templated("A")]``.
    """

    def read(value: object) -> object:
        reference = as_reference(value)
        if reference is not None:
            return reference
        return within(parse_quantity(value, dimension), dimension, low, high)

    described = f"a quantity in {dimension}, or a variable such as '{{level}}'"
    schema = {"type": "string", "description": described, "x-unit": dimension}
    return BeforeValidator(read), WithJsonSchema(schema)


def within(value: float, dimension: str, low: float | None, high: float | None) -> float:
    """Return ``value``; raise ValueError naming the limit that it breaks."""
    if low is not None and value < low:
        raise ValueError(f"{value:g} {dimension} is below the limit {low:g} {dimension}")
    if high is not None and value > high:
        raise ValueError(f"{value:g} {dimension} is above the limit {high:g} {dimension}")
    return value


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number in the base unit of its dimension; ``origin`` says where it was written, if not where it is used."""

    value: float
    dimension: str
    origin: str = field(default="", compare=False)


def traced(value: Any, origin: str) -> Any:
    """Return the same value; a quantity that does not know yet where it was written remembers it."""
    return replace(value, origin=origin) if isinstance(value, Quantity) and not value.origin else value


@dataclass(frozen=True, slots=True)
class Channel:
    """A declared channel of the unit under test; ``levels`` are currents, ``group`` its place in ``channels:``."""

    number: int
    kind: str
    levels: tuple[Quantity, ...]
    group: int


@dataclass(frozen=True, slots=True)
class UnitInSlot:
    """A unit under test in its slot of the station; ``card`` of the switch matrix leads to it."""

    serial: str
    slot: str
    card: int | None


class UnknownVariable(Exception):
    """A reference to a variable that is not in scope; the message says which ones are."""


@lru_cache(maxsize=4096)
def read_text(text: str) -> Any:
    """Return what a written-out text is: a Quantity, a sign (``+`` and ``-``), a Reference, or the text itself."""
    reference = as_reference(text)
    if reference is not None:
        return reference
    parts = read_quantity(text)
    return Quantity(*parts) if parts is not None else _SIGNS.get(text, text)


class Scope:
    """Variables by name, and roles whose attributes the compiler knows (``{calibrator.range}``)."""

    def __init__(self, variables: Values, role_attribute: Callable[[str, str], Any], context: Values) -> None:
        self.variables = variables
        self.context = context
        self._role_attribute = role_attribute

    def extended(self, more: Values, context: Values | None = None) -> Scope:
        """Return a scope with more variables; ``context`` adds to what identifies the position in the loops."""
        merged = self.context if context is None else {**self.context, **context}
        return Scope({**self.variables, **more}, self._role_attribute, merged)

    def resolve(self, raw: Any) -> Any:
        """Return value of what stands in the file. Raises UnknownVariable or ValueError."""
        if isinstance(raw, str):
            raw = read_text(raw)
        if isinstance(raw, (list, tuple)):
            return tuple(self.resolve(item) for item in raw)
        return self._look_up(raw) if isinstance(raw, Reference) else raw

    def _look_up(self, reference: Reference) -> Any:
        if reference.name in self.variables:
            value = self.variables[reference.name]
            if not reference.attribute or value is None:  # None: its mistake is noted already
                return value
            if isinstance(value, Channel | UnitInSlot):
                noun, names = _ATTRIBUTES[type(value)]
                if reference.attribute in names:
                    return getattr(value, reference.attribute)
                known = suggestion(reference.attribute, names)
                raise UnknownVariable(f"{reference}: a {noun} has no {reference.attribute!r}{known}")
        elif reference.attribute:
            return self._role_attribute(reference.name, reference.attribute)
        raise UnknownVariable(f"{reference} is not a variable here{suggestion(reference.name, self.variables)}")


_ATTRIBUTES = {  # what ``{channel.name}`` and ``{unit.name}`` may ask for
    Channel: ("channel", ("number", "kind", "levels")),
    UnitInSlot: ("unit", ("serial", "slot", "card")),
}


def plain(value: Any) -> Any:
    """Return a resolved value as a JSON value: quantities in base units, channels by number, units by serial number."""
    if isinstance(value, Quantity):
        return value.value
    if isinstance(value, Channel):
        return value.number
    if isinstance(value, UnitInSlot):
        return value.serial
    return [plain(item) for item in value] if isinstance(value, tuple) else value


def named(name: str, value: Any) -> str:
    """Return name of a condition with the suffix of its unit: ``("current", 1 mA)`` is ``current_A``."""
    suffix = SUFFIX[value.dimension] if isinstance(value, Quantity) else ""
    return f"{name}_{suffix}" if suffix else name


_UNIT_OF = {suffix: unit for unit, suffix in SUFFIX.items() if suffix}


class NamedValues:
    """The values of one plan, in the order in which they are first read."""

    def __init__(self) -> None:
        self._entries: dict[tuple[str, str], dict[str, Any]] = {}
        self._read_by: dict[str, str] = {}
        self._conditions: dict[str, None] = {}

    @property
    def entries(self) -> list[dict[str, Any]]:
        """Each with quantity, unit and conditions, and of low, high, span and uncertainty those that are stated."""
        return list(self._entries.values())

    def add(self, entry: dict[str, Any], read_by: str) -> str:
        """Take a value; return what is wrong with it, "" if nothing is."""
        name = entry["quantity"]
        key = name, json.dumps(entry["conditions"], sort_keys=True)
        if self._read_by.setdefault(name, read_by) != read_by:
            return f"{name!r} is read by {self._read_by[name]} and by {read_by}: one name is of one reading"
        if self._entries.setdefault(key, entry) != entry:
            return f"{name!r} is expected elsewhere under the same conditions, and to be another value"
        self._conditions.update(dict.fromkeys(entry["conditions"]))
        return ""

    def unit_of(self, name: str) -> str | None:
        """Return the unit of a quantity, None if nothing of this name is read."""
        return next((entry["unit"] for entry in self.entries if entry["quantity"] == name), None)

    def condition(self, name: str) -> tuple[str, str] | None:
        """Return a condition by the name it has in the sequence, with its unit; None if no value has it."""
        for known in self._conditions:
            suffix = known.removeprefix(f"{name}_")
            if known == name or (known != suffix and suffix in _UNIT_OF):
                return known, "1" if known == name else _UNIT_OF[suffix]
        return None

    @property
    def names(self) -> list[str]:
        """Names of all quantities."""
        return list(self._read_by)
