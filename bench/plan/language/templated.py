"""Values of a sequence that may be written out (``"10 mA"``) or refer to a variable (``"{level}"``)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, StringConstraints, WithJsonSchema

from bench.model.units import parse_quantity
from bench.model.yamlio import NAME_PATTERN

ACTION_PATTERN = NAME_PATTERN + r"\." + NAME_PATTERN
ActionName = Annotated[str, StringConstraints(pattern=f"^{ACTION_PATTERN}$")]
Scalar = bool | int | float | str

REFERENCE = re.compile(r"\{(" + NAME_PATTERN + r")(?:\.(" + NAME_PATTERN + r"))?\}")


@dataclass(frozen=True)
class Reference:
    """A variable, or one of its attributes, by name: ``{channel}``, ``{channel.kind}``."""

    name: str
    attribute: str = ""

    def __str__(self) -> str:
        return "{" + self.name + (f".{self.attribute}" if self.attribute else "") + "}"


def as_reference(value: object) -> Reference | None:
    """The reference a value is, or None if it is written out."""
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

    schema = {"type": "string", "description": f"a quantity in {dimension}, or a variable such as '{{level}}'"}
    return BeforeValidator(read), WithJsonSchema(schema)


def within(value: float, dimension: str, low: float | None, high: float | None) -> float:
    """Return ``value``; raise ValueError naming the limit that it breaks."""
    if low is not None and value < low:
        raise ValueError(f"{value:g} {dimension} is below the limit {low:g} {dimension}")
    if high is not None and value > high:
        raise ValueError(f"{value:g} {dimension} is above the limit {high:g} {dimension}")
    return value
